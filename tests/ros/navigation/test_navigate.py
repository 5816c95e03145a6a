"""Goals for the rover's Nav2: reached, failed and explained, stopped."""

import json
import math
import re
import time

import pytest

from support.agent import FULL, until
from support.source import ROOT

HASHES = {
    "nav2_msgs/action/NavigateToPose": "RIHS01_a56dba8a3234a1215e610180dc703ae25bbf406dded8b54887891c9732857eab",
    "nav2_msgs/action/ComputePathToPose": "RIHS01_b11d50c914791956069419b8f4ad441e3c66fcfbd9461f8e87110b77dc6febe9",
    "nav2_msgs/srv/ClearEntireCostmap": "RIHS01_553f54f9cadab44553fdf5627433fcb6701f71c1fc2eb55a7b4a004fdeeab952",
}


def position(agent):
    """Where the rover says that it is in the map."""
    pose = agent.call("ros2_topic_echo_wait", topic_name="/pose", timeout=10.0)["message"]["pose"]["pose"]
    return pose["position"]["x"], pose["position"]["y"]


def speed(agent):
    """How fast its wheels say that it drives, in m/s."""
    twist = agent.call("ros2_topic_echo_wait", topic_name="/odom", timeout=10.0)["message"]["twist"]["twist"]
    return abs(twist["linear"]["x"])


@pytest.mark.promise("ros2_navigate", "Reports the time taken and how near the robot came")
def test_a_place_is_kept_previewed_and_reached_with_a_heading(agent):
    start = agent.call("ros2_place_set", name="start")["place"]
    assert math.hypot(start["x_m"], start["y_m"]) < 0.1
    agent.call("ros2_place_set", name="near", x=0.7, y=0.2, yaw_deg=45)
    listed = {place["name"]: place for place in agent.call("ros2_place_list")["places"]}
    assert listed["near"]["away_m"] == pytest.approx(0.73, abs=0.1)

    way = agent.call("ros2_nav_preview", to={"place": "near"})
    assert way["pictures"][0]["width"] > 300
    assert way["is_feasible"] and way["length_m"] == pytest.approx(0.73, abs=0.15)
    assert way["clearance_m"] > 0.3 and len(way["clearance_at"]) == 2 and "m from its centre line" in way["narrowest"]
    (picture,) = way["pictures"]
    assert picture["mime"] == "image/png" and picture["width"] > 400, "the way in the scene"
    assert math.dist(position(agent), (0, 0)) < 0.1, "a preview moves nothing"

    done = agent.call("ros2_navigate", to=[{"place": "near"}])
    (leg,) = done["legs"]
    assert (done["outcome"], leg["place"]) == ("reached", "near")
    assert leg["away_m"] < 0.25 and abs(leg["heading_off_deg"]) < 10
    assert math.dist(position(agent), (0.7, 0.2)) < 0.25

    later = agent.call("ros2_scene")  # the planner sent the way when it began, and does not send it again
    (path,) = [layer for layer in later["layers"] if layer["kind"] == "path"]
    assert (path["name"], path["x_m"], path["y_m"]) == ("/plan", pytest.approx(0.7), pytest.approx(0.2))
    assert any("/plan was published" in line for line in later["missing"]), later["missing"]


def test_the_patrol_of_the_how_to_visits_its_places_with_nav2(agent):
    pytest.importorskip("pydantic_monty", reason="needs the extra programs")
    (code,) = re.findall(
        r"```python\n(.*?)```", (ROOT / "docs/how-to/programs/patrol.md").read_text("utf-8"), re.DOTALL
    )
    ran = agent.call(
        "ros2_program_run", program=code, inputs={"places": [[0.4, 0.1], [0.7, 0.2]], "action": ""}, timeout_s=90
    )
    assert ran["returned"] == {"value": ["reached", "reached"]}, ran
    assert math.dist(position(agent), (0.7, 0.2)) < 0.3


@pytest.mark.promise("ros2_navigate", "for a failed goal, the cause and what would help")
def test_a_goal_that_fails_is_explained_in_the_same_answer(agent):
    done = agent.call("ros2_navigate", to=[{"x": 2.5, "y": -1.0}, {"x": 0.0, "y": 0.0}])
    why = done["explanation"]
    assert (done["outcome"], [leg["outcome"] for leg in done["legs"]]) == ("failed", ["failed", "not begun"])
    assert (why["error_code"], why["server"], why["is_feasible"]) == (206, "planner_server", False)
    assert "(2.50, -1.00) is occupied on /global_costmap/costmap" in why["cause"]
    assert why["goal_cost"] == "occupied (cost 100)" and why["start_cost"].startswith("free")
    assert any("planner_server" in line for line in why["log"])
    assert any("Localised" in line for line in why["health"])

    rejected = agent.call("ros2_navigate", to=[{"x": 1.0, "y": 0.0, "frame": "mapp"}])
    assert rejected["outcome"] == "rejected" and "mapp" in rejected["explanation"]["cause"]


