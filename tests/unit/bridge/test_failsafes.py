"""Fail-safes are carried out for the requests that are open, and for no other; zeros come first."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp_bridge.exit.failsafes import FailSafes, Motion, begun_by, ended_by
from ros2_mcp_bridge.request import Cancelled, OperationError, Request
from ros2_mcp_common.policy.flight import COMMAND_LONG, SET_MODE


class Arrived:
    def done(self) -> bool:
        return True


GOAL = "test_msgs/action/Fibonacci_SendGoal"
CANCEL = "action_msgs/srv/CancelGoal"
ARMING = "mavros_msgs/srv/CommandBool"
UUID = SimpleNamespace(uuid=bytes(range(16)))


def request_of(op: str) -> Request:
    return Request({"id": 1, "op": op}, b"")


def test_what_is_in_force_is_carried_out_and_what_was_is_not() -> None:
    done = list[str]()
    failsafes = FailSafes(lambda: None)
    with failsafes.in_force(request_of("failsafe_call"), lambda: done.append("over")):
        pass
    with failsafes.in_force(request_of("failsafe_call"), lambda: done.append("in force")):
        failsafes.carry_out()
    assert done == ["in force"]


def test_calls_come_after_zeros_because_they_can_block() -> None:
    done = list[str]()
    failsafes = FailSafes(lambda: done.append("zeros"))
    with failsafes.in_force(request_of("failsafe_call"), lambda: done.append("call")):
        failsafes.carry_out()
    assert done == ["zeros", "call"]


def test_one_that_fails_does_not_keep_the_others_from_being_done(capsys: pytest.CaptureFixture[str]) -> None:
    failsafes, arrived = FailSafes(lambda: None), Arrived()
    with (
        failsafes.in_force(request_of("failsafe_call"), lambda: 1 // 0),  # type: ignore[arg-type,return-value]
        failsafes.in_force(request_of("failsafe_call"), lambda: arrived),
        failsafes.in_force(request_of("failsafe_call"), lambda: None),
    ):
        assert failsafes.carry_out() == [arrived]
    assert "the fail-safe of failsafe_call could not be carried out" in capsys.readouterr().err


def test_one_is_held_until_its_request_is_cancelled() -> None:
    done = list[str]()
    failsafes = FailSafes(lambda: None)
    steps = failsafes.until_cancelled(request_of("failsafe_call"), lambda: done.append("sent"))
    next(steps)
    next(steps)
    failsafes.carry_out()
    with pytest.raises(StopIteration) as ended:
        steps.throw(Cancelled())
    assert ended.value.value == {"cancelled": True}
    failsafes.carry_out()
    assert done == ["sent"]


@pytest.mark.parametrize(
    ("service", "kind", "fields", "begun", "ended"),
    [
        ("/go/_action/send_goal", GOAL, {"goal_id": UUID}, Motion("/go", UUID.uuid.hex()), None),
        ("/go/_action/cancel_goal", CANCEL, {"goal_info": SimpleNamespace(goal_id=UUID)}, None,
         Motion("/go", UUID.uuid.hex())),
        ("/uav/mavros/cmd/arming", ARMING, {"value": True}, Motion("/uav/mavros"), None),
        ("/uav/mavros/set_mode", SET_MODE, {"base_mode": 0, "custom_mode": "AUTO"}, Motion("/uav/mavros"), None),
        ("/uav/mavros/set_mode", SET_MODE, {"base_mode": 0, "custom_mode": "BRAKE"}, None, Motion("/uav/mavros")),
        ("/uav/mavros/cmd/command", COMMAND_LONG, {"command": 400}, Motion("/uav/mavros"), None),
        ("/uav/mavros/cmd/command", COMMAND_LONG, {"command": 512}, None, None),
        ("/switch", "std_srvs/srv/SetBool", {"data": True}, None, None),
    ],
)  # fmt: skip
def test_what_a_call_begins_is_what_its_fail_safe_ends(
    service: str, kind: str, fields: dict[str, Any], begun: Motion | None, ended: Motion | None
) -> None:
    message = SimpleNamespace(**fields)
    assert (begun_by(service, kind, message), ended_by(service, kind, message)) == (begun, ended)


def test_what_no_fail_safe_in_force_ends_is_refused() -> None:
    failsafes, goal = FailSafes(lambda: None), Motion("/go", "aa")
    with failsafes.in_force(request_of("failsafe_call"), lambda: None, goal):
        failsafes.check_held(goal)
        for other in (Motion("/go", "bb"), Motion("/come", "aa"), Motion("/go")):
            with pytest.raises(OperationError, match="nothing was sent"):
                failsafes.check_held(other)
    with pytest.raises(OperationError, match="No fail-safe is in force that ends goal aa of /go"):
        failsafes.check_held(goal)
