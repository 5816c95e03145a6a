"""ros2_drive over real DDS, against a robot with simulated physics: a few rounds here, 20 of each in full."""

from __future__ import annotations

import itertools
import math
import random
import re
from concurrent.futures import Future
from typing import Any

import pytest

from support.agent import FULL, Agent, Refusal, until
from support.commanded import CommandedProcess
from support.physics import surroundings
from support.standstill import STOOD_STILL_S, TIMES, standstills

ROUNDS = 20 if FULL else 1
MOST_M, MOST_DEG = 0.02, 1.0
LATE_S = 0.1
"""The bar: a zero, after the period in which something was to come."""
HELD_UP_S = 0.05
"""The shortest standstill that makes a difference to that."""
_numbers = itertools.count(1)

pytestmark = pytest.mark.timeout(600 if FULL else 120)


def place(robot: CommandedProcess, agent: Agent, **given: Any) -> str:
    """The robot anew, below a name that nobody has used before, once the server knows it."""
    base = f"/robot_{next(_numbers)}"
    robot.put(base=base, **given)
    seen = {"": (), "cloud": ("points",), "two": ("front", "rear")}.get(given.get("sees", "scan"), ("scan",))
    agent.knows(*(f"{base}/{topic}" for topic in ("cmd_vel", "odom", "robot_description", *seen)))
    return base


def drive(agent: Agent, base: str, **how: Any) -> dict[str, Any]:
    return agent.call("ros2_drive", topic_name=f"{base}/cmd_vel", **how)


def placed_and_driven(
    agent: Agent, robot: CommandedProcess, given: dict[str, Any], **how: Any
) -> tuple[str, dict[str, Any]]:
    """A robot, and its drive's result: both anew where its topics were silent for half a second, as on a busy machine,
    by which a drive rightly ends.
    """
    for _ in range(TIMES):
        base = place(robot, agent, **given)
        result = drive(agent, base, **how)
        if result["outcome"] != "silent":
            break
    return base, result


def begun(agent: Agent, robot: CommandedProcess, above: float, **how: Any) -> tuple[str, Future[dict[str, Any]]]:
    """A robot, and its drive as soon as it is faster than this: both anew where the drive has ended by itself."""
    for _ in range(TIMES):
        base = place(robot, agent)
        driving = agent.begin("ros2_drive", topic_name=f"{base}/cmd_vel", **how)
        until(lambda driving=driving: driving.done() or robot.state()["speed"] > above)
        if not driving.done():
            break
    return base, driving


def truth(robot: CommandedProcess) -> tuple[float, float, float]:
    """Where it stands, once it does."""
    state = until(lambda: (now := robot.state())["speed"] < 1e-6 and now)
    x, y, yaw = state["truth"]
    return x, y, yaw


@pytest.mark.promise("ros2_drive", "Reports how far it came and what ended it")
@pytest.mark.parametrize("seed", range(ROUNDS))
def test_it_comes_to_stand_where_it_was_told(agent: Agent, robot: CommandedProcess, seed: int) -> None:
    rng = random.Random(seed)
    given = {"seed": seed, "slip": 0.02, "noise_m": 0.001, "delay_s": rng.uniform(0.0, 0.1)}
    distance_m = rng.uniform(0.2, 0.5) * rng.choice([1, -1])
    base, result = placed_and_driven(agent, robot, given, distance_m=distance_m, speed=0.3)
    x, y, _ = truth(robot)
    odometry = robot.state()["odometry"]
    print(f"{distance_m:.3f} m: {result}, truth {x:.4f} {y:.4f}, odometry {odometry}")
    assert result["outcome"] == "reached", result["note"]
    assert abs(result["error"]) == pytest.approx(abs(result["measured"] - distance_m), abs=0.001)
    assert result["measured"] == pytest.approx(odometry[0], abs=MOST_M), "what it says is where it came to"
    if FULL:
        assert abs(result["error"]) <= MOST_M
        assert abs(odometry[0] - distance_m) <= MOST_M
        assert abs(x - distance_m) <= MOST_M + abs(x - odometry[0])
    assert result["odometry"] == f"{base}/odom"