@pytest.mark.promise("ros2_nav_route", "with the cause")
def test_a_missed_place_of_a_route_has_its_cause_and_the_rest_is_driven(agent):
    to = [{"x": 0.5, "y": 0.1}, {"x": 2.5, "y": -1.0}, {"x": 0.1, "y": 0.0}]
    done = agent.call("ros2_nav_route", to=to, on_missed="go_on", timeout_s=55)
    assert (done["outcome"], [place["state"] for place in done["places"]]) == ("done", ["reached", "missed", "reached"])
    assert "(2.50, -1.00) is occupied on /global_costmap/costmap" in done["summary"].splitlines()[0]
    assert math.dist(position(agent), (0.1, 0.0)) < 0.25


def test_a_preview_takes_a_start_and_a_planner_that_the_server_has(agent):
    way = agent.call("ros2_nav_preview", to={"x": 0.5, "y": 0.0}, start={"x": -0.5, "y": 0.0}, planner_id="GridBased")
    assert way["points"][0] == pytest.approx([-0.5, 0.0], abs=0.1) and way["length_m"] == pytest.approx(1.0, abs=0.2)
    refused = agent.refusal("ros2_nav_preview", to={"x": 0.5, "y": 0.0}, planner_id="GridBase")
    assert "Its planners: GridBased" in refused


@pytest.mark.promise("ros2_navigate", "After a time-out, call again with the job_id")
@pytest.mark.promise("ros2_navigate", "ros2_stop ends the job")
def test_what_is_not_waited_for_goes_on_and_a_stop_in_the_middle_ends_it(agent):
    def begin() -> dict | None:
        """Begun; anew where a busy machine let not every part of its health be read in time."""
        begun = agent.call("ros2_navigate", to=[{"x": -1.5, "y": -1.5}, {"x": 0.0, "y": 0.0}], timeout_s=0)
        assert begun["outcome"] == "under way"
        if "could not be determined" not in str(begun["health"]):
            return begun
        agent.call("ros2_stop")
        return None

    begun = until(begin)
    told = " ".join(begun["health"])
    assert "Localised: base_link is at (" in told and "s old." in told
    assert "The costmap /global_costmap/costmap is" in told
    assert "/navigator may send velocities on /cmd_vel_nav, as Nav2 does." in told, "the rover has a second navigator"
    waiting = agent.begin("ros2_navigate", job_id=begun["job_id"], timeout_s=60)
    before = position(agent)
    until(lambda: math.dist(position(agent), before) > 0.1 or waiting.done())
    stopped = agent.call("ros2_stop")
    assert "navigate_to_pose" in str(stopped)
    done = waiting.result(60)
    assert [leg["outcome"] for leg in done["legs"]] == ["canceled", "not begun"], done
    assert "ros2_stop" in done["note"]
    if FULL:
        time.sleep(0.5)  # a goal that went on would drive 0.2 m in this time
    else:
        until(lambda: speed(agent) < 0.01)
    first = position(agent)
    assert speed(agent) < 0.01 and math.dist(first, position(agent)) < 0.06  # two poses, 8 mm wrong each: five sigma
    assert "There is no navigation" in agent.refusal("ros2_navigate", job_id="navigation_none")


def test_interfaces_are_those_of_nav2_on_the_wire(built):
    """Against the type hashes of the Jazzy branch's own definitions, made with rosidl_generator_type_description."""
    hashes = {}
    for described in (built[1] / "share" / "nav2_msgs").glob("*/*.json"):
        hashes.update(
            {one["type_name"]: one["hash_string"] for one in json.loads(described.read_text())["type_hashes"]}
        )
    assert HASHES.items() <= hashes.items()


def test_what_cannot_be_meant_is_refused_before_anything_is_sent(agent):
    assert "Did you mean near" in agent.refusal("ros2_navigate", to=[{"place": "nearr"}])
    assert "`to` is missing" in agent.refusal("ros2_navigate")
    assert "Give one of the two" in agent.refusal("ros2_navigate", to=[{"place": "near"}], job_id="navigation_1")
    wrong = agent.refusal("ros2_navigate", to=[{"place": "near"}], action_name="/navigate_to")
    assert "ros2_mcp_demo_interfaces/action/NavigateTo" in wrong
