"""Failures that are planted in the rover and its surroundings: each is told with its cause in the first answer.

And a hundred goals, each with the right outcome.
"""

import math
import random
import re
import time
from contextlib import suppress

import pytest

from support.agent import Refusal, until

pytestmark = pytest.mark.full

FREE = {"x": 0.9, "y": 0.3}
"""A place near the start with nothing around."""


def setting(node, name, wrong, right):
    """A parameter that is wrong meanwhile."""
    return (
        lambda agent: agent.call("ros2_parameter_set", node_name=node, values={name: wrong}),
        lambda agent: agent.call("ros2_parameter_set", node_name=node, values={name: right}),
    )


def service(name, wrong, right):
    """A service that is called before and after."""
    return (
        lambda agent: agent.call("ros2_service_call", service_name=name, fields=wrong),
        lambda agent: agent.call("ros2_service_call", service_name=name, fields=right),
    )


def lifecycle(node):
    """A lifecycle node that is not active meanwhile."""
    return (
        lambda agent: agent.call("ros2_lifecycle_change", node_name=node, transition="deactivate"),
        lambda agent: agent.call("ros2_lifecycle_change", node_name=node, transition="activate"),
    )


def obstacle(x, y, radius):
    """Something that nobody has mapped; moved into a corner afterwards, and forgotten by the costmap."""

    def put(agent, x=x, y=y, radius=radius):
        fields = {"name": "planted", "x": x, "y": y, "radius": radius}
        agent.call("ros2_service_call", service_name="/spawn_obstacle", fields=fields)

    def take_away(agent):
        put(agent, 5.8, -2.8, 0.1)
        agent.call(
            "ros2_service_call", service_name="/global_costmap/clear_entirely_global_costmap", fields={"request": {}}
        )

    return put, take_away


def nothing():
    return lambda _: None, lambda _: None


def silence(node, name):
    """Something that falls silent, and is silent for longer than Nav2 waits."""
    wrong, right = setting(node, name, False, True)

    def plant(agent):
        wrong(agent)
        time.sleep(2.0)  # what was sent last grows old

    return plant, right


PLANTED = {
    "goal in a wall": (nothing(), {"x": 2.5, "y": -1.0}, "is occupied on /global_costmap"),
    "goal in a pillar": (nothing(), {"x": 1.6, "y": -1.0}, "is occupied on /global_costmap"),
    "goal too near a pillar": (nothing(), {"x": 1.6, "y": -0.52}, "robot would touch it"),
    "goal outside of the map": (nothing(), {"x": 50.0, "y": 0.0}, "outside of /global_costmap"),
    "goal outside of the building": (nothing(), {"x": -2.05, "y": 0.0}, "occupied|touch"),
    "goal in a frame that there is not": (nothing(), {"x": 1.0, "y": 0.0, "frame": "mapp"}, "frame mapp"),
    "scanner is dead": (silence("/lidar", "enabled"), FREE, "/scan is silent"),
    "localisation is dead": (silence("/localization", "enabled"), FREE, "map → odom is not told any more"),
    "navigator is not active": (lifecycle("/bt_navigator"), FREE, "/bt_navigator is inactive"),
    "planner is not active": (lifecycle("/planner_server"), FREE, "/planner_server is inactive"),
    "controller is not active": (lifecycle("/controller_server"), FREE, "/controller_server is inactive"),
    "planner is too slow": (setting("/planner_server", "max_planning_time", 0.0, 5.0), FREE, "took too long"),
    "motors are off": (service("/enable_motors", {"data": False}, {"data": True}), FREE, "motors are disabled"),
    "robot is idle": (service("/set_mode", {"mode": "idle"}, {"mode": "manual"}), FREE, "the mode is idle"),
    "base may not drive": (
        setting("/base_controller", "max_linear_speed", 0.0, 0.5),
        {"x": 1.2, "y": 0.9},
        "/base_controller has the limit max_linear_speed = 0",
    ),
    "doorway is closed": (obstacle(2.5, 1.3, 0.55), {"x": 4.0, "y": 1.0}, "no free path"),
    "something stands on the goal": (obstacle(1.2, 0.2, 0.2), {"x": 1.2, "y": 0.2}, "is occupied|touch"),
}


def try_to_go(agent, to):
    """The answer to a goal, or to the refusal of one."""
    return agent.begin("ros2_navigate", to=[to], timeout_s=120).result(150)


