"""The tour's chapters with the simulated drone: velocity commands, refused orders, a mission from a prompt,
and a stop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from mcp.types import TextContent

from ros2_mcp.commands.prompted import follow_mission
from ros2_mcp.commands.transcript import StepFailed, Tour

_X, _Y, _Z = 8.0, 5.0, 6.0
"""In m east, north and up: a flight of about 25 s, there and back."""
_DRIFT = 1.5
"""The most that the drone may be off after velocity commands, in m, because of wind and estimation."""
_LOOKS = 30
"""The most checks of its state, one per second: a landing from 10 m takes half of them."""
_COMPILED_S, _PAUSE_S = 240, 4
"""The longest wait for MAVROS's interfaces to be compiled, and the time between two checks, in s. Compiling takes one
minute on two busy cores, on a small machine longer.
"""
_ORDER = {"set_mode": "SetMode", "cmd/arming": "CommandBool", "cmd/takeoff": "CommandTOL"}


async def fly_up_one_metre(tour: Tour) -> None:
    """Fly by velocity commands, like the quadcopter in Gazebo's teleop world."""
    tour.say("1. Fly up one metre, by velocity commands, and down again.")
    await _by_hand(tour, 0.5, 2.0)
    await asyncio.sleep(1.0)
    height = await _height(tour)
    tour.verify(f"odometry says that it hovers {height:.2f} m above the ground", 0.7 < height < 1.4)
    seen = await tour.call("ros2_scene")
    x, y, frame = seen["robot_x_m"], seen["robot_y_m"], seen["frame_id"]
    is_there = x is not None and abs(x) < _DRIFT and abs(y) < _DRIFT
    tour.verify(f"the picture has it over where it stood: {x} m, {y} m of {frame}", is_there)
    await _by_hand(tour, -0.5, 4.0)


async def order_wrongly(tour: Tour) -> None:
    """Give orders that an autopilot refuses, and show the explanations."""
    tour.say("2. What it refuses, and why: MAVROS alone answers with a number.")
    if not await _has_mavros(tour):
        raise StepFailed("MAVROS's interfaces could not be built here: see `ros2-mcp interfaces build`.")
    await _disarmed(tour)
    height = {"min_pitch": 0.0, "yaw": 0.0, "latitude": 0.0, "longitude": 0.0, "altitude": 5.0}
    for service, fields in (
        ("cmd/takeoff", height),
        ("set_mode", {"base_mode": 0, "custom_mode": "AUTO"}),
        ("set_mode", {"base_mode": 0, "custom_mode": "HOVER"}),
    ):
        tour.show((await _order(tour, service, fields))["note"])


async def fly_mission(tour: Tour) -> None:
    """Fly the mission of a prompt, to the landing."""
    tour.say(f"3. A mission out of a prompt: {_X:g} m east, {_Y:g} m north, {_Z:g} m high, back, and down.")
    prompt = {"dest_x": f"{_X}", "dest_y": f"{_Y}", "dest_z": f"{_Z}"}
    messages = (await tour.client.get_prompt("drone-mission", prompt)).messages
    text = "\n".join(message.content.text for message in messages if isinstance(message.content, TextContent))

    async def call(tool: str, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        answer = await tour.call(tool, **arguments)
        if note := answer.get("note"):
            tour.show(note)
        return answer

    followed = await follow_mission(call, text, dest_x=_X, dest_y=_Y)
    tour.verify(f"the drone flew from the prompt to the landing {followed.failed}".rstrip(), not followed.failed)


async def stop_in_the_air(tour: Tour) -> None:
    """Stop in the air, where the drone hovers, and then land."""
    tour.say("4. Take off once more, and stop in the middle.")
    await _order(tour, "set_mode", {"base_mode": 0, "custom_mode": "GUIDED"})
    await _order(tour, "cmd/arming", {"value": True})
    take_off = {"min_pitch": 0.0, "yaw": 0.0, "latitude": 0.0, "longitude": 0.0, "altitude": 10.0}
    await _order(tour, "cmd/takeoff", take_off)
    high = "data > 2"
    await tour.call("ros2_wait_until", topic_name="/mavros/global_position/rel_alt", condition=high, timeout_s=20.0)
    stopped = await tour.call("ros2_stop")
    tour.show(stopped["note"])
    flights = stopped["flights"]
    stands = bool(flights) and flights[0]["confirmed"] and flights[0]["armed"]
    tour.verify("it stands in the air, armed", stands)
    await _order(tour, "set_mode", {"base_mode": 0, "custom_mode": "LAND"})
    tour.verify("it landed, and disarmed by itself", await _disarmed(tour))


async def _by_hand(tour: Tour, up: float, seconds: float) -> None:
    value = {"linear": {"z": up}}
    await tour.call("ros2_topic_publish", topic_name="/X3/cmd_vel", data=value, frequency=20.0, duration=seconds)


async def _height(tour: Tour) -> float:
    odometry = await tour.call("ros2_topic_echo_wait", topic_name="/odom", fields=["pose.pose.position.z"])
    return float(odometry["message"]["pose.pose.position.z"])


async def _has_mavros(tour: Tour) -> bool:
    """Wait until MAVROS runs: the first time, its interfaces are compiled meanwhile. Return whether it does."""
    for _ in range(_COMPILED_S // _PAUSE_S):
        listed = await tour.call("ros2_topic_list", pattern="/mavros/state")
        if listed["topics"]:
            return True
        await asyncio.sleep(_PAUSE_S)
    return False


async def _disarmed(tour: Tour) -> bool:
    """Return whether it is disarmed within half a minute."""
    for _ in range(_LOOKS):
        # MAVROS sends late subscribers its last ten states; the newest is last.
        heard = await tour.call("ros2_topic_subscribe", topic_name="/mavros/state", duration=1.0, fields=["armed"])
        if heard["messages"] and not heard["messages"][-1]["armed"]:
            return True
    return False


async def _order(tour: Tour, service: str, fields: Mapping[str, Any]) -> Mapping[str, Any]:
    kind = f"mavros_msgs/srv/{_ORDER[service]}"
    return await tour.call("ros2_service_call", service_name=f"/mavros/{service}", service_type=kind, fields=fields)


DRONE = (fly_up_one_metre, order_wrongly, fly_mission, stop_in_the_air)
