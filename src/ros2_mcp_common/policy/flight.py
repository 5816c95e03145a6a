"""Orders to an autopilot through MAVROS, and what stops it: never disarming. Both sides use this table; needs no ROS.

Names and numbers are those of MAVROS 2 and MAVLink (https://mavlink.io/en/messages/common.html).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

SET_MODE = "mavros_msgs/srv/SetMode"
COMMAND_LONG = "mavros_msgs/srv/CommandLong"

ORDERS: Mapping[str, str] = {
    SET_MODE: "/set_mode",
    "mavros_msgs/srv/CommandBool": "/cmd/",
    "mavros_msgs/srv/CommandTOL": "/cmd/",
    "mavros_msgs/srv/CommandTOLLocal": "/cmd/",
    COMMAND_LONG: "/cmd/",
    "mavros_msgs/srv/CommandInt": "/cmd/",
    "mavros_msgs/srv/WaypointPush": "/mission/",
    "mavros_msgs/srv/WaypointSetCurrent": "/mission/",
    "mavros_msgs/srv/WaypointClear": "/mission/",
}
"""Types of services that may set a vehicle in motion, each with what stands in its name behind the vehicle's."""

BRAKE_MODES = ("BRAKE", "AUTO.LOITER", "LOITER", "HOLD")
"""Modes in which a vehicle stands, and nobody need be at the sticks; the best of each autopilot comes first.

BRAKE is ArduCopter's, AUTO.LOITER PX4's, LOITER that of ArduPlane, HOLD that of ArduPilot's rovers and boats. MAVROS
refuses a mode that its autopilot does not have (`mode_sent` is false), so that they can be tried one after the other.
"""
DESCENT_MODES = ("RTL", "SMART_RTL", "LAND", "QRTL", "QLAND", "AUTO.RTL", "AUTO.LAND", "AUTO.PRECLAND")
"""Modes that bring a vehicle home or down by themselves: who is cut off from it does better to leave it in them."""

_READING = (410, 510, 511, 512, 519, 520, 521, 525, 526, 527)
"""Commands of MAVLink that only ask for a message, or how often it comes."""


def vehicle_of(service: str, service_type: str) -> str:
    """The name under which the vehicle has its services, such as `/mavros`, where a call of this one is an order to it;
    "" where it is none, or has a name that MAVROS does not give.
    """
    behind = ORDERS.get(service_type)
    if behind is None:
        return ""
    if behind.endswith("/"):
        vehicle, found, last = service.rpartition(behind)
        return vehicle if found and last and "/" not in last else ""
    return service[: -len(behind)] if service.endswith(behind) else ""


def only_asks(service_type: str, request: Any) -> bool:
    """Whether an order, as JSON or decoded, only asks the autopilot for something."""
    if service_type != COMMAND_LONG:
        return False
    if isinstance(request, Mapping):
        return cast("Mapping[str, Any]", request).get("command") in _READING
    return getattr(request, "command", None) in _READING


def brakes(service: str, service_type: str, request: Any) -> bool:
    """Whether a request, decoded, is one that makes a vehicle stand."""
    return (
        service_type == SET_MODE
        and bool(vehicle_of(service, service_type))
        and request.base_mode == 0
        and request.custom_mode in BRAKE_MODES
    )