def test_it_turns_on_the_spot(agent: Agent, robot: CommandedProcess) -> None:
    _, result = placed_and_driven(agent, robot, {}, angle_deg=-40, speed=60)
    _, _, yaw = truth(robot)
    assert (result["outcome"], result["unit"]) == ("reached", "deg")
    assert result["measured"] == pytest.approx(math.degrees(yaw), abs=MOST_DEG)
    if FULL:
        assert abs(math.degrees(yaw) + 40) <= MOST_DEG
        assert abs(result["measured"] + 40) <= MOST_DEG


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_it_parks_before_what_stands_in_its_way(agent: Agent, robot: CommandedProcess, seed: int) -> None:
    gap_m = random.Random(seed).uniform(0.3, 0.4)
    given = {"discs": [[0.9, 0.0, 0.2]]}  # 0.5 m before the body
    base, result = placed_and_driven(agent, robot, given, distance_m=2.0, speed=0.3, guard_m=gap_m)
    truth(robot)
    nearest = robot.state()["nearest"]
    print(f"kept {gap_m:.3f} m: {nearest:.3f} m, {result}")
    assert result["outcome"] == "guard", result["note"]
    assert 0.0 < nearest <= gap_m + 0.06
    if FULL:
        assert gap_m - 0.01 <= nearest
    assert f"The robot's size comes from {base}/robot_description: 0.20 m ahead" in result["note"]
    assert "The nearest obstacle is" in result["note"]
    assert result["guard_m"] == pytest.approx(gap_m)


@pytest.mark.full  # each round is some seconds of driving; a thousand are stepped in tests/unit/bridge/test_drive.py
@pytest.mark.parametrize("seed", range(ROUNDS))
@pytest.mark.parametrize("is_default", [True, False])
def test_it_runs_into_nothing_of_what_moves_around_it(
    agent: Agent, robot: CommandedProcess, seed: int, is_default: bool
) -> None:
    rng = random.Random(seed)
    for _ in range(TIMES):  # again where this machine held up the robot's process or the bridge
        discs = surroundings(rng)
        base = place(robot, agent, discs=[[disc.x, disc.y, disc.radius, disc.vx, disc.vy] for disc in discs], seed=seed)
        distance_m, speed = rng.uniform(0.5, 1.5) * rng.choice([1, -1]), rng.uniform(0.2, 0.6)
        with standstills(STOOD_STILL_S) as held_up:
            guard = {} if is_default else {"guard_m": rng.uniform(0.1, 0.5)}
            result = drive(agent, base, distance_m=distance_m, speed=speed, **guard)
            truth(robot)
        state = robot.state()
        if state["stood_s"] < STOOD_STILL_S and not held_up:
            break
    moving = sum(bool(disc.vx or disc.vy) for disc in discs)
    print(f"among {len(discs)}, of which {moving} move: {state['nearest']:.3f} m near, {result}")
    assert state["collisions"] == 0
    assert result["outcome"] in ("reached", "guard"), result["note"]


def silenced(agent: Agent, robot: CommandedProcess, topic: str) -> dict[str, Any]:
    """A robot drives by what falls silent: the result, which says so."""
    base, driving = begun(agent, robot, 0.15, distance_m=20.0, speed=0.2, guard_m=0.2)
    robot.silence(topic=topic)
    result = driving.result(60)
    assert result["outcome"] == "silent", result["note"]
    assert f"{base}/{topic} has sent nothing" in result["note"]
    return result


@pytest.mark.promise("ros2_drive", "Stops when odometry or scan falls silent")
@pytest.mark.promise("stopping", "odometry or scan is silent while `ros2_drive` or `ros2_move_until` goes by it")
@pytest.mark.parametrize("topic", ["odom", "scan"])
def test_it_stands_when_what_it_goes_by_is_silent(agent: Agent, robot: CommandedProcess, topic: str) -> None:
    silenced(agent, robot, topic)
    truth(robot)
    state = robot.state()
    assert state["zero_at"] > max(state["moved_at"], state[f"{topic}_at"]) > 0


