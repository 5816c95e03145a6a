"""The simulated drone through the tools: wrong orders, the mission by prompt, and what stops it in the air."""

from __future__ import annotations

import asyncio
import json
import random
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp.commands.prompted import PROMPTS, follow_mission
from support.agent import FULL, Agent, Refusal, agent_for, until
from support.browser import CHROMIUM, browsing
from support.demo_robot import build_interfaces, with_interfaces
from support.driver import Driver
from support.processes import running
from support.prompting import PromptAgent
from support.viewing import complaints, pictured_in_all_sizes, text, viewing

MISSIONS = 20 if FULL else 1
NOWHERE = {"min_pitch": 0.0, "yaw": 0.0, "latitude": 0.0, "longitude": 0.0}


@pytest.fixture(scope="module")
def drone_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """The environment of the drone and of servers that know its interfaces."""
    return with_interfaces(ros_environment, build_interfaces("drone", later=True))


HASHES = {
    "msg/ExtendedState": "RIHS01_19ff8d10f52aacba28d9879707d3195c9a9eff3af1ba2f7e40b55eea734e7b20",
    "msg/HomePosition": "RIHS01_d53f380680238e023e7fb96440b9094c55caa32c010629893eb51c1ee73e81d8",
    "msg/State": "RIHS01_11ba7686163d22281871f1cb42557e8957407469b0be813bdb1a8922c66e3131",
    "msg/StatusText": "RIHS01_d3420a07bd2d933d9c53b51d04ec59dc61a0ed04c7110a51996795a3cfde68b2",
    "msg/WaypointList": "RIHS01_fdd46486d81956d4d9700fd279bcdffb599465f7fed3351a24f34b9ab721aeaf",
    "srv/CommandBool": "RIHS01_eba73829da4af65d1019131d82f8eccae15d38717bf21409ed5187dd9bae73dc",
    "srv/CommandLong": "RIHS01_4eba263db07465d64c8b51c68b29d0e649c6761043838cc701b226bc9a813214",
    "srv/CommandTOL": "RIHS01_03faac8deec2f89820ff196f8835713a58692713cb164cea25a0022c2b8e4ffe",
    "srv/SetMode": "RIHS01_16fc7ce085f4d07d5dd677238b42ef922d2a8aef71fabe6ad18b2ea52c9124da",
    "srv/WaypointPush": "RIHS01_280a0e2e40640f42c7bf28acc7e77ff58e89f8e767fb100f342f4e1a6ddc4350",
}
"""What the generators of Jazzy make of the definitions that MAVROS 2.12.0 publishes."""


def test_the_interfaces_are_mavros_own_by_their_hashes() -> None:
    [prefix] = [prefix for prefix in build_interfaces("drone", later=True) if prefix.name.startswith("mavros_msgs")]
    for name, expected in HASHES.items():
        described = json.loads((prefix / f"share/mavros_msgs/{name}.json").read_text())
        told = {each["type_name"]: each["hash_string"] for each in described["type_hashes"]}
        assert told[f"mavros_msgs/{name}"] == expected


