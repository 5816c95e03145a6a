"""Fail-safes are carried out for the requests that are open, and for no other; zeros come first."""

from __future__ import annotations

import pytest

from ros2_mcp_bridge.exit.failsafes import FailSafes
from ros2_mcp_bridge.request import Cancelled, Request


class Arrived:
    def done(self) -> bool:
        return True


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
