"""Whatever acts passes the guard once: refused commands leave nothing, and what stops is never held."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest

from ros2_mcp.guard.chain import entries
from ros2_mcp.guard.consent import Auditing, with_consent
from ros2_mcp.guard.guard import Act, Guard
from ros2_mcp.guard.policy import Facts, Policy, verb_of
from ros2_mcp.guard.policy_file import compiled, document_of
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import LOCAL, CancelGoals, Command, Publish, Record, Repeat
from ros2_mcp.model.errors import ApprovalNeeded, BadValue, Latched, Refused, RobotError
from ros2_mcp.ops.policy.in_force import in_force
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal
from support.noting_bridge import CHOICE, EVERY, GOAL_ID, TWIST, Noting, call, goal, on

SLOW = """
policy: 1
name: slow
allow:
  - {publish: /cmd_vel, type: geometry_msgs/msg/Twist, sole_publisher: true}
  - {publish: /speed, type: made/msg/Speed, fields: {speed: {range: [0.1, 0.2]}}}
  - {goal: /go, type: made/action/Go, fields: {order: {range: [1, 5]}}}
  - {set: /camera, names: [exposure], fields: {exposure: {range: [1, 500]}}}
  - {transition: /camera, transitions: [activate]}
limits:
  base: {types: geometry_msgs/msg/Twist, norm: {linear: 0.2}}