@pytest.fixture(scope="module")
def agent(drone_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server with all tools, and a drone that both share."""
    with (
        running(drone_environment, sys.executable, "-m", "ros2_mcp_demo", "--robot", "drone"),
        agent_for(drone_environment, "--tools", "all", "--prompts", str(PROMPTS)) as client,
    ):
        client.knows("/mavros/state", "/odom", "/mavros/mission/waypoints")
        yield client


@pytest.fixture
def drone(agent: Agent) -> Iterator[Drone]:
    """The drone on the ground, disarmed; it is brought down again after the test."""
    drone = Drone(agent)
    drone.speed_up(1)
    yield drone
    drone.land()


class Drone:
    """Orders by the tools."""

    def __init__(self, client: Agent | Driver) -> None:
        self.call = client.do if isinstance(client, Driver) else client.call

    def order(self, service: str, kind: str, **fields: Any) -> dict[str, Any]:
        """The answer to an order."""
        return self.call(
            "ros2_service_call",
            service_name=f"/mavros/{service}",
            service_type=f"mavros_msgs/srv/{kind}",
            fields=fields,
            force_call=True,
        )

    def mode(self, mode: str) -> dict[str, Any]:
        return self.order("set_mode", "SetMode", base_mode=0, custom_mode=mode)

    def take_off(self, height: float) -> None:
        """In GUIDED, armed, and on its way up."""
        assert "is now" in self.mode("GUIDED")["note"]
        assert self.order("cmd/arming", "CommandBool", value=True)["result"]["success"]
        assert self.order("cmd/takeoff", "CommandTOL", **NOWHERE, altitude=height)["result"]["success"]

    def wait(self, topic: str, condition: str, timeout: float = 30.0) -> None:
        assert self.call("ros2_wait_until", topic_name=topic, condition=condition, timeout_s=timeout)["met"]

    def speed_up(self, times: int) -> None:
        self.call("ros2_parameter_set", node_name="/quadcopter", values={"speedup": times})

    def state(self) -> tuple[str, bool]:
        """Mode, and whether it is armed, now: MAVROS also gives whoever comes late the nine states before."""
        heard = self.call("ros2_topic_subscribe", topic_name="/mavros/state", duration=0.2)["messages"]
        return (heard[-1]["mode"], heard[-1]["armed"]) if heard else ("", False)

    def until(self, mode: str, *, armed: bool) -> None:
        until(lambda: self.state() == (mode, armed))

    def land(self) -> None:
        _, armed = until(lambda: (now := self.state())[0] and now)  # a busy machine may not hear it in one look
        if armed:
            self.speed_up(10)
            self.mode("LAND")
            self.until("LAND", armed=False)
        self.speed_up(1)


def test_it_flies_up_by_velocity_commands_and_hovers_when_they_end(drone: Drone) -> None:
    up = {"linear": {"z": 0.5}}
    drone.call("ros2_topic_publish", topic_name="/X3/cmd_vel", data=up, frequency=20.0, duration=2.5)
    drone.wait("/odom", "pose.pose.position.z > 0.4")
    drone.wait("/odom", "abs(twist.twist.linear.z) < 0.1")
    drone.until("GUIDED", armed=True)
    height = drone.call("ros2_tf_lookup", target="map", source="base_link")["translation"]["z"]
    assert height > 0.3
    scene = drone.call("ros2_scene")
    assert scene["frame_id"] == "map" and scene["robot_age_s"] is not None
    assert (scene["robot_x_m"], scene["robot_y_m"]) == pytest.approx((0.0, 0.0), abs=2.0)
    assert scene["robot_z_m"] > 0.3

    def is_sound() -> bool:
        """Of a second in which a busy machine has not held up the drone."""
        tree = drone.call("ros2_tf_tree", duration_s=1.0, picture=False)
        return (tree["roots"], tree["problems"]) == (["map"], [])

    until(is_sound)
    condition = "pose.pose.position.z > 2.5"
    where = {"topic_name": "/odom", "condition": condition, "command_topic": "/X3/cmd_vel"}
    moved = drone.call("ros2_move_until", **where, linear_z=0.5, timeout_s=20.0)
    assert (moved["outcome"], moved["stopped_with_zero"]) == ("met", True)
    assert "footprint" in {layer["kind"] for layer in scene["layers"]}


@pytest.mark.skipif(not CHROMIUM, reason="needs Chromium")
def test_the_page_shows_a_drone_in_the_air(drone: Drone, drone_environment: dict[str, str]) -> None:
    drone.take_off(3.0)
    with viewing(drone_environment) as address, browsing(graphics=True) as page:
        page.look()
        page.open(address)
        page.until(
            "/Robot at -?[0-9.]+, -?[0-9.]+ metres in map/.test(document.querySelector('#map canvas').ariaLabel)"
        )
        assert page.run(text("#state")) == "live"
        page.until(f"/mavros/.test({text('#agent')})")
        page.until(f"/^map · [23].[0-9]+ m up · pose /.test({text('#map .age')})")
        pictured_in_all_sizes(page, "drone")
        page.run("document.querySelector('[aria-controls=space]').click()")
        page.until("/[1-9][0-9]* shapes of the robot/.test(document.querySelector('#space canvas').ariaLabel)")
        pictured_in_all_sizes(page, "drone-space")
        assert complaints(page) == []


def test_wrong_orders_are_refused_in_words(drone: Drone) -> None:
    def take_off(height: float) -> dict[str, Any]:
        return drone.order("cmd/takeoff", "CommandTOL", **NOWHERE, altitude=height)

    def heard(order: Callable[[], dict[str, Any]], *words: str) -> None:
        note = order()["note"]
        assert all(word in note for word in words), note

    heard(lambda: drone.mode("HOVER"), "has no mode", "HOVER")
    heard(lambda: drone.mode("AUTO"), "NOT accepted", "there is no mission", "not armed")
    assert "is now" in drone.mode("GUIDED")["note"]
    heard(lambda: take_off(5.0), "MAV_RESULT 4, FAILED", "the motors are not armed", "GUIDED, not armed")
    assert drone.order("cmd/arming", "CommandBool", value=True)["result"]["success"]
    heard(lambda: take_off(500.0), "above the ceiling of 100 m", "GUIDED, armed")
    heard(lambda: drone.order("cmd/command", "CommandLong", command=9999), "UNSUPPORTED", "9999 is not supported")
    assert drone.order("cmd/arming", "CommandBool", value=False)["result"]["success"]


@pytest.mark.parametrize("seed", range(MISSIONS))
async def test_the_mission_is_flown_from_the_prompt_to_the_landing(agent: Agent, drone: Drone, seed: int) -> None:
    chosen = random.Random(seed)
    x, y, z = chosen.uniform(-20, 20), chosen.uniform(-20, 20), chosen.uniform(3, 12)
    given = {"dest_x": f"{x}", "dest_y": f"{y}", "dest_z": f"{z}"}
    text = PromptAgent(agent).text("drone-mission", **given)
    heights: list[float] = []

    async def call(tool: str, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        answer = await asyncio.to_thread(lambda: drone.call(tool, **arguments))
        if arguments.get("topic_name", "").endswith("/rel_alt"):
            heights.append(answer["message"]["data"])
            # Not before: armed on the ground it disarms itself after 10 s of its time, and it would soon be down again.
            await asyncio.to_thread(lambda: drone.speed_up(10))
        return answer

    followed = await follow_mission(call, text, dest_x=x, dest_y=y)
    assert followed.failed == ""
    assert heights and heights[0] > 0.5
    fields = ["pose.pose.position.x", "pose.pose.position.y", "pose.pose.position.z"]
    place = drone.call("ros2_topic_echo_wait", topic_name="/odom", fields=fields)["message"]
    assert max(abs(place[field]) for field in fields) < 1.0


@pytest.mark.promise("stopping", "a flight: its vehicle is told to stand")
@pytest.mark.promise("stopping", "an armed vehicle stayed where it is for 1 s")
def test_a_stop_in_the_middle_of_a_flight_makes_it_stand_in_the_air(drone: Drone) -> None:
    drone.take_off(6.0)
    drone.wait("/mavros/global_position/rel_alt", "data > 2")
    stopped = drone.call("ros2_stop")
    [flight] = stopped["flights"]
    assert (flight["vehicle"], flight["mode"], flight["armed"], flight["confirmed"]) == ("/mavros", "BRAKE", True, True)
    assert not [service for service in stopped["unknown_services"] if "mavros" in service]
    drone.wait("/odom", "abs(twist.twist.linear.z) < 0.15 and pose.pose.position.z > 2")
    drone.until("BRAKE", armed=True)
    until(lambda: drone.call("ros2_stop")["observed"] == "observed hovering")


POLICY = """
policy: 1
name: up
mode: autonomous
allow:
  - call: /mavros/set_mode
    type: mavros_msgs/srv/SetMode
    fields: {custom_mode: {in: [GUIDED]}}
  - call: /mavros/cmd/*
    type: mavros_msgs/srv/*
"""
"""It does not allow any mode in which a vehicle stands."""


def test_a_stop_under_a_policy_brakes_whatever_that_allows_and_though_the_latch_is_set(
    drone: Drone, drone_environment: dict[str, str], tmp_path: Path
) -> None:
    (tmp_path / "up.yaml").write_text(POLICY)
    environment = {**drone_environment, "XDG_STATE_HOME": str(tmp_path)}
    server = Driver(environment, "--policy", str(tmp_path / "up.yaml"))
    try:
        until(lambda: "/mavros" in server.outcome(server.tool("ros2_topic_echo_wait", topic_name="/mavros/state")))
        other = Drone(server)
        other.take_off(20.0)
        with pytest.raises(Refusal, match="policy"):
            other.mode("BRAKE")
        drone.wait("/mavros/global_position/rel_alt", "data > 1")
        stopped = server.do("ros2_stop")
        assert [(flight["mode"], flight["confirmed"]) for flight in stopped["flights"]] == [("BRAKE", True)]
        assert stopped["latched"]
        with pytest.raises(Refusal, match="latch"):
            other.mode("GUIDED")
        drone.until("BRAKE", armed=True)
    finally:
        server.end()


@pytest.mark.parametrize("ending", ["it is killed", pytest.param("its client leaves", marks=pytest.mark.full)])
def test_without_its_server_a_flight_is_made_to_stand(
    drone: Drone, drone_environment: dict[str, str], ending: str
) -> None:
    server = Driver(drone_environment)
    try:
        until(lambda: "/mavros" in server.outcome(server.tool("ros2_topic_echo_wait", topic_name="/mavros/state")))
        Drone(server).take_off(30.0)
        drone.wait("/mavros/global_position/rel_alt", "data > 1")
        if ending == "it is killed":
            server.process.kill()
        else:
            server.close()
        drone.until("BRAKE", armed=True)
    finally:
        server.end()
    drone.wait("/odom", "abs(twist.twist.linear.z) < 0.15 and pose.pose.position.z > 1")


@pytest.mark.full
def test_who_has_gone_leaves_a_landing_as_it_is(drone: Drone, drone_environment: dict[str, str]) -> None:
    server = Driver(drone_environment)
    try:
        until(lambda: "/mavros" in server.outcome(server.tool("ros2_topic_echo_wait", topic_name="/mavros/state")))
        other = Drone(server)
        other.take_off(4.0)
        drone.wait("/mavros/global_position/rel_alt", "data > 2")
        assert "is now" in other.mode("LAND")["note"]
        server.close()
    finally:
        server.end()
    drone.until("LAND", armed=False)