@pytest.mark.full
@pytest.mark.promise("stopping", "0.1 s after the message that did not come")
@pytest.mark.parametrize("topic", ["odom", "scan"])
@pytest.mark.parametrize("_", range(20))
def test_it_stands_at_once_when_what_it_goes_by_is_silent(
    agent: Agent, robot: CommandedProcess, topic: str, _: int
) -> None:
    for _ in range(TIMES):  # again where the robot's process or this one was held up, and so perhaps the bridge
        with standstills(HELD_UP_S) as held_up:
            silenced(agent, robot, topic)
        state = robot.state()
        if state["stood_s"] < HELD_UP_S and not held_up:
            break
    period_s = 0.04 if topic == "odom" else 0.1
    zero_s = state["zero_at"] - state[f"{topic}_at"]
    print(f"{topic}: a zero {zero_s:.3f} s after its last message, a period of {period_s:g} s")
    assert state["moved_at"] < state["zero_at"]
    assert zero_s <= period_s + LATE_S


def test_a_robot_that_is_stuck_is_told_with_what_may_hold_it(agent: Agent, robot: CommandedProcess) -> None:
    """A thing before it, a driver's limit of 0, and somebody else who commands it."""
    for name, value in (("max_linear_vel", 0.0), ("max_vel_y", 0.0), ("max_accel", 0.0), ("max_angular_vel", 1.0)):
        robot.limit(name=name, value=value)
    given = {"deadband": 9.0, "discs": [[0.55, 0.0, 0.2]]}
    base, result = placed_and_driven(agent, robot, given, distance_m=1.0, speed=0.3, guard_m=0.1)
    robot.limit(name="max_linear_vel", value=1.0)
    assert result["outcome"] == "stuck"
    nearest = re.search(f"{base}/scan: nearest obstacle (0.1[0-9]) m from the robot's outline", result["note"])
    assert nearest, result["note"]
    assert float(nearest[1]) == pytest.approx(0.15, abs=0.025)  # the nearest of five beams, each 5 mm wrong
    assert "/driven_robot has the limit max_linear_vel = 0.0." in result["note"]


