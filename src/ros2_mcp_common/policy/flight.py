"""Orders to an autopilot through MAVROS, and the modes that stop a vehicle (never disarming).
Server and bridge share them.

Needs no ROS. Names and numbers are those of MAVROS 2 and MAVLink (https://mavlink.io/en/messages/common.html).
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
"""The service types that may set a vehicle in motion, each with what follows the vehicle's
name in the service's name.
"""

BRAKE_MODES = ("BRAKE", "AUTO.LOITER", "LOITER", "HOLD")
"""The modes in which a vehicle holds still without a pilot at the sticks, in the order in which to try them.

BRAKE is a mode of ArduCopter, AUTO.LOITER of PX4, LOITER of ArduPlane, HOLD of ArduPilot's rovers and boats. MAVROS
rejects a mode that its autopilot does not have (`mode_sent` is false), so the modes can be tried one after the other.
"""
DESCENT_MODES = ("RTL", "SMART_RTL", "LAND", "QRTL", "QLAND", "AUTO.RTL", "AUTO.LAND", "AUTO.PRECLAND")
"""The modes that bring a vehicle home or down by themselves: a vehicle to which the link is
lost is better left in them.
"""

_READING = (410, 510, 511, 512, 519, 520, 521, 525, 526, 527)
"""Commands of MAVLink that only request a message or set its rate."""


def vehicle_of(service: str, service_type: str) -> str:
    """Return the vehicle, such as `/mavros`, to which a call of this service is an order; "" if the call is no order.

    The name of a service that MAVROS would not offer gives "", too.
    """
    behind = ORDERS.get(service_type)
    if behind is None:
        return ""
    if behind.endswith("/"):
        vehicle, found, last = service.rpartition(behind)
        return vehicle if found and last and "/" not in last else ""
    return service[: -len(behind)] if service.endswith(behind) else ""


def only_asks(service_type: str, request: Any) -> bool:
    """Return whether an order, as JSON or decoded, only requests messages from the autopilot."""
    if service_type != COMMAND_LONG:
        return False
    if isinstance(request, Mapping):
        return cast("Mapping[str, Any]", request).get("command") in _READING
    return getattr(request, "command", None) in _READING


def brakes(service: str, service_type: str, request: Any) -> bool:
    """Return whether a decoded request is a brake: it sets a mode in which the vehicle holds still."""
    return (
        service_type == SET_MODE
        and bool(vehicle_of(service, service_type))
        and request.base_mode == 0
        and request.custom_mode in BRAKE_MODES
    )
