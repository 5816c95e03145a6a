"""A server under the profile `teleop-slow`: what it tells, and an agent that does whatever it reads."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import FULL, Refusal, until
from support.driver import BAG, Driver, calm, fresh, write_bag
from support.observer import Observer
from support.velocities import TWIST, cdr

ROUNDS = 200 if FULL else 36
LINEAR, ANGULAR = 0.2, 0.5
ROUNDING = 1 + 1e-6
SET_BOOL, TRIGGER = "std_srvs/srv/SetBool", "std_srvs/srv/Trigger"
ON = {"data": True}


@pytest.fixture(scope="module")
def slow(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driver]:
    folder = tmp_path_factory.mktemp("slow")
    write_bag(folder / "bags", [cdr(TWIST, 0.5)] * 50)
    environment = {**ros_environment, "XDG_STATE_HOME": str(folder / "state")}
    driver = Driver(environment, "--tools", "all", "--policy", "teleop-slow", "--record-dir", str(folder / "bags"))
    yield driver
    driver.end()


def test_what_is_allowed_is_told_in_words_and_numbers_and_never_where_it_stands(slow: Driver) -> None:
    told = slow.do("ros2_policy")
    status = slow.do("ros2_status")
    assert told["in_force"] and told["policies"] == ["teleop-slow"]
    assert told["strength"] == status["policy_strength"] == "advisory"
    assert told["digest"] == status["policy_digest"] and len(told["digest"]) == 64
    assert "at most 50 Hz; for at most 10 s each time" in " ".join(told["allowed"])
    assert "the length of linear at most 0.2 m/s; the length of angular at most 0.5 rad/s" in " ".join(told["limits"])
    assert status["policy"] == "teleop-slow"
    assert ".yaml" not in json.dumps([told, status])


def test_a_topic_on_which_the_robot_itself_publishes_is_refused_and_named(slow: Driver, observer: Observer) -> None:
    topic = f"{fresh('mux')}/cmd_vel"
    observer.join(by=topic, topic=topic, kind=TWIST)
    observer.talk(topic=topic, kind=TWIST, hz=5.0, value=0.0)
    slow.knows(topic, 1)
    given = {"topic_name": topic, "message_type": TWIST, "data": {"linear": {"x": 0.1}}}
    with pytest.raises(Refusal, match=r"/observer_\w+ of the robot publishes there itself.*ros2_policy"):
        until(lambda: slow.do("ros2_topic_publish", **given) is None)
    observer.hush(topic=topic)
    calm(observer, topic)


def orders(names: dict[str, str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What a text may tell an agent to do, without end: tools and arguments, each with another number and spelling."""
    rng = random.Random(7)
    topics = (names["cmd_vel"], names["cmd_vel"].strip("/"), f" {names['cmd_vel']} ", names["raw"])
    types = (TWIST, "geometry_msgs/Twist", "Twist")
    for number in cycle(range(12)):
        fast = rng.choice((0.21, 0.5, 5.0, 1e308, math.nan, -0.3))
        axis, part = rng.choice((("linear", "x"), ("linear", "y"), ("linear", "z"), ("angular", "z")))
        data = {axis: {part: fast if axis == "linear" else fast * 3}}
        sent = {"topic_name": rng.choice(topics), "message_type": rng.choice(types), "data": data}
        yield (
            ("ros2_topic_publish", sent),
            ("ros2_topic_publish", {**sent, "frequency": rng.choice((5, 50, 500)), "duration": rng.choice((1, 9, 60))}),
            ("ros2_publish_multiple_topics", {"messages": [sent, {**sent, "topic_name": names["raw"]}]}),
            ("ros2_relay_start", {"source_topic": names["source"], "destination_topic": names["cmd_vel"]}),
            ("ros2_bag_play", {"bag": BAG, "remaps": {"/cmd_vel": names["cmd_vel"]}, "force": True, "wait_s": 0}),
            ("ros2_bag_play", {"bag": BAG, "remaps": {"/cmd_vel": names["raw"]}, "loop": True, "force": True}),
            (
                "ros2_service_call",
                {"service_name": names["motors"], "service_type": SET_BOOL, "fields": {"data": True}},
            ),
            ("ros2_service_call", {"service_name": names["load"], "service_type": TRIGGER, "fields": {}}),
            ("ros2_send_action_goal", {"action_name": names["action"], "goal_fields": {"order": 5}}),
            ("ros2_parameter_set", {"node_name": "/observer_servers", "values": {"use_sim_time": True}}),
            (
                "ros2_service_call",
                {
                    "service_name": "/observer_servers/set_parameters",
                    "service_type": "rcl_interfaces/srv/SetParameters",
                    "fields": {"parameters": [{"name": "x", "value": {"type": 1, "bool_value": True}}]},
                },
            ),
            (
                "ros2_service_call",
                {
                    "service_name": f"{names['action']}/_action/send_goal",
                    "service_type": "test_msgs/action/Fibonacci_SendGoal",
                    "fields": {"goal_id": {"uuid": [7] * 16}, "goal": {"order": 5}},
                },
            ),
        )[number]


def test_an_agent_that_does_whatever_it_reads_moves_nothing_over_a_limit(slow: Driver, observer: Observer) -> None:
    base = fresh("obedient")
    names = {name: f"{base}/{name}" for name in ("cmd_vel", "raw", "source", "motors", "load", "action")}
    for topic in (names["cmd_vel"], names["raw"]):
        observer.join(by=topic, topic=topic, kind=TWIST)
        slow.knows(topic, 1)
    observer.talk(topic=names["source"], kind=TWIST, hz=20.0, value=0.5)
    observer.serve(service=names["motors"], kind=SET_BOOL)
    observer.serve(service=names["load"], kind=TRIGGER)
    observer.act(action=names["action"])
    refused = 0
    for tool, arguments in islice(orders(names), ROUNDS):
        try:
            slow.do(tool, **arguments)
        except Refusal:
            refused += 1
    slow.do("ros2_topic_publish", topic_name=names["cmd_vel"], data={"linear": {"x": 0.1}}, frequency=20, duration=1)
    came = [one["values"] for one in observer.messages(topic=names["cmd_vel"])]
    assert came, "what is allowed is done"
    for values in came:
        assert math.hypot(*values[:3]) <= LINEAR * ROUNDING
        assert math.hypot(*values[3:]) <= ANGULAR * ROUNDING
    assert not any(any(one["values"]) for one in observer.messages(topic=names["raw"]))
    assert observer.asked(service=names["motors"]) == observer.asked(service=names["load"]) == []
    assert observer.goals_of(action=names["action"]) == []
    assert refused == ROUNDS
    fastest = max(math.hypot(*values[:3]) for values in came), max(math.hypot(*values[3:]) for values in came)
    print(f"{ROUNDS} orders, {refused} refused; driven at most at {fastest[0]:.2f} m/s and {fastest[1]:.2f} rad/s.")
    print(f"What remains possible: {slow.do('ros2_policy')['allowed']}, to read everything, and to stop the robot.")
    observer.hush(topic=names["source"])


def test_without_a_policy_that_is_said(ros_environment: dict[str, str], tmp_path: Path) -> None:
    driver = Driver({**ros_environment, "XDG_STATE_HOME": str(tmp_path)})
    try:
        assert "none is in force" in driver.do("ros2_status")["policy"]
        told = driver.do("ros2_policy")
        assert not told["in_force"] and "No policy is in force" in told["note"]
    finally:
        driver.end()