def towards_a_wall(agent: Agent, robot: CommandedProcess, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """A drive with default arguments: its result, and the state of the robot that stands."""
    rng = random.Random(seed)
    wall_m, wide = rng.uniform(0.6, 1.5), 1000.0  # as good as flat
    given = {"seed": seed, "discs": [[wall_m + wide, 0.0, wide]], "delay_s": rng.uniform(0.0, 0.1)}
    _, result = placed_and_driven(agent, robot, given, distance_m=5.0)
    truth(robot)
    state = robot.state()
    print(f"wall at {wall_m:.2f} m: {state['nearest']:.3f} m near, {result}")
    return result, state


@pytest.mark.promise("ros2_drive", "Keeps clear of obstacles")
def test_without_a_word_of_obstacles_it_stops_before_a_wall(agent: Agent, robot: CommandedProcess) -> None:
    result, state = towards_a_wall(agent, robot, 0)
    assert (result["outcome"], result["guard_m"]) == ("guard", 0.2)
    assert result["free_m"] < 0.3, "told from the outline"
    assert state["collisions"] == 0


@pytest.mark.full
@pytest.mark.parametrize("seed", range(50))
def test_it_touches_no_wall_with_default_arguments(agent: Agent, robot: CommandedProcess, seed: int) -> None:
    for _ in range(TIMES):  # again where this machine held up the robot's process or the bridge
        with standstills(STOOD_STILL_S) as held_up:
            result, state = towards_a_wall(agent, robot, seed)
        if state["stood_s"] < STOOD_STILL_S and not held_up:
            break
    assert (result["outcome"], result["guard_m"], state["collisions"]) == ("guard", 0.2, 0)
    assert 0.19 <= state["nearest"] <= 0.26
    assert result["free_m"] == pytest.approx(state["nearest"], abs=0.05), "told from the outline"


def test_a_guard_of_zero_looks_at_nothing_and_the_result_says_so(agent: Agent, robot: CommandedProcess) -> None:
    given = {"discs": [[0.65, 0.0, 0.2]]}  # 0.25 m before the body
    base, result = placed_and_driven(agent, robot, given, distance_m=0.15, guard_m=0)
    assert (result["outcome"], result["guard_m"], result["free_m"]) == ("reached", 0.0, None)
    assert "guard_m" in result["note"]
    assert "guard_m=0" in agent.refusal("ros2_drive", distance_m=0.1, guard_m=0, scan=f"{base}/scan")


def test_a_robot_without_sensors_says_of_a_long_way_that_it_was_blind(agent: Agent, robot: CommandedProcess) -> None:
    _, short = placed_and_driven(agent, robot, {"sees": ""}, distance_m=0.2)
    assert (short["outcome"], short["guard_m"], "blind" in short["note"]) == ("reached", 0.0, False)
    base, far = placed_and_driven(agent, robot, {"sees": ""}, distance_m=-1.1, speed=0.6)
    assert (far["outcome"], "blind" in far["note"]) == ("reached", True)
    assert "scan" in agent.refusal("ros2_drive", topic_name=f"{base}/cmd_vel", distance_m=0.2, guard_m=0.3)


def test_a_camera_that_sees_in_depth_guards_as_a_scanner_does(agent: Agent, robot: CommandedProcess) -> None:
    given = {"sees": "cloud", "discs": [[0.9, 0.0, 0.2]]}  # 0.5 m before the body
    base, result = placed_and_driven(agent, robot, given, distance_m=2.0, speed=0.3)
    truth(robot)
    assert (result["outcome"], result["guard_m"], result["scan"]) == ("guard", 0.2, f"{base}/points")
    assert 0.0 < robot.state()["nearest"] <= 0.26
    back = drive(agent, base, distance_m=-0.3)
    assert back["outcome"] == "guard", "it looks ahead alone"
    assert not back["measured"]
    assert "guard_m=0" in back["note"]


def test_with_two_scanners_both_ways_are_guarded(agent: Agent, robot: CommandedProcess) -> None:
    given = {"sees": "two", "discs": [[-0.9, 0.0, 0.2]]}  # 0.5 m behind the body
    base, ahead = placed_and_driven(agent, robot, given, distance_m=0.1)
    assert (ahead["outcome"], ahead["scan"]) == ("reached", f"{base}/rear, {base}/front")
    _, back = placed_and_driven(agent, robot, given, distance_m=-2.0, speed=0.3)
    truth(robot)
    assert back["outcome"] == "guard", back["note"]
    assert 0.0 < robot.state()["nearest"] <= 0.26


def test_a_sensor_that_is_silent_is_no_guard_and_it_says_what_drives_without(
    agent: Agent, robot: CommandedProcess
) -> None:
    base = place(robot, agent)
    robot.silence(topic="scan")
    refused = agent.refusal("ros2_drive", topic_name=f"{base}/cmd_vel", distance_m=0.2)
    assert f"{base}/scan" in refused and "guard_m=0" in refused
    assert robot.state()["moved_at"] == 0.0


def test_a_stop_ends_it_and_it_says_so(agent: Agent, robot: CommandedProcess) -> None:
    base, driving = begun(agent, robot, 0.1, distance_m=20.0, speed=0.2)
    with pytest.raises(Refusal, match="drives the robot by"):
        drive(agent, base, distance_m=-1.0)
    with pytest.raises(Refusal, match="until it ends: nothing was sent"):
        agent.call(
            "ros2_topic_publish",
            topic_name=f"{base}/cmd_vel",
            message_type="geometry_msgs/msg/Twist",
            data={"linear": {"x": 0.5}},
        )
    stopped = agent.call("ros2_stop")
    result = driving.result(30)
    assert "motion_" in stopped["note"]
    assert result["outcome"] == "interrupted"
    assert "ros2_stop" in result["note"]
    assert 0.0 < result["measured"] < 20.0
    truth(robot)


def test_a_call_that_is_cancelled_leaves_a_robot_that_stands(agent: Agent, robot: CommandedProcess) -> None:
    _, driving = begun(agent, robot, 0.1, distance_m=20.0, speed=0.2)
    driving.cancel()
    truth(robot)


def test_what_is_missing_is_said_before_anything_moves(agent: Agent, robot: CommandedProcess) -> None:
    base = place(robot, agent)
    assert "either distance_m or angle_deg" in agent.refusal("ros2_drive")
    assert "Twist" in agent.refusal("ros2_drive", topic_name=f"{base}/odom", distance_m=1.0)
    wrong = agent.refusal("ros2_drive", topic_name=f"{base}/cmd_vel", odometry=f"{base}/scan", distance_m=1.0)
    assert "odometry needs nav_msgs/msg/Odometry" in wrong
    assert "out of range" in agent.refusal("ros2_drive", distance_m=1000.0)
    assert robot.state()["moved_at"] == 0.0