@pytest.mark.parametrize("name", list(PLANTED))
def test_a_planted_failure_is_told_with_its_cause(agent, name):
    (plant, undo), to, cause = PLANTED[name]
    try_to_go(agent, {"x": 0.0, "y": 0.0})
    plant(agent)
    try:
        done = try_to_go(agent, to)
    finally:
        undo(agent)
    print(f"{name}: {done['outcome']}: {done['explanation'] and done['explanation']['cause']}")
    assert done["outcome"] in ("failed", "rejected"), done
    assert re.search(cause, done["explanation"]["cause"]), done["explanation"]
    assert done["explanation"]["helps"]


def test_something_that_falls_silent_on_the_way_is_told(agent):
    for node, cause in (("/lidar", "/scan is silent"), ("/localization", "map → odom is not told any more")):
        try_to_go(agent, {"x": 0.0, "y": 0.0})
        driving = agent.begin("ros2_navigate", to=[{"x": -1.5, "y": -2.0}], timeout_s=60)
        until(lambda: is_driving(agent))
        agent.call("ros2_parameter_set", node_name=node, values={"enabled": False})
        done = driving.result(60)
        agent.call("ros2_parameter_set", node_name=node, values={"enabled": True})
        assert done["outcome"] == "failed" and cause in done["explanation"]["cause"], done


def test_a_goal_that_another_one_replaces_says_so(agent):
    until(lambda: try_to_go(agent, {"x": 0.0, "y": 0.0})["outcome"] == "reached")  # it is localised again
    first = agent.begin("ros2_navigate", to=[{"x": -1.5, "y": -2.0}], timeout_s=60)
    until(lambda: is_driving(agent))
    second = agent.begin("ros2_navigate", to=[{"x": 0.0, "y": 0.0}], timeout_s=60)
    done = first.result(60)
    assert (done["outcome"], done["explanation"]) == ("failed", None)
    assert "replaced it" in done["legs"][0]["note"]
    assert second.result(60)["outcome"] == "reached"


def test_a_person_who_takes_over_is_told(agent):
    driving = agent.begin("ros2_navigate", to=[{"x": -1.5, "y": -2.0}], timeout_s=60)
    until(lambda: is_driving(agent))
    with suppress(Refusal):
        agent.call("ros2_topic_publish", topic_name="/cmd_vel", data={"linear": {"x": 0.0}}, frequency=20, duration=9)
    done = driving.result(60)
    assert done["outcome"] == "failed" and "/cmd_vel takes over" in str(done["explanation"]), done


@pytest.mark.timeout(3600)
def test_of_a_hundred_goals_each_has_the_right_outcome(agent):
    """The truth is judged by the odometry of the simulation, and by what stands in its world."""
    rng, wrong, outcomes = random.Random(14), [], {}
    for node in ("/controller_server", "/base_controller"):  # faster than it is wont to: a hundred take eight minutes
        agent.call("ros2_parameter_set", node_name=node, values={"max_linear_speed": 0.6})
    for number in range(100):
        to = {"x": round(rng.uniform(-2.6, 6.6), 2), "y": round(rng.uniform(-3.4, 3.4), 2)}
        done = agent.begin("ros2_navigate", to=[to], timeout_s=180).result(200)
        outcomes[done["outcome"]] = outcomes.get(done["outcome"], 0) + 1
        pose = agent.call("ros2_topic_echo_wait", topic_name="/pose", timeout=10.0)["message"]["pose"]["pose"][
            "position"
        ]
        away = math.dist((pose["x"], pose["y"]), (to["x"], to["y"]))
        if (done["outcome"] == "reached") != (away < 0.3) or is_free(to) != (done["outcome"] == "reached"):
            wrong.append((number, to, done["outcome"], round(away, 2), done["explanation"]))
        print(number, to, done["outcome"], f"{away:.2f} m away, {len(wrong)} wrong so far", flush=True)
    print(f"100 goals: {outcomes}, {len(wrong)} wrong: {wrong}")
    assert wrong == []


def is_free(to):
    """Whether the rover's world has room there, by the clearance that its planner keeps."""
    from ros2_mcp_demo.drive import Surroundings
    from ros2_mcp_demo.planner import plan
    from ros2_mcp_demo.simulation import Simulation

    cells, origin = Simulation().map
    return plan(Surroundings(cells, origin, 0.05).costmap(), (0.0, 0.0), (to["x"], to["y"])) is not None


def is_driving(agent):
    speed = agent.call("ros2_topic_echo_wait", topic_name="/odom", timeout=10.0)["message"]["twist"]["twist"]
    return abs(speed["linear"]["x"]) > 0.1
