"""Flights: MAVROS' answers to orders in words, and the state of the vehicles after a stop."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import anyio

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named, quoted
from ros2_mcp.robot import Robot
from ros2_mcp.robot.flights import Flight, flight_of
from ros2_mcp.robot.log import LOG_TYPE, level_of
from ros2_mcp_common.policy.flight import BRAKE_MODES, SET_MODE, only_asks, vehicle_of

RESULTS: Mapping[int, str] = {
    0: "ACCEPTED",
    1: "TEMPORARILY_REJECTED",
    2: "DENIED",
    3: "UNSUPPORTED",
    4: "FAILED",
    5: "IN_PROGRESS",
    6: "CANCELLED",
    7: "COMMAND_LONG_ONLY",
    8: "COMMAND_INT_ONLY",
    9: "UNSUPPORTED_MAV_FRAME",
}
"""MAV_RESULT of MAVLink (https://mavlink.io/en/messages/common.html), without its prefix."""
_MODE_S = 2.0
"""Time for a new mode to be reported: at once on a change, or with the autopilot's next heartbeat within a second."""
_TEXT_S = 1.0
"""Time for the autopilot's text about a refusal: it comes within milliseconds, in a log that
is drained ten times a second."""
_LOOK_S = 0.05
"""Seconds between two reads of the log. The log is drained ten times a second."""
_WARNING = 30
"""The level WARN of rcl_interfaces/msg/Log."""
_MOST_TEXTS = 3
_SPOKEN = "FCU: "
"""The prefix that MAVROS writes before the texts of the autopilot in its log."""


@dataclass(frozen=True, slots=True)
class StoppedFlight:
    """A vehicle that was commanded to hold its position. `mode` is the mode that was set; `confirmed`: the vehicle's
    state reports that mode. `armed` is the state of its motors (null: unknown). The vehicle is not disarmed: in the air
    it hovers.
    """

    vehicle: str
    mode: str
    armed: bool | None
    confirmed: bool
    error: str = ""

    @property
    def sentence(self) -> str:
        """The state of the vehicle, as a sentence."""
        if self.error:
            return f"{named(self.vehicle)} was NOT confirmed to hold its position: {quoted(self.error)}"
        if self.armed is False:
            return f"{named(self.vehicle)} is disarmed."
        until = "still armed: in the air it stays there until LAND or RTL"
        return f"{named(self.vehicle)} holds its position in {self.mode}, {until}."


async def brake_flights(robot: Robot) -> list[StoppedFlight]:
    """Brake every vehicle to which this server has given an order. Return the outcome of each."""

    async def brake(flight: Flight) -> StoppedFlight:
        braked = await flight.brake()
        return StoppedFlight(flight.vehicle, braked.mode, flight.armed, braked.confirmed, braked.error)

    return list(await asyncio.gather(*(brake(flight) for flight in robot.jobs.running(Flight))))


def is_order(service: str, service_type: str, request: Mapping[str, Any]) -> bool:
    """Return whether a service call is an order to a vehicle."""
    return bool(vehicle_of(service, service_type)) and not only_asks(service_type, request)


async def outcome(
    robot: Robot,
    service: str,
    service_type: str,
    request: Mapping[str, Any],
    response: Mapping[str, Any],
    since_ns: int,
) -> str:
    """Return the outcome of an order in sentences: whether it was followed or why not, as far as the vehicle reports.

    `since_ns` is when the order was sent, by the robot's clock.
    """
    vehicle = vehicle_of(service, service_type)
    flight = flight_of(robot, vehicle)
    if service_type == SET_MODE:
        return await _outcome_of_mode(robot, vehicle, flight, str(request.get("custom_mode", "")), response, since_ns)
    if response.get("success"):
        stop = f"ros2_stop makes it hold its position ({BRAKE_MODES[0]} or similar), and never disarms it"
        return f"Until {named(vehicle)} reports that it is disarmed, {stop}." if flight else ""
    code = response.get("result")
    result = f" (MAV_RESULT {code}, {RESULTS.get(code, 'unknown')})" if isinstance(code, int) else ""
    return f"Refused{result}. {await _reasons(robot, vehicle, flight, since_ns)}".rstrip()


async def _outcome_of_mode(
    robot: Robot, vehicle: str, flight: Flight | None, mode: str, response: Mapping[str, Any], since_ns: int
) -> str:
    if not response.get("mode_sent"):
        return f"MAVROS did not send it: this autopilot has no mode {quoted(mode)}. {_state(flight)}".rstrip()
    if flight is None or not mode:
        return "The command was sent; whether the vehicle accepted it is unknown."
    if await flight.until(lambda: flight.mode == mode, _MODE_S):
        return f"The mode is now {named(mode)}."
    reasons = await _reasons(robot, vehicle, flight, since_ns)
    return f"The command was sent, but NOT accepted within {_MODE_S:g} s. {reasons}".rstrip()


async def _reasons(robot: Robot, vehicle: str, flight: Flight | None, since_ns: int) -> str:
    """Return the autopilot's texts and the vehicle's state, as sentences."""
    texts = await _words(robot, vehicle, since_ns)
    said = f"The autopilot says: {'; '.join(quoted(text) for text in texts)}." if texts else ""
    return " ".join(part for part in (said, _state(flight)) if part)


def _state(flight: Flight | None) -> str:
    if flight is None or flight.armed is None:
        return ""
    return f"It is in mode {named(flight.mode)}, {'armed' if flight.armed else 'not armed'}."


async def _words(robot: Robot, vehicle: str, since_ns: int) -> Sequence[str]:
    """Return the autopilot's texts since `since_ns`, the newest last: MAVROS writes them into the robot's log.

    Wait up to 1 s for warnings and errors: a text of a lower level may still be about the previous order.
    """
    try:
        await robot.values.learn(LOG_TYPE)
    except RobotError:
        return ()
    robot.log.start()
    with anyio.move_on_after(_TEXT_S):
        while not (texts := _spoken(robot, vehicle, since_ns, _WARNING)):
            await asyncio.sleep(_LOOK_S)
        return texts
    return _spoken(robot, vehicle, since_ns, 0)


def _spoken(robot: Robot, vehicle: str, since_ns: int, least_level: int) -> Sequence[str]:
    logger, texts = vehicle.strip("/").replace("/", "."), list[str]()
    for sample in robot.log.lines:
        if level_of(sample.data) < least_level or _SPOKEN.encode() not in sample.data:
            continue
        line: Any = robot.values.decode(LOG_TYPE, sample)
        at_ns = line.stamp.sec * 1_000_000_000 + line.stamp.nanosec
        if line.msg.startswith(_SPOKEN) and line.name.startswith(logger) and at_ns >= since_ns:
            texts.append(line.msg[len(_SPOKEN) :])
    return texts[-_MOST_TEXTS:]
