"""Orders to a vehicle are flights: known before they leave, made to stand by a stop, left alone on their way down."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any, cast

import pytest

from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import LOCAL, Publish
from ros2_mcp.model.errors import NotFound
from ros2_mcp.robot import Robot
from ros2_mcp.robot.flights import STATE_TYPE, Flight, flight_of
from ros2_mcp_common.policy.flight import BRAKE_MODES, SET_MODE, brakes, only_asks, vehicle_of
from support import noting_bridge
from support.noting_bridge import CHOICE, Noting, call, on
from support.tasks import soon

ARMING, LONG = "mavros_msgs/srv/CommandBool", "mavros_msgs/srv/CommandLong"
DEFINITIONS = {
    SET_MODE: ("srv", "uint8 base_mode\nstring custom_mode\n---\nbool mode_sent\n"),
    ARMING: ("srv", "bool value\n---\nbool success\nuint8 result\n"),
    LONG: ("srv", "uint16 command\n---\nbool success\nuint8 result\n"),
    STATE_TYPE: ("msg", "std_msgs/Header header\nbool connected\nbool armed\nstring mode\n"),
}
STATE = "/uav/mavros/state"


@pytest.fixture
def bridge(monkeypatch: pytest.MonkeyPatch) -> Noting:
    monkeypatch.setattr(noting_bridge, "DEFINITIONS", {**noting_bridge.DEFINITIONS, **DEFINITIONS})
    bridge = Noting()
    qos = {"reliability": "reliable", "durability": "transient_local", "history": "keep_last", "depth": 10}
    qos |= {"liveliness": "automatic", "deadline_ns": None, "lifespan_ns": None, "liveliness_lease_ns": None}  # type: ignore[dict-item]
    bridge.publishers = [{"node": "sys", "namespace": "/", "type": STATE_TYPE, "hash": "", "gid": "", "qos": qos}]
    return bridge


class Vehicle:
    """What it says of itself, and what it is told."""

    def __init__(self, robot: Robot, bridge: Noting) -> None:
        self.robot = robot
        self.bridge = bridge

    async def order(self, armed: bool = True) -> Flight:
        """An order was given, and the vehicle has said that it is armed."""
        await self.robot.values.learn(ARMING, SET_MODE, STATE_TYPE)
        self.bridge.answer = self.robot.values.encode_known(f"{ARMING}_Response", {"success": True, "result": 0})
        await self.robot.do(call(ARMING, "/uav/mavros/cmd/arming", {"value": True}))
        flight = flight_of(self.robot, "/uav/mavros")
        assert flight
        await soon(lambda: STATE in self.bridge.listening)
        if armed:
            await self.says("GUIDED", armed=True)
        return flight

    async def says(self, mode: str, *, armed: bool) -> None:
        body = self.robot.values.encode_known(STATE_TYPE, {"mode": mode, "armed": armed, "connected": True})
        now_ns = self.robot.now_ns()
        header: Any = {"samples": [(now_ns, now_ns, 1, len(body), 0)], "received": 1, "dropped": 0, "lost": 0}
        self.bridge.listening[STATE].arrived(header, body)
        [flight] = self.robot.jobs.all(Flight)
        await soon(lambda: (flight.mode, flight.armed) == (mode, armed))

    def takes(self, taken: bool) -> None:
        self.bridge.answer = self.robot.values.encode_known(f"{SET_MODE}_Response", {"mode_sent": taken})


@pytest.fixture
async def vehicle(bridge: Noting) -> AsyncGenerator[Vehicle, None]:
    robot = Robot(cast(Bridge, bridge))
    yield Vehicle(robot, bridge)
    await robot.jobs.close()
    robot.failsafes.close()


@pytest.mark.parametrize(
    ("service", "kind", "expected"),
    [
        ("/mavros/set_mode", SET_MODE, "/mavros"),
        ("/uav1/mavros/cmd/arming", ARMING, "/uav1/mavros"),
        ("/mavros/mission/push", "mavros_msgs/srv/WaypointPush", "/mavros"),
        ("/set_mode", SET_MODE, ""),
        ("/mavros/arm", ARMING, ""),
        ("/mavros/cmd/a/b", ARMING, ""),
        ("/mavros/set_mode", "std_srvs/srv/SetBool", ""),
        ("/mavros/param/set", "mavros_msgs/srv/ParamSetV2", ""),
    ],
)
def test_which_vehicle_an_order_is_for(service: str, kind: str, expected: str) -> None:
    assert vehicle_of(service, kind) == expected


def test_a_command_that_only_asks_for_a_message_is_no_order() -> None:
    assert only_asks(LONG, {"command": 512})
    assert not only_asks(LONG, {"command": 400})
    assert not only_asks(ARMING, {"value": True})


def test_only_a_known_mode_of_a_vehicle_makes_it_stand() -> None:
    class Request:
        def __init__(self, mode: str, base: int = 0) -> None:
            self.custom_mode, self.base_mode = mode, base

    assert all(brakes("/mavros/set_mode", SET_MODE, Request(mode)) for mode in BRAKE_MODES)
    assert not brakes("/mavros/set_mode", SET_MODE, Request("AUTO"))
    assert not brakes("/mavros/set_mode", SET_MODE, Request("BRAKE", 209))
    assert not brakes("/mode", SET_MODE, Request("BRAKE"))


async def test_an_order_is_a_job_with_its_fail_safe_before_it_leaves(vehicle: Vehicle, bridge: Noting) -> None:
    flight = await vehicle.order()
    acts = [op for op in bridge.sent if op in ("failsafe_call", "call")]
    assert acts == ["failsafe_call"] * len(BRAKE_MODES) + ["call"]
    assert (flight.is_running, flight.armed, flight.owner) == (True, True, LOCAL)
    assert vehicle.robot.stops.unknown.names("service") == []
    assert vehicle.robot.moves_for(LOCAL)
    assert await vehicle.order() is flight  # another order to the same vehicle is no second flight


async def test_a_place_to_go_to_is_part_of_the_flight_and_of_no_other_vehicles(vehicle: Vehicle) -> None:
    await vehicle.order()
    for name in ("/uav/mavros/setpoint_position/local", "/other/setpoint_position/local"):
        given = {**on(name, value={"data": 1}), "type": "std_msgs/msg/Int32"}
        number = Publish(**given, choice=CHOICE, wait_match_s=0.0)
        await vehicle.robot.do(number)
    assert vehicle.robot.stops.unknown.names("topic") == ["/other/setpoint_position/local (std_msgs/msg/Int32)"]


async def test_it_ends_when_the_vehicle_is_heard_to_be_disarmed(
    vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = await vehicle.order()
    await vehicle.says("GUIDED", armed=False)
    assert flight.is_running  # that may have been before the order had its effect
    monkeypatch.setattr("ros2_mcp.robot.flights._EFFECT_S", 0.0)
    await vehicle.says("LAND", armed=True)
    await vehicle.says("LAND", armed=False)
    assert not flight.is_running
    assert flight_of(vehicle.robot, "/uav/mavros") is None


async def test_an_order_that_never_left_begins_no_flight(vehicle: Vehicle, bridge: Noting) -> None:
    bridge.refuse = {"call": "not_found"}
    with pytest.raises(NotFound):
        await vehicle.robot.do(call(ARMING, "/uav/mavros/cmd/arming", {"value": True}))
    assert vehicle.robot.jobs.running(Flight) == []


async def test_it_is_made_to_stand_in_the_first_mode_that_is_taken_and_its_state_confirms_it(
    vehicle: Vehicle, bridge: Noting
) -> None:
    flight = await vehicle.order()
    vehicle.takes(True)
    braking = asyncio.create_task(flight.brake())
    await soon(lambda: bridge.sent[-1] == "call" and bridge.arguments["call"]["type"] == SET_MODE)
    assert "epoch" not in bridge.arguments["call"]  # no stop holds it up
    await vehicle.says("BRAKE", armed=True)
    braked = await braking
    assert (braked.mode, braked.confirmed, braked.error) == ("BRAKE", True, "")
    assert flight.is_running  # it is in the air, and armed


async def test_a_vehicle_that_takes_no_mode_is_said_to_go_on(vehicle: Vehicle) -> None:
    flight = await vehicle.order()
    vehicle.takes(False)
    braked = await flight.brake()
    assert (braked.mode, braked.confirmed) == ("", False)
    assert "accepted none of the modes" in braked.error


async def test_the_end_of_its_client_makes_it_stand_but_not_on_its_way_down(vehicle: Vehicle, bridge: Noting) -> None:
    flight = await vehicle.order()
    vehicle.takes(True)
    await vehicle.says("RTL", armed=True)
    calls = bridge.sent.count("call")
    await vehicle.robot.stop_owned(LOCAL)
    assert bridge.sent.count("call") == calls
    await vehicle.says("GUIDED", armed=True)
    leaving = asyncio.create_task(vehicle.robot.stop_owned(LOCAL))
    await soon(lambda: bridge.sent.count("call") > calls)
    await vehicle.says("BRAKE", armed=True)
    assert await leaving == [f"flight {flight.id}"]


async def test_its_fail_safe_is_taken_back_on_its_way_down_and_left_again_when_it_goes_on(vehicle: Vehicle) -> None:
    await vehicle.order()
    kept: Any = vehicle.robot.failsafes._flights  # pyright: ignore[reportPrivateUsage]
    assert list(kept) == ["/uav/mavros"]
    await vehicle.says("LAND", armed=True)
    assert list(kept) == []
    await vehicle.says("AUTO", armed=True)
    assert list(kept) == ["/uav/mavros"]


async def test_the_end_of_the_server_leaves_a_flight_to_its_fail_safe(vehicle: Vehicle, bridge: Noting) -> None:
    flight = await vehicle.order()
    calls = bridge.sent.count("call")
    await vehicle.robot.jobs.close()
    kept: Any = vehicle.robot.failsafes._flights  # pyright: ignore[reportPrivateUsage]
    assert (flight.is_running, bridge.sent.count("call"), list(kept)) == (False, calls, ["/uav/mavros"])
