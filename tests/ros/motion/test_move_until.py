"""ros2_move_until over real DDS: a velocity lasts until a condition on any topic holds, and no longer."""

from __future__ import annotations

import itertools
from concurrent.futures import Future
from typing import Any

import pytest

from support.agent import FULL, Agent, until
from support.commanded import CommandedProcess
from support.standstill import STOOD_STILL_S, TIMES, undisturbed

AHEAD = "nearest(-20, 20) < 0.6"
REACTS_S = 0.02
"""The bar: within one period of the messages and this. The message that meets it is the end of that period."""
ON_THE_WAY_S = 0.03
"""From one process to the other and back, beyond the bar."""
_numbers = itertools.count(1)

pytestmark = pytest.mark.timeout(600 if FULL else 120)


def place(robot: CommandedProcess, agent: Agent, **given: Any) -> str:
    """The robot anew, below a name that nobody has used before, once the server knows it."""
    base = f"/until_{next(_numbers)}"
    robot.put(base=base, **given)
    agent.knows(f"{base}/cmd_vel", f"{base}/odom", f"{base}/scan")
    return base


def placed_and_moved(agent: Agent, robot: CommandedProcess, given: dict[str, Any], **how: Any) -> dict[str, Any]:
    """The result of a robot's motion: anew where its topics were silent for half a second, as on a busy machine, by
    which a motion rightly ends.
    """
    for _ in range(TIMES):
        base = place(robot, agent, **given)
        robot.note_near(range_m=0.6)
        result = agent.call("ros2_move_until", **asked(base, **how))
        if result["outcome"] != "silent":
            break
    assert result["odometry_topic"] == f"{base}/odom"
    return result


def begun(agent: Agent, robot: CommandedProcess) -> tuple[str, Future[dict[str, Any]]]:
    """A robot, and its motion as soon as it moves: both anew where the motion has ended by itself."""
    for _ in range(TIMES):
        base = place(robot, agent)
        moving = agent.begin("ros2_move_until", **asked(base))
        until(lambda moving=moving: moving.done() or robot.state()["speed"] > 0.2)
        if not moving.done():
            break
    return base, moving


def asked(base: str, **how: Any) -> dict[str, Any]:
    given = {"topic_name": f"{base}/scan", "condition": AHEAD, "linear_x": 0.3, "timeout_s": 30}
    return {"command_topic": f"{base}/cmd_vel", **given, **how}


@pytest.mark.promise("ros2_move_until", "until a message on a topic meets a condition, checked on the robot's side")
def test_it_is_stopped_by_the_message_that_meets_the_condition(agent: Agent, robot: CommandedProcess) -> None:
    _, state = until_near(agent, robot)
    assert state["zero_at"] > max(state["near_at"], state["moved_at"]) > 0


def until_near(agent: Agent, robot: CommandedProcess) -> tuple[dict[str, Any], dict[str, Any]]:
    """A robot drives towards a thing until it is near it: the result, which says so, and its state as it stands."""
    result = placed_and_moved(agent, robot, {"discs": [[1.2, 0.0, 0.2]]})
    assert (result["outcome"], result["met"]) == ("met", True), result["note"]
    assert result["values"]["nearest(-20, 20)"] < 0.6
    assert result["stopped_with_zero"]
    return result, until(lambda: (now := robot.state())["speed"] < 1e-6 and now)


@pytest.mark.full
@pytest.mark.parametrize("_", range(20))
def test_it_is_stopped_within_a_period_of_the_message(agent: Agent, robot: CommandedProcess, _: int) -> None:
    def measured() -> tuple[dict[str, Any], dict[str, Any]]:
        for _ in range(TIMES):
            result, state = until_near(agent, robot)
            if state["stood_s"] < STOOD_STILL_S:
                break
        return result, state

    result, state = undisturbed(measured, REACTS_S)
    reacted_s = state["zero_at"] - state["near_at"]
    print(f"zero after {reacted_s * 1000:.1f} ms: {result}")
    assert 0 < reacted_s <= REACTS_S + ON_THE_WAY_S
    assert abs(result["distance_m"] - 0.4) < 0.1


@pytest.mark.promise("ros2_move_until", "If the condition is already met, nothing moves")
def test_a_condition_that_is_met_already_moves_nothing(agent: Agent, robot: CommandedProcess) -> None:
    base = place(robot, agent, discs=[[0.7, 0.0, 0.2]])
    result = agent.call("ros2_move_until", **asked(base))
    assert (result["outcome"], result["met"], result["sent"]) == ("met", True, 0)
    assert "nothing was sent" in result["note"]
    assert robot.state()["truth"][0] == 0.0


def test_it_ends_after_its_way_and_after_its_time(agent: Agent, robot: CommandedProcess) -> None:
    result = placed_and_moved(agent, robot, {}, max_distance_m=0.2)
    assert (result["outcome"], result["met"]) == ("distance", False)
    assert result["distance_m"] > 0.19
    if FULL:
        assert result["distance_m"] < 0.35
    result = placed_and_moved(agent, robot, {}, timeout_s=1.0)
    assert result["outcome"] == "timeout"
    assert result["stopped_with_zero"]


@pytest.mark.promise("ros2_move_until", "the motion ends when one falls silent")
@pytest.mark.parametrize("topic", ["scan", "odom"])
def test_it_ends_when_what_it_goes_by_is_silent(agent: Agent, robot: CommandedProcess, topic: str) -> None:
    base, moving = begun(agent, robot)
    robot.silence(topic=topic)
    result = moving.result(30)
    assert result["outcome"] == "silent", result["note"]
    assert f"{base}/{topic} has sent nothing" in result["note"]


def test_a_stop_ends_it(agent: Agent, robot: CommandedProcess) -> None:
    _, moving = begun(agent, robot)
    agent.call("ros2_stop")
    result = moving.result(30)
    assert result["outcome"] == "interrupted"
    assert "It was ended by ros2_stop" in result["note"]
    until(lambda: robot.state()["speed"] == 0.0)


def test_an_event_on_a_topic_that_is_silent_else_ends_it(agent: Agent, robot: CommandedProcess) -> None:
    base = place(robot, agent)

    def publish(pressed: bool) -> None:
        message = {"topic_name": f"{base}/bumper", "message_type": "std_msgs/msg/Bool", "data": {"data": pressed}}
        agent.call("ros2_topic_publish", **message)

    publish(False)
    agent.knows(f"{base}/bumper")
    moving = agent.begin("ros2_move_until", **asked(base, topic_name=f"{base}/bumper", condition="data", is_event=True))
    until(lambda: robot.state()["speed"] > 0.2)
    publish(True)
    result = moving.result(30)
    assert (result["outcome"], result["values"]) == ("met", {"data": True}), result["note"]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"linear_x": 0.0}, "No velocity is given"),
        ({"condition": "nearest(-20, 20)"}, "not a condition"),
        ({"condition": "rnges[0] < 1"}, "Did you mean ranges?"),
        ({"topic_name": "/not/there"}, "/not/there"),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_moves(
    agent: Agent, robot: CommandedProcess, changed: dict[str, Any], says: str
) -> None:
    base = place(robot, agent)
    assert says in agent.refusal("ros2_move_until", **asked(base, **changed))
    assert robot.state()["moved_at"] == 0.0
