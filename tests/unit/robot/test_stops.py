"""What was accepted before a stop is not sent after it, and what was sent without a known stop is named."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import Any

import anyio
import pytest

from ros2_mcp.model.commands import LOCAL, CancelGoals, Command, Principal, Publish, Record, Repeat
from ros2_mcp.model.errors import LEASE, BadValue, NotFound, Refused, Stopped
from ros2_mcp.model.qos import Choice, QoS
from ros2_mcp.ops.stop.stop import stop
from ros2_mcp.ops.topics.publish import Repetition
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp_common.wire.limits import MAX_FAILSAFES
from support.noting_bridge import CHOICE, EVERY, STAMPED, TWIST, UUID, Noting, call, goal, on
from support.tasks import soon

GONE = Principal(name="session 2", transport="http")
ACTING = [command for command in EVERY if not isinstance(command, (CancelGoals, Record))]
SENDING = {"publish", "repeat", "move", "relay", "relay_feed", "call"}


def name_of(command: Command[Any]) -> str:
    return type(command).__name__


def publish(topic: str = "/cmd_vel", value: object = None, **more: Any) -> Publish:
    return Publish(**on(topic, value=value or {}, choice=CHOICE, wait_match_s=0.0) | more)


@pytest.mark.promise("README", "What was accepted before it and has not been sent is not sent after it")
@pytest.mark.parametrize("command", ACTING, ids=name_of)
async def test_what_was_accepted_before_a_stop_is_not_sent_after_it(
    robot: Robot, bridge: Noting, command: Command[Any]
) -> None:
    session = robot.session()
    robot.raise_stop_epoch()
    with pytest.raises(Stopped, match="nothing was sent"):
        await robot.do(command, session)
    assert (bridge.sent, robot.failsafes.driven, robot.jobs.all(Goal)) == ([], [], [])
    assert not robot.stops.unknown.names("service") and not robot.stops.unknown.names("topic")


@pytest.mark.parametrize("command", ACTING, ids=name_of)
async def test_a_stop_that_comes_while_definitions_are_fetched_comes_first(
    robot: Robot, bridge: Noting, command: Command[Any]
) -> None:
    """Without a session, too: the command was accepted when `do` began."""
    bridge.may_define.clear()
    if name_of(command) == "Feed":
        pytest.skip("a feed needs no definition")
    doing = asyncio.ensure_future(robot.do(command))
    await asyncio.sleep(0.01)
    robot.raise_stop_epoch()
    bridge.may_define.set()
    with pytest.raises(Stopped):
        await doing
    assert SENDING.isdisjoint(bridge.sent) and robot.jobs.running(Goal) == []


@pytest.mark.parametrize("command", ACTING, ids=name_of)
async def test_whatever_acts_tells_the_bridge_with_which_epoch_it_was_accepted(
    robot: Robot, bridge: Noting, command: Command[Any]
) -> None:
    robot.raise_stop_epoch()
    await robot.values.learn("made/action/Go")
    if name_of(command) == "SendGoal":
        bridge.answer = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": False})
    await robot.do(command)
    (op,) = SENDING & set(bridge.sent)
    assert bridge.arguments[op]["epoch"] == 1 == bridge.stop_epoch


async def test_cancelling_and_reading_are_never_too_late(robot: Robot, bridge: Noting) -> None:
    session = robot.session()
    robot.raise_stop_epoch()
    await robot.do(CancelGoals(principal=LOCAL, name="/go", timeout_s=1.0), session)
    result = {"goal_id": {"uuid": UUID}}
    await robot.ask_service("/go/_action/get_result", "made/action/Go_GetResult", result, timeout_s=1.0)
    assert bridge.sent == ["call", "call"] and "epoch" not in bridge.arguments["call"]


async def test_a_goal_that_was_never_sent_is_none_of_ours(robot: Robot, bridge: Noting) -> None:
    bridge.refuse["call"] = "stopped"  # it waited in the bridge when the stop came
    with pytest.raises(Stopped):
        await robot.do(goal())
    [dropped] = robot.jobs.all(Goal)
    assert not dropped.is_running and not dropped.was_sent


@pytest.mark.parametrize(("kind", "reason"), [("stopped", "ros2_stop"), ("lapsed", LEASE)])
async def test_what_the_bridge_held_back_says_whether_a_stop_or_the_link_lease_came_first(
    robot: Robot, bridge: Noting, kind: str, reason: str
) -> None:
    bridge.refuse["repeat"] = kind
    command = Repeat(**on("/cmd_vel", value={}, choice=CHOICE, wait_match_s=0.0))
    repetition = Repetition(robot, robot.session(), command)
    with pytest.raises(Stopped) as held_back:
        await robot.jobs.run(repetition)
    assert (held_back.value.reason, repetition.state, repetition.stop_reason) == (reason, "stopped", reason)


async def test_a_goal_that_was_sent_is_known_although_its_server_went_out_of_sight(
    robot: Robot, bridge: Noting
) -> None:
    bridge.refuse["call"] = "server_gone"
    with pytest.raises(NotFound):
        await robot.do(goal())
    [known] = robot.jobs.running(Goal)
    assert known.was_sent
    for _ in range(2):  # its server cannot be asked: it is neither forgotten, nor without its fail-safe
        stopped = await stop(robot)
        assert not stopped.confirmed and [one.confirmed for one in stopped.goals] == [False]
    assert robot.jobs.running(Goal) == [known]
    bridge.sent.clear()
    robot.failsafes.leave_cancel(known.id, "/go")
    await asyncio.sleep(0.01)
    assert bridge.sent == []  # it is still in force
    robot.goal_ended(known.action, known.id)


async def test_each_quality_of_service_that_drove_a_topic_has_a_fail_safe(robot: Robot, bridge: Noting) -> None:
    driven = [("best_effort", "volatile"), ("reliable", "volatile"), ("reliable", "transient_local")]
    for kind in [*driven, *driven]:
        await robot.do(publish(choice=Choice(QoS(*kind), "as chosen")))
    kept = [(one["qos"]["reliability"], one["qos"]["durability"]) for one in bridge.failsafes]
    assert kept == driven
    assert len(robot.failsafes.driven) == 1


@pytest.mark.parametrize("matched", [0, 1])
async def test_a_subscriber_in_the_graph_that_was_not_matched_is_not_stopped(
    robot: Robot, bridge: Noting, matched: int
) -> None:
    await robot.do(publish())
    qos = asdict(QoS())
    bridge.subscribers = [
        {"node": name, "namespace": "/", "type": kind, "hash": "", "gid": name, "qos": qos}
        for name, kind in (("base", TWIST), ("arm", TWIST), ("odd", STAMPED))
    ]
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": matched, "acked": True if matched else None}]
    stopped = await stop(robot)
    assert (stopped.confirmed, stopped.topics[0].unreached_subscribers) == (False, 2 - matched)
    assert "did not get the zero" in stopped.note and "no subscriber" not in stopped.note
    assert robot.moves_for(LOCAL)
    bridge.zeros[0] |= {"matched": 2, "acked": True}
    assert not (await stop(robot)).is_doubted and not robot.moves_for(LOCAL)


# ── what is driven ─────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.promise("README", "one more is refused")
async def test_the_topic_beyond_the_limit_is_refused_and_no_other_loses_its_fail_safe(
    robot: Robot, bridge: Noting
) -> None:
    for number in range(MAX_FAILSAFES):
        await robot.do(publish(f"/robot{number}/cmd_vel"))
    bridge.sent.clear()
    with pytest.raises(Refused, match="drives 64 velocity topics already"):
        await robot.do(publish("/one_more"))
    assert bridge.sent == []
    await robot.do(publish("/robot0/cmd_vel"))  # those that have a place go on


async def test_a_topic_whose_zero_was_confirmed_makes_room(robot: Robot, bridge: Noting) -> None:
    for number in range(MAX_FAILSAFES):
        await robot.do(publish(f"/robot{number}/cmd_vel"))
    bridge.zeros = [{"topic": "/robot7/cmd_vel", "type": TWIST, "matched": 1, "acked": True}]
    await robot.stop_bridge()
    await robot.do(publish("/one_more"))
    topics = [driven.topic for driven in robot.failsafes.driven]
    assert len(topics) == MAX_FAILSAFES and "/robot7/cmd_vel" not in topics and "/one_more" in topics


async def test_a_repeat_that_ended_with_its_zero_makes_room_once_the_zero_is_acknowledged(
    robot: Robot, bridge: Noting
) -> None:
    await robot.do(Repeat(**on("/robot0/cmd_vel", value={}, choice=CHOICE, wait_match_s=0.0)))
    for number in range(1, MAX_FAILSAFES):
        await robot.do(publish(f"/robot{number}/cmd_vel"))
    bridge.zeros = [{"topic": "/robot0/cmd_vel", "type": TWIST, "matched": 1, "acked": False}]
    with pytest.raises(Refused):
        await robot.do(publish("/one_more"))
    assert bridge.arguments["zero"]["topics"] == ["/robot0/cmd_vel"]
    bridge.zeros[0]["acked"] = True
    await robot.do(publish("/one_more"))


async def test_a_topic_that_was_commanded_again_is_not_at_rest(robot: Robot, bridge: Noting) -> None:
    await robot.do(publish())
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": 1, "acked": True}]
    bridge.may_answer.clear()
    stopping = asyncio.ensure_future(robot.stop_bridge())
    await soon(lambda: "stop" in bridge.sent)
    moving = asyncio.ensure_future(robot.do(publish()))
    await soon(lambda: bridge.sent.count("publish") == 2)
    bridge.may_answer.set()
    await asyncio.gather(stopping, moving)
    assert robot.moves_for(LOCAL)


async def test_a_repeat_that_is_answered_late_does_not_end_what_was_commanded_since(
    robot: Robot, bridge: Noting
) -> None:
    bridge.may_answer.clear()
    repeating = asyncio.ensure_future(robot.do(Repeat(**on("/cmd_vel", value={}, choice=CHOICE, wait_match_s=0.0))))
    await soon(lambda: "repeat" in bridge.sent)
    moving = asyncio.ensure_future(robot.do(publish()))
    await soon(lambda: "publish" in bridge.sent)
    bridge.may_answer.set()
    await asyncio.gather(repeating, moving)
    assert robot.moves_for(LOCAL)


@pytest.mark.promise("stopping", "publish refuses it with the path of the field")
@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e400, "nan", "inf", "-inf"])
@pytest.mark.parametrize("kind", [TWIST, STAMPED])
async def test_a_velocity_that_is_not_finite_is_refused_and_named(
    robot: Robot, bridge: Noting, kind: str, number: object
) -> None:
    twist = {"angular": {"z": number}}
    value, path = (twist, "angular.z") if kind == TWIST else ({"twist": twist}, r"twist\.angular\.z")
    for make in (publish, lambda **more: Repeat(**on("/cmd_vel", choice=CHOICE, wait_match_s=0.0) | more)):
        with pytest.raises(BadValue, match=rf"^{path}: .*finite"):
            await robot.do(make(value=value, type=kind))
    assert bridge.sent == []


async def test_the_zero_of_a_successor_has_the_frame_of_the_last_command(robot: Robot, bridge: Noting) -> None:
    await robot.do(publish(type=STAMPED, value={"header": {"frame_id": "base"}}))
    assert bridge.arguments["failsafe_publish"]["frame"] == "base"


# ── what has no known stop ─────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.promise("README", "so it is not confirmed until the robot was seen to stand after them")
async def test_a_stop_names_what_it_cannot_stop_and_is_not_confirmed_then(robot: Robot, bridge: Noting) -> None:
    assert "NOT judged" not in (await stop(robot)).note
    await robot.do(call("std_srvs/srv/SetBool", "/grip", {"data": True}))
    await robot.do(Publish(**on("/arm", value={}, choice=CHOICE, wait_match_s=0.0) | {"type": "std_msgs/msg/Int32"}))
    for _ in range(2):  # until the robot is seen to stand
        stopped = await stop(robot)
        assert stopped.unknown_services == ["/grip (std_srvs/srv/SetBool)"]
        assert stopped.unknown_topics == ["/arm (std_msgs/msg/Int32)"]
        assert not stopped.confirmed and "/grip" in stopped.summary()


CONFIGURING = [
    call("rcl_interfaces/srv/SetParameters", "/lidar/set_parameters", {"parameters": []}),
    call("lifecycle_msgs/srv/ChangeState", "/lidar/change_state", {"transition": {"label": "activate"}}),
]


@pytest.mark.promise("README", "Parameters that were set and lifecycle transitions are configuration")
@pytest.mark.promise("stopping", "they are not named, and hinder no confirmation")
@pytest.mark.parametrize("command", CONFIGURING, ids=("parameters", "transition"))
async def test_configuring_a_node_hinders_no_confirmation(robot: Robot, bridge: Noting, command: Command[Any]) -> None:
    await robot.do(command)
    stopped = await stop(robot)
    assert (bridge.sent.count("call"), stopped.unknown_services, robot.stops.unknown.unsettled()) == (1, [], [])
    assert "NOT judged" not in stopped.note


@pytest.mark.promise("stopping", "The text of the answer begins with what is confirmed, and says last what")
async def test_what_is_confirmed_is_said_first_and_what_is_not_judged_last(robot: Robot, bridge: Noting) -> None:
    await robot.do(call("std_srvs/srv/SetBool", "/grip", {"data": True}))
    assert (await stop(robot)).summary().startswith("Nothing was stopped. ")
    await robot.do(publish())
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": 1, "acked": True}]
    told = (await stop(robot)).summary()
    assert told.startswith("Stopped, partly confirmed: zero on 1 topic.")
    assert "/grip" in told.partition("NOT judged: ")[2]


async def test_a_service_that_was_not_there_or_a_call_that_was_stopped_has_set_nothing_in_motion(
    robot: Robot, bridge: Noting
) -> None:
    for kind in ("not_found", "stopped"):
        bridge.refuse["call"] = kind
        with pytest.raises(Exception):  # noqa: B017 - which one is the affair of others
            await robot.do(call("std_srvs/srv/SetBool", "/grip", {"data": True}))
    assert robot.stops.unknown.names("service") == []
    bridge.refuse["call"] = "timeout"
    with pytest.raises(Exception):  # noqa: B017
        await robot.do(call("std_srvs/srv/SetBool", "/grip", {"data": True}))
    assert robot.stops.unknown.names("service") == ["/grip (std_srvs/srv/SetBool)"]


async def test_what_was_sent_before_the_robot_was_seen_to_stand_leaves_no_later_stop_open(robot: Robot) -> None:
    sent, grip = robot.stops.unknown, ("service", "/grip (std_srvs/srv/SetBool)")
    await robot.do(call("std_srvs/srv/SetBool", "/grip", {"data": True}))
    assert sent.unsettled() == [grip]
    sent.settle(sent.unsettled())
    assert sent.unsettled() == [] and sent.names("service") == [grip[1]]
    await robot.do(call("std_srvs/srv/SetBool", "/grip", {"data": True}))
    with sent.sending("service", "/global_costmap/clear", "nav2_msgs/srv/ClearEntireCostmap"):
        assert sent.unsettled() == [grip]
    with sent.sending("topic", "/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped"):
        assert sent.unsettled() == [grip]
    with sent.sending("service", "/grip", "std_srvs/srv/SetBool"):
        sent.settle(sent.unsettled())
        assert sent.unsettled() == [grip]  # it is under way


async def test_whoever_took_a_command_and_is_gone_leaves_a_stop_open_until_it_is_back(
    robot: Robot, bridge: Noting
) -> None:
    base = {"node": "base", "namespace": "/", "type": TWIST, "hash": "", "gid": "1", "qos": asdict(QoS())}
    bridge.subscribers = [base]
    await robot.graph.endpoints("/cmd_vel")
    await robot.do(publish())
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": 0, "acked": None}]
    bridge.subscribers = [{**base, "node": "somebody_else"}]
    for _ in range(2):
        stopped = await stop(robot)
        assert stopped.is_doubted and "/base received commands on /cmd_vel and has left" in stopped.note
        assert stopped.topics[0].is_deserted
    bridge.subscribers = [{**base, "node": "_NODE_NAME_UNKNOWN_", "namespace": "_NODE_NAMESPACE_UNKNOWN_"}]
    stopped = await stop(robot)
    assert stopped.is_doubted and not stopped.topics[0].is_deserted  # it may be the base
    bridge.zeros[0] |= {"matched": 1, "acked": True}
    bridge.subscribers = [base]
    assert not (await stop(robot)).is_doubted


async def test_a_call_that_is_still_waiting_for_its_answer_is_named(robot: Robot, bridge: Noting) -> None:
    await robot.values.learn("std_srvs/srv/SetBool")
    bridge.may_answer.clear()
    calling = asyncio.ensure_future(robot.do(call("std_srvs/srv/SetBool", "/grip", {"data": True})))
    await soon(lambda: "call" in bridge.sent)
    assert robot.stops.unknown.names("service") == ["/grip (std_srvs/srv/SetBool)"]
    calling.cancel()
    await asyncio.wait({calling})
    assert robot.stops.unknown.names("service") == ["/grip (std_srvs/srv/SetBool)"]


# ── the stop itself ────────────────────────────────────────────────────────────────────────────────────────────────


async def test_a_topic_of_which_the_bridge_says_nothing_is_not_confirmed(robot: Robot) -> None:
    await robot.do(publish())
    stopped = await stop(robot)
    assert not stopped.confirmed and "/cmd_vel got no zero" in stopped.note


async def test_a_stop_is_finished_although_its_call_is_cancelled(robot: Robot, bridge: Noting) -> None:
    await robot.do(publish())
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": 1, "acked": True}]
    bridge.may_answer.clear()
    async with anyio.create_task_group() as calls:
        calls.start_soon(stop, robot)
        await soon(lambda: "stop" in bridge.sent)
        calls.cancel_scope.cancel()
        bridge.may_answer.set()
    assert not robot.moves_for(LOCAL)


@pytest.mark.promise("stopping", "the bridge was lost or could not be asked")
async def test_a_bridge_that_cannot_be_asked_leaves_nothing_confirmed(robot: Robot, bridge: Noting) -> None:
    bridge.refuse["stop"] = "ros_error"
    stopped = await stop(robot)
    assert not stopped.confirmed
    assert stopped.note.startswith(
        "The bridge could not be asked to stop (It is refused): its publications may continue."
    )


async def test_the_end_of_a_client_ends_its_motion_and_nobody_elses(robot: Robot, bridge: Noting) -> None:
    gone = robot.session(GONE)
    await robot.do(publish("/a", principal=GONE), gone)
    await robot.do(publish("/b"))
    bridge.may_answer.clear()
    waiting = asyncio.ensure_future(robot.do(publish("/a", principal=GONE), gone))
    await soon(lambda: bridge.sent.count("publish") == 3)
    assert (robot.moves_for(GONE), robot.moves_for(LOCAL)) == (True, True)
    bridge.zeros = [{"topic": "/a", "type": TWIST, "matched": 1, "acked": True}]
    ending = asyncio.ensure_future(robot.stop_owned(GONE, "the end of its session"))
    await asyncio.sleep(0.01)
    bridge.may_answer.set()
    with pytest.raises(Stopped, match="has gone"):
        await waiting
    assert await ending == ["zero on /a"]
    assert bridge.arguments["zero"]["topics"] == ["/a"]
    assert (robot.moves_for(GONE), robot.moves_for(LOCAL)) == (False, True)
    with pytest.raises(Stopped):
        await robot.do(publish("/a", principal=GONE), gone)
    await robot.do(publish("/a", principal=GONE))  # a later call of the same client
