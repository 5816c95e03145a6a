"""Routes and pauses beside Nav2 in processes of its own: the navigator counts the goals, the base judges."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.agent import Agent, agent_for, until
from support.commanded import CommandedProcess

NEAR, MIDDLE, FAR = {"x": 0.3, "y": 0.0}, {"x": 0.6, "y": 0.0}, {"x": 4.0, "y": 0.0}
POSE = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 6.0}, "orientation": {"w": 1.0}}}
ROLLS_M = 0.2
"""How far from its place the base may stand: without a command it drives on for 0.5 s, at 0.3 m/s."""
ASKS = """
policy: 1
name: asks
robot: hall
mode: autonomous
state: {state}
allow:
  - goal: /navigate_to_pose
    type: nav2_msgs/action/NavigateToPose
    consent: each
    fields: {{pose.pose.position: {{zone: near}}}}
zones:
  near: {{frame: map, polygon: [[-2, -2], [2, -2], [2, 2], [-2, 2]]}}
"""


def states(routed: dict[str, Any]) -> list[str]:
    return [place["state"] for place in routed["places"]]


def begin_waiting(agent: Agent, navigator: CommandedProcess) -> str:
    """The job of a route that waits at its first place, and then would go far."""
    begun = agent.call("ros2_nav_route", to=[{**NEAR, "wait_s": 600}, FAR], timeout_s=0)
    job = begun["job_id"]
    until(lambda: states(agent.call("ros2_nav_route", job_id=job, timeout_s=0.2))[0] == "reached")
    assert navigator.goals() == [0.3]
    return job


@pytest.mark.promise("ros2_nav_route", "Each place is a goal of its own, and reported as reached or missed")
def test_a_route_in_loops_goes_on_after_a_missed_place_and_tells_all_in_the_first_line(
    nav_agent: Agent, nav2: CommandedProcess, navigator: CommandedProcess
) -> None:
    navigator.put(misses=[0.6])
    to = [{**NEAR, "wait_s": 0.5}, MIDDLE, {"x": 0.0, "y": 0.0}]
    done = nav_agent.call("ros2_nav_route", to=to, loops=2, on_missed="go_on", timeout_s=55)
    assert (done["outcome"], done["loop"], states(done)) == ("done", 2, ["reached", "missed", "reached"]), done
    assert [(place["reached"], place["missed"]) for place in done["places"]] == [(2, 0), (0, 2), (2, 0)]
    assert navigator.goals() == [0.3, 0.6, 0.0] * 2
    until(lambda: nav2.speed() == 0.0)  # its zero is on its way from node to node
    assert nav2.x() == pytest.approx(0.0, abs=ROLLS_M)
    first = done["summary"].splitlines()[0]
    assert "4 of 6 places reached, 2 MISSED" in first and "2 (0.60, 0.00) MISSED 2× (" in first
    assert done["places"][1]["cause"] and done["places"][0]["away_m"] < ROLLS_M


def test_a_route_ends_at_a_missed_place_unless_it_shall_go_on(nav_agent: Agent, navigator: CommandedProcess) -> None:
    navigator.put(misses=[0.6])
    done = nav_agent.call("ros2_nav_route", to=[NEAR, MIDDLE, NEAR], timeout_s=50)
    assert (done["outcome"], states(done)) == ("failed", ["reached", "missed", "not begun"])
    assert navigator.goals() == [0.3, 0.6]


@pytest.mark.promise("ros2_nav_pause", "check that the robot stands, and keep the rest of the list")
@pytest.mark.promise("ros2_nav_pause", "reports how far the robot was moved meanwhile")
def test_a_paused_navigation_stands_keeps_its_rest_and_tells_that_the_robot_was_moved(
    nav_agent: Agent, nav2: CommandedProcess, navigator: CommandedProcess
) -> None:
    begun = nav_agent.call("ros2_navigate", to=[FAR, {"x": 3.7, "y": 0.0}], timeout_s=0)
    until(lambda: nav2.speed() > 0.1)
    paused = nav_agent.call("ros2_nav_pause")
    assert nav2.speed() == 0.0 and "follow_path" in nav2.cancels()
    assert (paused["state"], paused["stands"], paused["job_id"]) == ("paused", True, begun["job_id"])
    assert paused["x_m"] == pytest.approx(nav2.x(), abs=0.05)
    assert paused["left"] == ["(4.00, 0.00)", "(3.70, 0.00)"]
    assert nav_agent.call("ros2_navigate", job_id=begun["job_id"], timeout_s=30)["outcome"] == "paused"
    nav2.push(x=paused["x_m"] + 3.0)
    resumed = nav_agent.call("ros2_nav_pause", resume=True)
    assert resumed["state"] == "under way" and resumed["is_moved"] is True
    assert resumed["moved_m"] == pytest.approx(3.0, abs=0.05) and "3.0" in resumed["summary"]
    done = nav_agent.call("ros2_navigate", job_id=begun["job_id"], timeout_s=50)
    assert done["outcome"] == "reached" and navigator.goals() == [4.0, 4.0, 3.7]
    assert nav2.x() == pytest.approx(3.7, abs=ROLLS_M)
    assert "has ended (reached)" in nav_agent.refusal("ros2_nav_pause")


@pytest.mark.promise("ros2_nav_route", "ros2_stop ends it")
def test_after_a_stop_no_further_place_is_begun(
    nav_agent: Agent, nav2: CommandedProcess, navigator: CommandedProcess
) -> None:
    job = begin_waiting(nav_agent, navigator)
    nav_agent.call("ros2_stop")
    done = nav_agent.call("ros2_nav_route", job_id=job)
    assert (done["outcome"], states(done)) == ("canceled", ["reached", "not begun"]) and "ros2_stop" in done["note"]

    paused = begin_waiting_and_paused(nav_agent, navigator)
    nav_agent.call("ros2_stop")
    assert "has ended (canceled)" in nav_agent.refusal("ros2_nav_pause", job_id=paused, resume=True)
    assert navigator.goals() == [0.3, 0.3] and nav2.speed() == 0.0


def begin_waiting_and_paused(agent: Agent, navigator: CommandedProcess) -> str:
    begun = agent.call("ros2_nav_route", to=[{**NEAR, "wait_s": 600}, FAR], timeout_s=0)
    until(lambda: len(navigator.goals()) == 2)
    assert agent.call("ros2_nav_pause", job_id=begun["job_id"])["state"] == "paused"
    return begun["job_id"]


def test_a_paused_route_does_not_go_on_while_another_client_has_the_robot_drive(
    nav_agent: Agent, nav2: CommandedProcess, navigator: CommandedProcess
) -> None:
    job = begin_waiting(nav_agent, navigator)
    nav_agent.call("ros2_nav_pause")
    nav_agent.call(
        "ros2_topic_publish", topic_name="/goal_pose", message_type="geometry_msgs/msg/PoseStamped", data=POSE
    )
    until(lambda: nav2.speed() > 0.1)
    refused = nav_agent.refusal("ros2_nav_pause", resume=True)
    assert "another client's goal" in refused and "ros2_cancel_action_goal(" in refused
    (running,) = until(lambda: nav_agent.call("ros2_stop")["running"])  # as soon as its state was read in time
    nav_agent.call("ros2_cancel_action_goal", action_name="/navigate_to_pose", goal_id_hex=running["goal_id"])
    until(lambda: nav2.speed() == 0.0)
    assert nav_agent.call("ros2_nav_route", job_id=job)["outcome"] == "canceled" and navigator.goals() == [0.3, 6.0]


# ── under a policy ─────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The state folder of the robot."""
    return tmp_path_factory.mktemp("asks") / "state" / "hall"


