"""What `Robot.do` does before a command leaves, and what it never does: nothing is known or left of a refused one."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any, cast

import pytest

from ros2_mcp.guard.guard import Guard
from ros2_mcp.guard.policy import Policy
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import (
    LOCAL,
    CancelGoals,
    ChangeState,
    Command,
    Publish,
    SendGoal,
    ServiceCall,
    SetParameters,
)
from ros2_mcp.model.errors import BadValue, Refused
from ros2_mcp.model.goals import STATUS_TYPE
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp.robot.translation import as_meant
from support.noting_bridge import CHOICE, EVERY, GOAL_ID, TWIST, UUID, Noting, call, goal, on
from support.tasks import soon


@pytest.mark.parametrize("command", EVERY, ids=lambda command: type(command).__name__)
async def test_of_a_refused_command_nothing_is_sent_left_or_known(bridge: Noting, command: Command[Any]) -> None:
    robot = Robot(cast(Bridge, bridge), Guard(Policy(read_only=True)))
    with pytest.raises(Refused, match="read-only"):
        await robot.do(command)
    await asyncio.sleep(0)
    assert bridge.sent == []
    assert (robot.failsafes.driven, robot.jobs.all(Goal)) == ([], [])


@pytest.mark.parametrize("command", EVERY[:4], ids=lambda command: type(command).__name__)
async def test_whatever_drives_leaves_a_zero_and_is_known_to_drive(
    robot: Robot, bridge: Noting, command: Command[Any]
) -> None:
    await robot.do(command)
    await asyncio.sleep(0)
    assert bridge.sent[0] == "failsafe_publish"
    assert [(driven.topic, driven.type) for driven in robot.failsafes.driven] == [("/cmd_vel", TWIST)]


async def test_what_does_not_drive_leaves_none(robot: Robot, bridge: Noting) -> None:
    kind = "std_msgs/msg/Int32"
    number = Publish(principal=LOCAL, name="/n", type=kind, value={"data": 1}, choice=CHOICE, wait_match_s=0.0)
    assert (await robot.do(number)).matched == 1
    assert bridge.sent == ["publish"]


async def test_a_value_that_does_not_fit_leaves_nothing(robot: Robot, bridge: Noting) -> None:
    with pytest.raises(BadValue, match="linear"):
        await robot.do(Publish(**on("/cmd_vel", value={"linear": 1}, choice=CHOICE, wait_match_s=0.0)))
    with pytest.raises(BadValue, match="order"):
        await robot.do(goal(value={"order": "three"}))
    assert (bridge.sent, robot.failsafes.driven, robot.jobs.all(Goal)) == ([], [], [])


@pytest.mark.parametrize("accepted", [True, False])
async def test_a_goal_is_known_as_long_as_its_server_has_it(robot: Robot, bridge: Noting, accepted: bool) -> None:
    await robot.values.learn("made/action/Go")
    bridge.answer = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": accepted})
    await robot.do(goal())
    [known] = robot.jobs.all(Goal)
    assert (known.id, known.is_running, known.is_accepted) == (GOAL_ID, accepted, accepted)
    robot.goal_ended("/go", GOAL_ID)


async def test_a_goal_that_nobody_awaits_ends_with_what_its_action_tells(robot: Robot, bridge: Noting) -> None:
    await robot.values.learn("made/action/Go", STATUS_TYPE)
    bridge.answer = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": True})
    other_id = GOAL_ID[::-1]
    for goal_id in (GOAL_ID, other_id):
        await robot.do(replace(goal(), goal_id=goal_id))

    def tell(**codes: int) -> None:
        states = [
            {"goal_info": {"goal_id": {"uuid": list(bytes.fromhex(goal_id[1:]))}}, "status": code}
            for goal_id, code in codes.items()
        ]
        body = robot.values.encode_known(STATUS_TYPE, {"status_list": states})
        header: Any = {"samples": [(1, 1, 1, len(body), 0)], "received": 1, "dropped": 0, "lost": 0}
        bridge.listening["/go/_action/status"].arrived(header, body)

    await soon(lambda: list(bridge.listening) == ["/go/_action/status"])  # one for both
    tell(**{f"_{GOAL_ID}": 2, f"_{other_id}": 4})
    await soon(lambda: [known.id for known in robot.jobs.running(Goal)] == [GOAL_ID])
    assert robot.moves_for(LOCAL)
    await soon(lambda: bool(bridge.listening))
    tell(**{f"_{GOAL_ID}": 5})
    await soon(lambda: not robot.jobs.running(Goal) and not bridge.listening)
    assert not robot.moves_for(LOCAL)


async def test_a_second_goal_of_the_same_id_that_is_refused_leaves_the_first_known(
    robot: Robot, bridge: Noting
) -> None:
    await robot.values.learn("made/action/Go")
    for accepted in (True, False):
        bridge.answer = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": accepted})
        await robot.do(goal())
    assert [known.id for known in robot.jobs.running(Goal)] == [GOAL_ID]
    robot.goal_ended("/go", GOAL_ID)
    await robot.jobs.close()


async def test_what_only_the_server_of_an_action_publishes_is_refused(robot: Robot, bridge: Noting) -> None:
    for command in EVERY[:4]:
        with pytest.raises(Refused, match="published by the server of an action"):
            await robot.do(replace(command, name="/go/_action/status"))
    assert bridge.sent == []


async def test_a_goal_with_the_id_of_one_of_another_action_is_refused_and_ends_nothing(
    robot: Robot, bridge: Noting
) -> None:
    """A stop finds goals by their ids: of two it would cancel one, and call the other somebody else's."""
    await robot.values.learn("made/action/Go")
    bridge.answer = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": True})
    await robot.do(goal())
    sent = len(bridge.sent)
    with pytest.raises(BadValue, match="the id of a goal of /go already"):
        await robot.do(replace(goal(), name="/other"))
    robot.goal_ended("/other", GOAL_ID)  # as the status of that action may say of another client's goal
    assert [(known.id, known.action) for known in robot.jobs.running(Goal)] == [(GOAL_ID, "/go")]
    assert len(bridge.sent) == sent
    robot.goal_ended("/go", GOAL_ID)
    with pytest.raises(BadValue, match="Give 16 random bytes"):
        await robot.do(replace(goal(), name="/other"))
    await robot.jobs.close()


