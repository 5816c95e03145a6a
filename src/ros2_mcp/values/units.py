"""The units of numbers in messages, as the common interfaces define them."""

from __future__ import annotations

from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import parse_field


def unit_of(definitions: Definitions, type_name: str, path: str) -> str:
    """Return the unit of a field, such as `m/s`; empty if it has none or it is not known.

    The innermost field with a known unit decides: the `x` of a `Vector3` has none, the `linear` of a `Twist` has.

    Raises:
        BadValue: for a path that does not exist.
    """
    inside, found = type_name, ""
    for step in parse_field(definitions, type_name, path).steps:
        found = _UNITS.get(f"{inside}.{step.field.name}") or found
        inside = step.field.type.base
    name = path.partition("[")[0].lower()
    return found or next((unit for suffix, unit in _SUFFIXES.items() if name.endswith(suffix)), "")


_SUFFIXES = {"_m": "m", "_mps": "m/s", "_s": "s", "_ms": "ms", "_rad": "rad", "_deg": "°", "_hz": "Hz", "voltage": "V"}
"""Suffixes by which robots' own interfaces usually name the unit."""
_BY_INTERFACE = {
    "ackermann_msgs/AckermannDrive": {
        "m/s": "speed",
        "m/s²": "acceleration",
        "rad": "steering_angle",
        "rad/s": "steering_angle_velocity",
    },
    "builtin_interfaces/Duration": {"s": "sec", "ns": "nanosec"},
    "builtin_interfaces/Time": {"s": "sec", "ns": "nanosec"},
    "geometry_msgs/Accel": {"m/s²": "linear", "rad/s²": "angular"},
    "geometry_msgs/Inertia": {"kg": "m"},
    "geometry_msgs/Point": {"m": "x y z"},
    "geometry_msgs/Point32": {"m": "x y z"},
    "geometry_msgs/Pose2D": {"m": "x y", "rad": "theta"},
    "geometry_msgs/Transform": {"m": "translation"},
    "geometry_msgs/Twist": {"m/s": "linear", "rad/s": "angular"},
    "geometry_msgs/Wrench": {"N": "force", "N·m": "torque"},
    "nav_msgs/MapMetaData": {"m": "resolution"},
    "sensor_msgs/BatteryState": {
        "V": "voltage cell_voltage",
        "A": "current",
        "Ah": "charge capacity design_capacity",
        "°C": "temperature cell_temperature",
    },
    "sensor_msgs/FluidPressure": {"Pa": "fluid_pressure"},
    "sensor_msgs/Illuminance": {"lx": "illuminance"},
    "sensor_msgs/Imu": {"rad/s": "angular_velocity", "m/s²": "linear_acceleration"},
    "sensor_msgs/JointState": {"rad or m": "position", "rad/s or m/s": "velocity", "N·m or N": "effort"},
    "sensor_msgs/LaserScan": {
        "m": "ranges range_min range_max",
        "rad": "angle_min angle_max angle_increment",
        "s": "time_increment scan_time",
    },
    "sensor_msgs/MagneticField": {"T": "magnetic_field"},
    "sensor_msgs/NavSatFix": {"°": "latitude longitude", "m": "altitude"},
    "sensor_msgs/Range": {"m": "range min_range max_range", "rad": "field_of_view"},
    "sensor_msgs/Temperature": {"°C": "temperature"},
}
"""Unit → fields, from the comments of the interfaces."""
_UNITS = {
    f"{type_name.replace('/', '/msg/')}.{name}": unit
    for type_name, fields in _BY_INTERFACE.items()
    for unit, names in fields.items()
    for name in names.split()
}