"""


ENDPOINT = {"namespace": "/", "hash": "", "gid": "", "qos": {"depth": 1}}


def guarded(bridge: Noting, text: str = SLOW) -> Robot:
    documents = [document_of(text, "slow.yaml")]
    return Robot(cast(Bridge, bridge), Guard(Policy(documents=documents, rules=compiled(documents))))


def publish(value: object, name: str = "/cmd_vel", kind: str = TWIST) -> Publish:
    return Publish(principal=LOCAL, name=name, type=kind, value=value, choice=CHOICE, wait_match_s=0.0)


def parameters(service: str = "/camera/set_parameters", **values: float) -> Command[Any]:
    listed = [{"name": name, "value": {"type": 3, "double_value": value}} for name, value in values.items()]
    return call("rcl_interfaces/srv/SetParameters", service, {"parameters": listed})


@pytest.mark.parametrize(
    "command",
    [
        publish({"linear": {"x": 0.3}}),
        publish({"linear": {"x": 0.1}}, "/other"),
        publish({}, "/speed", "made/msg/Speed"),  # the default, 0, which nobody wrote, is judged
        goal(value={}),
        call("made/action/Go_SendGoal", "/go/_action/send_goal", {"goal_id": {"uuid": [1] * 16}, "goal": {"order": 6}}),
        parameters(exposure=0.0),
        parameters(exposure=5.0, gain=1.0),
        call("lifecycle_msgs/srv/ChangeState", "/camera/change_state", {"transition": {"label": "cleanup"}}),
        CancelGoals(principal=LOCAL, name="/go", goal_id=GOAL_ID, timeout_s=1.0),
    ],
    ids=lambda command: f"{type(command).__name__}",
)
async def test_of_what_the_policy_refuses_nothing_is_sent_left_or_known(bridge: Noting, command: Command[Any]) -> None:
    robot = guarded(bridge)
    with pytest.raises(Refused, match="refused by the policy"):
        await robot.do(command)
    assert not {"publish", "call", "failsafe_publish", "failsafe_call"} & set(bridge.sent)
    assert (robot.failsafes.driven, robot.jobs.all(Goal)) == ([], [])


async def test_what_the_policy_allows_is_carried_out(bridge: Noting) -> None:
    robot = guarded(bridge)
    await robot.do(publish({"linear": {"x": 0.2}}))
    await robot.do(publish({"speed": 0.2}, "/speed", "made/msg/Speed"))  # as float32 it is a little more
    assert bridge.sent.count("publish") == 2
    robot.failsafes.close()


async def test_a_parameter_that_is_set_twice_in_one_request_is_refused(bridge: Noting) -> None:
    twice = [{"name": "exposure", "value": {"type": 3, "double_value": value}} for value in (5.0, 1e9)]
    with pytest.raises(BadValue, match="set twice"):
        await guarded(bridge).do(
            call("rcl_interfaces/srv/SetParameters", "/camera/set_parameters", {"parameters": twice})
        )
    assert "call" not in bridge.sent


async def test_a_topic_behind_a_node_of_the_robot_is_refused_and_the_node_named(bridge: Noting) -> None:
    bridge.publishers = [{**ENDPOINT, "node": "velocity_smoother", "type": TWIST}]
    with pytest.raises(Refused, match=r"/velocity_smoother of the robot publishes there"):
        await guarded(bridge).do(publish({}))


class Noted:
    """All that can hold a command back; `hold` is what does."""

    def __init__(self, hold: str = "") -> None:
        self.seen: list[str] = []
        self.hold = hold
        self.mode: Any = "autonomous"
        self.approved: Any = None

    def note(self, what: str, **_: Any) -> None:
        self.seen.append(what)
        if self.hold == what:
            raise Latched(f"{what} holds it.")

    def check(self, *command: Any) -> str:
        self.note("latch" if command else "lock")
        return "" if command else "Another server is there."

    @contextmanager
    def work(self, *_: Any) -> Iterator[None]:
        self.note("budgets")
        yield
        self.note("free")

    async def require(self, act: Act) -> str:
        self.approved = act.facts.value
        self.note("approvals")
        return "approval-1"

    def refused(self, _: Act, error: Exception) -> None:
        self.seen.append(f"refused: {type(error).__name__}")

    async def before(self, act: Act) -> None:
        self.note(f"before {act.approval}".strip())

    def after(self, _: Act, error: BaseException | None) -> None:
        self.note(f"after {type(error).__name__}" if error else "after")


def held(bridge: Noting, noted: Noted, text: str = SLOW) -> Robot:
    robot = guarded(bridge, text)
    guard: Any = robot.guard
    guard.latch = guard.server_lock = guard.budgets = guard.approvals = guard.audit = noted
    return robot


async def test_a_command_passes_everything_in_one_order(bridge: Noting) -> None:
    noted = Noted()
    robot = held(bridge, noted, SLOW.replace("sole_publisher: true", "consent: each"))
    session = robot.session()
    await robot.do(publish({}), session)
    assert noted.seen == ["latch", "lock", "budgets", "approvals", "before approval-1", "after", "free"]
    assert session.notes == ["Another server is there."]
    robot.failsafes.close()


@pytest.mark.parametrize("hold", ["latch", "lock", "budgets", "approvals", "before approval-1"])
async def test_whatever_holds_a_command_nothing_is_sent_and_it_is_audited(bridge: Noting, hold: str) -> None:
    noted = Noted(hold)
    with pytest.raises(Latched):
        await held(bridge, noted, SLOW.replace("sole_publisher: true", "consent: each")).do(publish({}))
    assert "publish" not in bridge.sent
    assert noted.seen[-2 if noted.seen[-1] == "free" else -1] == "refused: Latched"


async def test_a_drive_that_was_cut_short_is_not_done_in_the_audit(bridge: Noting, tmp_path: Path) -> None:
    bridge.ended_by = "latch"
    robot = guarded(bridge)
    with_consent(robot.guard, StateFolder(tmp_path / "hall"), str)
    repeat = Repeat(**on("/cmd_vel", value={}, choice=CHOICE, wait_match_s=0.0, rate_hz=10.0, duration_s=2.0))
    await robot.do(repeat)
    auditing = cast(Auditing, robot.guard.audit)
    auditing.log.close()
    outcomes = [entry["outcome"] for entry in entries(tmp_path / "hall/audit") if entry["kind"] == "outcome"]
    assert outcomes == ["ended before its time: latch"]
    robot.failsafes.close()


async def test_a_client_that_has_gone_takes_what_it_asked_for_with_it(bridge: Noting, tmp_path: Path) -> None:
    robot = guarded(bridge, SLOW.replace("sole_publisher: true", "consent: each"))
    consent = with_consent(robot.guard, StateFolder(tmp_path / "hall"), str)
    with pytest.raises(ApprovalNeeded):
        await robot.do(publish({}))
    await robot.stop_owned(LOCAL, "the end of its client")
    assert consent.approvals.waiting() == []
    cast(Auditing, robot.guard.audit).log.close()


async def test_what_fails_is_audited_with_its_error(bridge: Noting) -> None:
    noted = Noted()
    bridge.refuse = {"publish": "bad_request"}
    robot = held(bridge, noted)
    with pytest.raises(RobotError):
        await robot.do(publish({}))
    robot.failsafes.close()
    assert "after LinkError" in noted.seen


ACTING = [command for command in EVERY if not isinstance(command, Record | CancelGoals)]


@pytest.mark.parametrize("command", ACTING, ids=lambda command: type(command).__name__)
async def test_whatever_sets_something_in_motion_is_held_by_the_latch(bridge: Noting, command: Command[Any]) -> None:
    with pytest.raises(Latched):
        await held(bridge, Noted("latch")).do(command)
    assert bridge.sent == []


async def test_cancelling_a_goal_of_ones_own_is_never_held(bridge: Noting) -> None:
    noted = Noted()
    robot = held(bridge, noted)
    await robot.values.learn("made/action/Go", "action_msgs/srv/CancelGoal")
    bridge.answer = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": True})
    await robot.do(goal())
    noted.hold, noted.seen = "latch", []
    bridge.answer = robot.values.encode_known("action_msgs/srv/CancelGoal_Response", {"return_code": 0})
    await robot.do(CancelGoals(principal=LOCAL, name="/go", goal_id=GOAL_ID, timeout_s=1.0))
    assert noted.seen == ["before", "after"]
    noted.hold = ""
    stamp = {"sec": 2_000_000_000, "nanosec": 0}  # cancels everybody's goals of before that time besides
    with pytest.raises(Refused, match="no rule allows it"):
        await robot.do(CancelGoals(principal=LOCAL, name="/go", goal_id=GOAL_ID, stamp=stamp, timeout_s=1.0))
    robot.goal_ended("/go", GOAL_ID)
    await robot.jobs.close()


async def test_where_nobody_can_approve_what_needs_approval_is_refused(bridge: Noting) -> None:
    with pytest.raises(ApprovalNeeded):
        await guarded(bridge, SLOW.replace("sole_publisher: true", "consent: each")).do(publish({}))
    assert "publish" not in bridge.sent


async def test_reading_is_allowed_whatever_the_policy_and_the_latch_say(bridge: Noting) -> None:
    noted = Noted("latch")
    robot = held(bridge, noted, "policy: 1\nmode: observe")
    await robot.ask_service("/go/_action/get_result", "made/action/Go_GetResult", {}, timeout_s=1.0)
    await robot.do(call("made/action/Go_GetResult", "/go/_action/get_result", {}))
    assert bridge.sent == ["call", "call"]
    assert noted.seen == []


async def test_who_publishes_is_asked_only_where_a_rule_is_about_it(bridge: Noting) -> None:
    robot = guarded(bridge)
    await robot.do(publish({"speed": 0.2}, "/speed", "made/msg/Speed"))
    assert bridge.sent == ["publish"]


async def test_what_a_person_approves_has_its_value_though_no_rule_is_about_it(bridge: Noting) -> None:
    noted = Noted()
    noted.mode = "confirm"  # as an operator chooses it while the server runs
    robot = held(bridge, noted, "policy: 1\nallow: [{publish: /speed, type: '**'}]")
    await robot.do(publish({"speed": 0.5}, "/speed", "made/msg/Speed"))
    assert noted.approved == {"speed": 0.5}


async def test_it_is_decided_in_the_mode_that_holds_when_all_is_known(bridge: Noting) -> None:
    noted = Noted()
    robot = held(bridge, noted)

    async def look(*_: Any) -> Facts:
        noted.mode = "observe"  # an operator is quicker than the graph
        return Facts(value={"speed": 0.2})

    with pytest.raises(Refused, match="the mode is observe"):
        async with robot.guard.acting(publish({"speed": 0.2}, "/speed", "made/msg/Speed"), look):
            pass


async def test_what_waits_only_because_somebody_publishes_there_has_its_value_all_the_same(bridge: Noting) -> None:
    bridge.publishers = [{**ENDPOINT, "node": "joystick", "type": TWIST}]
    noted = Noted()
    rules = "{publish: /a, type: '**', sole_publisher: true}, {publish: /a, type: '**', consent: each}"
    robot = held(bridge, noted, f"policy: 1\nallow: [{rules}]")
    await robot.do(publish({"linear": {"x": 0.1}}, "/a"))
    robot.failsafes.close()
    assert noted.approved["linear"] == {"x": 0.1, "y": 0.0, "z": 0.0}


async def test_what_a_policy_says_about_itself_and_what_stops_the_robot_is_shown(bridge: Noting) -> None:
    told = await in_force(guarded(bridge, "policy: 1\nabout: Stay in hall 3.\nfeedback: {topic: /odom}"))
    assert "Stay in hall 3." in told.note
    assert any("/odom tells the robot's speed" in line for line in told.limits)


def test_every_command_has_a_verb() -> None:
    assert {verb_of(command) for command in EVERY} == {
        *("publish", "relay", "play", "record", "goal", "cancel", "call", "set", "transition")
    }