# ── what a service call means ──────────────────────────────────────────────────────────────────────────────────────


async def meaning(robot: Robot, command: ServiceCall) -> Command[Any]:
    return (await as_meant(Prepared(robot.values, robot.session(), command))).command


async def test_a_plain_call_is_what_it_is(robot: Robot) -> None:
    plain = call("std_srvs/srv/SetBool", "/switch", {"data": True})
    assert (await meaning(robot, plain)) is plain


async def test_a_raw_goal_is_a_goal_with_the_id_of_the_request(robot: Robot) -> None:
    value = {"goal_id": {"uuid": UUID}, "goal": {"order": 5}}
    meant = await meaning(robot, call("made/action/Go_SendGoal", "/arm/go/_action/send_goal", value))
    assert isinstance(meant, SendGoal)
    assert (meant.name, meant.type, meant.goal_id, meant.value) == ("/arm/go", "made/action/Go", GOAL_ID, {"order": 5})
    assert (meant.service, meant.service_type) == ("/arm/go/_action/send_goal", "made/action/Go_SendGoal")
    assert (meant.principal, meant.timeout_s, meant.wait_s) == (LOCAL, 1.0, 0.5)


async def test_a_raw_goal_without_an_id_is_refused_since_nobody_could_cancel_it(robot: Robot) -> None:
    with pytest.raises(BadValue, match=r"goal_id\.uuid"):
        await meaning(robot, call("made/action/Go_SendGoal", "/go/_action/send_goal", {"goal": {"order": 5}}))


@pytest.mark.parametrize("uuid, goal_id", [(UUID, GOAL_ID), ([0] * 16, "")])
async def test_a_raw_cancel_means_one_goal_or_all(robot: Robot, uuid: list[int], goal_id: str) -> None:
    info = {"goal_id": {"uuid": uuid}, "stamp": {"sec": 7, "nanosec": 8}}
    meant = await meaning(robot, call("action_msgs/srv/CancelGoal", "/go/_action/cancel_goal", {"goal_info": info}))
    assert isinstance(meant, CancelGoals)
    assert (meant.name, meant.goal_id, meant.stamp) == ("/go", goal_id, {"sec": 7, "nanosec": 8})
    assert meant.request == {"goal_info": info}


async def test_raw_parameters_are_a_parameter_set(robot: Robot) -> None:
    value = {"parameters": [{"name": "speed", "value": {"type": 3, "double_value": 0.5}}]}
    meant = await meaning(robot, call("rcl_interfaces/srv/SetParameters", "/arm/node/set_parameters", value))
    assert isinstance(meant, SetParameters)
    assert (meant.name, meant.service, meant.parameters) == ("/arm/node", "/arm/node/set_parameters", {"speed": 0.5})
    assert meant.request == value


async def test_a_raw_transition_is_a_change_of_state(robot: Robot) -> None:
    value = {"transition": {"id": 3, "label": "activate"}}
    meant = await meaning(robot, call("lifecycle_msgs/srv/ChangeState", "/arm/node/change_state", value))
    assert isinstance(meant, ChangeState)
    assert (meant.name, meant.transition, meant.transition_id) == ("/arm/node", "activate", 3)


async def test_a_service_that_may_change_something_is_not_asked(robot: Robot, bridge: Noting) -> None:
    for kind in ("std_srvs/srv/SetBool", "rcl_interfaces/srv/SetParameters", "made/action/Go_SendGoal"):
        with pytest.raises(ValueError, match="needs a command"):
            await robot.ask_service("/any", kind, {}, timeout_s=1.0)
    assert bridge.sent == []


@pytest.mark.parametrize(
    ("kind", "service"), [("made/action/Go_SendGoal", "/proxy/send"), ("action_msgs/srv/CancelGoal", "/proxy/cancel")]
)
async def test_a_service_of_such_a_type_that_is_no_actions_is_called_as_it_is_named(
    bridge: Noting, kind: str, service: str
) -> None:
    robot = Robot(cast(Bridge, bridge))
    command = call(kind, service, {})
    assert (await meaning(robot, command)) is command
