"""Programs of the how-to on the simulated robot, each run by its name; `test_ten_recorded` has those of recordings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("pydantic_monty", reason="needs the extra `programs`")

from support.agent import FULL, Agent, agent_for, until
from support.source import ROOT

PROGRAMS = ROOT / "docs" / "how-to" / "programs"


@pytest.fixture(scope="module")
def agent(demo_robot: object, demo_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server that has the programs of the how-to."""
    with agent_for(demo_environment, "--tools", "all", "--programs", str(PROGRAMS)) as client:
        client.knows("/odom", "/scan", "/imu", "/cmd_vel", "/battery_state")
        client.until_answered("ros2_tf_lookup", target="odom", source="base_link")
        yield client


def run(agent: Agent, name: str, **inputs: Any) -> dict[str, Any]:
    ran = agent.call("ros2_program_run", program=name, inputs=inputs, timeout_s=60)
    assert ran["outcome"] == "ended", ran
    return ran


def speed(agent: Agent) -> float:
    [message] = agent.call("ros2_topic_subscribe", topic_name="/odom", fields=["twist.twist.linear.x"])["messages"]
    return abs(message["twist.twist.linear.x"])


def stands(agent: Agent) -> bool:
    return speed(agent) < 0.01


def ahead(agent: Agent) -> float:
    """Metres to the nearest ahead, within 20 degrees."""
    code = (
        "import math, robot\n"
        "m = robot.latest('/scan')\n"
        "middle, half = round(-m['angle_min'] / m['angle_increment']), round(math.radians(20) / m['angle_increment'])\n"
        "robot.min(m['ranges'][middle - half : middle + half + 1])\n"
    )
    return run(agent, code)["returned"]["value"]


def test_drive_until_stands_before_what_is_ahead(agent: Agent) -> None:
    nearest_m = ahead(agent) - 0.3
    [line] = run(agent, "drive-until", nearest_m=nearest_m, speed=0.15)["printed"]
    before, way = (float(part.split(" m")[0]) for part in (line, line.split("after ")[1]))
    until(lambda: stands(agent))
    assert 0.0 < before <= nearest_m + 0.01  # what is printed has two digits
    if FULL:
        assert nearest_m - 0.25 < before  # 2 cm from scan to scan, and as many scans as a busy machine is late
    assert way >= 0.15


def test_follow_wall_drives_and_stands_at_its_end(agent: Agent) -> None:
    def ran_with_scans() -> dict[str, Any] | None:  # a first scan may come late
        ran = run(agent, "follow-wall", seconds=1)
        return ran if ran["commands"][0]["function"] == "publish" else None

    ran = until(ran_with_scans)
    assert "scans beside a wall" in ran["printed"][-1]
    assert {command["function"] for command in ran["commands"]} == {"publish", "stop"}
    until(lambda: stands(agent))


def test_watch_three_sees_them_all_and_stops_for_what_is_too_near(agent: Agent) -> None:
    [line] = run(agent, "watch-three", seconds=1, silent_s=5)["printed"]
    assert line.startswith("nothing in 1")
    [line] = run(agent, "watch-three", seconds=60, nearest_m=100, silent_s=60)["printed"]
    assert line.startswith("something is too near")


def test_average_transform_is_where_the_robot_stands(agent: Agent) -> None:
    until(lambda: stands(agent))
    mean = run(agent, "average-transform", samples=4)["returned"]["value"]
    found = agent.call("ros2_tf_lookup", target="odom", source="base_link")
    assert (mean["x"], mean["y"]) == pytest.approx((found["translation"]["x"], found["translation"]["y"]), abs=0.02)


def test_call_on_error_calls_when_an_error_appears(agent: Agent) -> None:
    waiting = agent.begin("ros2_program_run", program="call-on-error", inputs={"service": "/self_test"}, timeout_s=60)
    error = {"level": 40, "name": "arm", "msg": "motor is hot"}
    until(lambda: agent.call("ros2_topic_publish", topic_name="/rosout", data=error) and waiting.done())
    [line] = waiting.result()["printed"]
    assert line.startswith("arm said: motor is hot; /self_test answered: ")
    assert "'success':" in line


def test_free_directions_are_told_by_sector(agent: Agent) -> None:
    ran = run(agent, "free-directions", sectors=4, free_m=0.1)
    assert [line.partition(":")[0] for line in ran["printed"]] == ["0 deg", "90 deg", "180 deg", "270 deg"]
    assert ran["returned"]["value"] == [0, 90, 180, 270]


def test_patrol_visits_its_places(agent: Agent) -> None:
    ran = run(agent, "patrol", places=[[0.3, 0.0], [0.3, 0.3]], action="/navigate_to")
    assert ran["returned"]["value"] == ["SUCCEEDED", "SUCCEEDED"], ran
    assert len(ran["printed"]) == 2


def test_self_test_finds_what_is_in_order_and_what_is_not(agent: Agent) -> None:
    assert run(agent, "self-test", transforms=[["odom", "no_such_frame"]])["returned"]["value"] is False


def test_a_program_iterates_over_the_feedback_of_its_goal_and_cancels_it(agent: Agent) -> None:
    code = """import robot
at = robot.latest('/odom', fields=['pose.pose.position.x'])['pose.pose.position.x']
goal = robot.goal('/navigate_to', {'x': at + 2.0, 'y': 0.0})
seen = []
async for m in robot.feedback(goal):
    seen.append(m['distance_remaining'])
    if len(seen) == 2:
        robot.cancel('/navigate_to', goal['goal_id'])
print(robot.result('/navigate_to', goal['goal_id'])['status'])
seen
"""
    ran = agent.call("ros2_program_run", program=code, timeout_s=60)
    assert ran["printed"] == ["CANCELED"] and len(ran["returned"]["value"]) >= 2, ran
    until(lambda: stands(agent))