@pytest.fixture(scope="module")
def asking(nav_environment: dict[str, str], nav2: CommandedProcess, state: Path) -> Iterator[Agent]:
    file = state.parents[1] / "policy.yaml"
    file.write_text(ASKS.format(state=state.parent))
    file.chmod(0o600)
    environment = {**nav_environment, "XDG_STATE_HOME": str(state.parents[1])}
    with agent_for(environment, "--tools", "all", "--policy", str(file)) as agent:
        yield agent.knows("/cmd_vel", "/odom", "/tf")


def operate(state: Path, *words: str) -> str:
    command = [sys.executable, "-m", "ros2_mcp", "operate", "--state", str(state), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@pytest.mark.promise("ros2_nav_route", "An approval covers the whole list")
def test_a_person_approves_a_list_once_and_reads_all_of_it(
    asking: Agent, state: Path, nav2: CommandedProcess, navigator: CommandedProcess
) -> None:
    asking.until_answered("ros2_parameter_list", node_name="/bt_navigator")
    beyond = asking.refusal("ros2_nav_route", to=[NEAR, FAR])
    assert "goal 2 of 2" in beyond and navigator.goals() == [], "nothing was driven"
    route = {"to": [NEAR, MIDDLE], "loops": 2, "wait_s": 0.5, "timeout_s": 50}
    needed = asking.refusal("ros2_nav_route", **route).partition("needs_approval ")[2][:4]
    told = operate(state)
    assert "a list of 2 goals, in this order, 2 times" in told
    assert "Goal 1, then wait 0.5 s" in told and "pose.pose.position.x 0.6" in told
    operate(state, "approve", needed)
    assert asking.refusal("ros2_nav_route", **{**route, "loops": 3}) and navigator.goals() == []
    done = asking.call("ros2_nav_route", **route)
    assert (done["outcome"], navigator.goals()) == ("done", [0.3, 0.6, 0.3, 0.6])
    assert nav2.x() == pytest.approx(0.6, abs=ROLLS_M)
    assert "needs_approval" in asking.refusal("ros2_nav_route", **route), "an approval is used once"
