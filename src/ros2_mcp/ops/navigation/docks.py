"""What a docking server of Nav2 knows of its docks, and what the battery says of charging."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any, cast

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.targets import MAP_FRAME
from ros2_mcp.ops.nodes.own_services import parameter_values
from ros2_mcp.robot import Robot

_ANSWER_S = 1.0
_MOST_DOCKS = 50
_BATTERY = "sensor_msgs/msg/BatteryState"
_BATTERY_S = 2.5
"""Batteries are published once or twice a second."""
_CHANGES_S = 4.0
"""A battery's state follows the contact after a message or two."""
_SUPPLY = {1: "CHARGING", 2: "DISCHARGING", 3: "NOT_CHARGING", 4: "FULL"}
"""power_supply_status of sensor_msgs/msg/BatteryState; 0 is unknown."""


@dataclass(frozen=True, slots=True)
class Dock:
    """A dock of the server's database: its name, its type, and its pose in `frame` (m, radians; None: not known)."""

    name: str
    type: str = ""
    frame: str = MAP_FRAME
    pose: tuple[float, float, float] | None = None


async def docks_of(robot: Robot, action: str) -> Sequence[Dock] | None:
    """Return the docks among the parameters of an action's server; None if they are not there, as with a database in a
    file of its own. Raises no `RobotError`."""
    try:
        servers = sorted(set(await robot.graph.servers(f"{action}/_action/send_goal")))
        if len(servers) != 1:
            return None
        (names,) = await _values(robot, servers[0], ["docks"])
        wanted = [str(name) for name in cast("Sequence[object]", names or ())][:_MOST_DOCKS]
        if not wanted:
            return None
        kinds = ("type", "frame", "pose")
        values = await _values(robot, servers[0], [f"{name}.{kind}" for name in wanted for kind in kinds])
    except RobotError:
        return None
    return [_dock(name, values[3 * index : 3 * index + 3]) for index, name in enumerate(wanted)]


async def _values(robot: Robot, node: str, names: Sequence[str]) -> Sequence[Any]:
    found = await parameter_values(robot, node, names, timeout_s=_ANSWER_S)
    return [found.get(name) for name in names]


def _dock(name: str, values: Sequence[Any]) -> Dock:
    kind, frame, pose = values
    try:
        x, y, yaw = map(float, pose)
    except (TypeError, ValueError):
        return Dock(name, str(kind or ""), str(frame or MAP_FRAME))
    return Dock(name, str(kind or ""), str(frame or MAP_FRAME), (x, y, yaw))


@dataclass(frozen=True, slots=True)
class Battery:
    """The newest state of the battery: its topic, whether it charges (None: not known), and all of it in words."""

    topic: str
    is_charging: bool | None
    words: str


async def battery_of(robot: Robot, charging: bool | None = None) -> Battery | None:
    """Return the present state of the battery. With `charging`, wait a little until the battery reports that it is (or
    is not) charging. None if no battery state is published. Raises no `RobotError`.
    """
    try:
        rows = [row.name for row in await robot.graph.topics() if _BATTERY in row.types and row.publishers]
        if not rows:
            return None
        topic = min(rows, key=lambda name: (len(name), name))
        end, found = monotonic() + _CHANGES_S, None
        async with robot.listen(topic, _BATTERY, keep="latest") as listening:
            while found is None or (charging is not None and found.is_charging != charging and monotonic() < end):
                samples = await listening.take(_BATTERY_S)
                if not samples:
                    break
                found = _battery(topic, await robot.values.in_full(listening.type, samples[-1].data))
                await asyncio.sleep(0)
    except RobotError:
        return None
    return found or Battery(topic, None, f"{named(topic)} was silent for {_BATTERY_S:g} s")


def _battery(topic: str, message: Mapping[str, Any]) -> Battery:
    status = int(message["power_supply_status"])
    said = _SUPPLY.get(status, "UNKNOWN")
    share, current = message["percentage"], message["current"]
    numbers = [f"{share:.0%}"] if isinstance(share, (int, float)) and 0 <= share <= 1 else []
    numbers += [f"{current:+.1f} A"] if isinstance(current, (int, float)) and abs(current) < 1e4 else []
    known = {1: True, 4: True, 2: False, 3: False}.get(status)
    beside = f" ({', '.join(numbers)})" if numbers else ""
    return Battery(topic, known, f"{named(topic)} says {said}{beside}")
