"""Transforms over real DDS: found, measured, explained, and the same in a recording."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from support.agent import FULL, Agent, Refusal, agent_for, until

Tell = Callable[..., None]


@pytest.fixture(scope="module")
def agent(
    tf_peer: subprocess.Popen[str], ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Agent]:
    """A client of a server that keeps recordings in a folder of its own."""
    bags = tmp_path_factory.mktemp("bags")
    with agent_for(ros_environment, "--tools", "all", "--record-dir", str(bags)) as client:
        yield client


def looked_up(agent: Agent, target: str, source: str, **more: Any) -> dict[str, Any]:
    """The answer, as soon as there is one: publishers may be discovered late."""

    def answer() -> dict[str, Any] | None:
        try:
            return agent.call("ros2_tf_lookup", target=target, source=source, **more)
        except Refusal:
            return None

    return until(answer)


def test_a_look_up_tells_the_pose_its_age_and_who_tells_each_edge(agent: Agent, tell: Tell) -> None:
    tell("odom", "base_link", node="base", x=2.0)
    tell("base_link", "laser", node="mounts", x=0.5, static=True)
    found = looked_up(agent, "odom", "laser")
    assert found["translation"]["x"] == 2.5
    assert found["chain"] == ["laser", "base_link", "odom"]
    assert found["age_s"] is not None
    until(lambda: [row["publisher"] for row in looked_up(agent, "odom", "laser")["edges"]] == ["/mounts", "/base"])

    until(lambda: looked_up(agent, "odom", "laser")["edges"][1]["rate_hz"])
    if FULL:
        assert looked_up(agent, "odom", "laser")["edges"][1]["rate_hz"] == pytest.approx(20.0, rel=0.2)


def test_a_recording_gives_the_same_numbers_as_the_robot_did(agent: Agent, tell: Tell) -> None:
    tell("odom", "base_link", node="base", speed=0.5)
    tell("base_link", "laser", node="mounts", x=0.5, static=True)
    looked_up(agent, "odom", "laser")
    begun = agent.call("ros2_record_start", topic_names=["/tf", "/tf_static"])
    path = Path(begun["path"])

    def has_begun() -> bool:
        [recording] = agent.call("ros2_record_status", recording_id=begun["recording_id"])["recordings"]
        return {topic["topic_name"] for topic in recording["topics"] if topic["written"]} == {"/tf", "/tf_static"}

    until(has_begun)
    first = looked_up(agent, "odom", "base_link")["stamp_ns"]
    until(lambda: int(looked_up(agent, "odom", "base_link")["stamp_ns"]) > int(first) + 1_500_000_000)
    asked = str(int(first) + 987_654_321)
    live = agent.call("ros2_tf_lookup", target="laser", source="odom", time=asked)
    assert agent.call("ros2_record_stop")
    recorded = agent.call("ros2_tf_lookup", target="laser", source="odom", time=asked, bag=path.name)
    for key in ("translation", "rotation", "stamp_ns", "chain", "roll_deg", "pitch_deg", "yaw_deg"):
        assert recorded[key] == live[key], key
    last = agent.call("ros2_tf_lookup", target="odom", source="base_link", bag=path.name)
    assert int(last["stamp_ns"]) >= int(asked) and last["age_s"] is not None


def test_a_failure_says_why_from_what_was_told(agent: Agent, tell: Tell) -> None:
    looked_up(agent, "odom", "laser")
    assert "Did you mean laser?" in agent.refusal("ros2_tf_lookup", target="odom", source="lasser")
    tell("map", "door", node="places", static=True)
    until(lambda: "Two trees" in agent.refusal("ros2_tf_lookup", target="map", source="laser"))
    hours = agent.refusal("ros2_tf_lookup", target="odom", source="laser", time="2 h ago")
    assert "Nothing of odom → base_link at" in hours and "the nearest is 7" in hours


def test_two_parents_are_an_error_and_an_edge_that_ended_is_told_to_be_stale(agent: Agent, tell: Tell) -> None:
    tell("odom", "camera", node="base", x=1.0)
    looked_up(agent, "odom", "camera")
    tell("laser", "camera", node="other")

    def refused() -> bool:
        try:
            agent.call("ros2_tf_lookup", target="odom", source="camera")
        except Refusal as refusal:
            return "two parents" in str(refusal) or "2 parents" in str(refusal)
        return False

    until(refused)
    tell("odom", "camera", node="base", hz=0)
    tell("laser", "camera", node="other", hz=0)
    tell("odom", "wheel", node="base")
    until(lambda: looked_up(agent, "odom", "wheel")["edges"][0]["rate_hz"])  # told more than once
    tell("odom", "wheel", node="base", hz=0)
    until(lambda: "odom → wheel is stale: last published" in looked_up(agent, "odom", "wheel")["note"])


def test_a_fixed_frame_whose_node_has_left_is_told_and_not_credited_to_others(agent: Agent, tell: Tell) -> None:
    tell("base_link", "laser", node="mounts", x=0.5, static=True)
    tell("base_link", "lens", node="calibration", x=0.2, static=True)
    until(lambda: "/calibration" in looked_up(agent, "base_link", "lens")["edges"][0]["publisher"])
    tell("base_link", "lens", node="calibration", leaves=True)
    until(lambda: "its publisher has left" in looked_up(agent, "base_link", "lens")["note"])
    assert "/calibration, which is gone" in looked_up(agent, "base_link", "lens")["edges"][0]["publisher"]
    laser = looked_up(agent, "base_link", "laser")["edges"][0]
    assert not laser["problem"] and "calibration" not in laser["publisher"]


@pytest.mark.promise("ros2_tf_tree", "who publishes each edge, its rate and age")
def test_the_tree_tells_each_edge_and_publishers_that_nobody_hears(agent: Agent, tell: Tell) -> None:
    looked_up(agent, "odom", "laser")
    tell("base_link", "sonar", node="careless", static=True, latched=False)

    def unheard() -> dict[str, Any] | None:
        tree = agent.call("ros2_tf_tree", frame="odom")
        said = [line for line in tree["problems"] if "/careless" in line]
        return tree if said and "transient_local" in said[0] else None

    tree = until(unheard)
    rows = {row["child"]: row for row in tree["edges"]}
    assert rows["laser"]["is_static"] and rows["base_link"]["parent"] == "odom"
    assert "/base" in rows["base_link"]["publisher"]
    assert tree["pictures"][0]["mime"] == "image/png"
