"""The units of numbers in messages, as the common interfaces define them."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.select import parse_fields


def unit_of(definitions: Definitions, type_name: str, path: str) -> str:
    """The unit of a field, such as `m/s`; empty where it has none or it is not known.

    Looked up from the field upwards: the `x` of a `Vector3` says nothing, the `linear` of a `Twist` does.

    Raises:
        BadValue: for a path that does not exist.
    """
    (selection,) = parse_fields(definitions, type_name, [path])
    inside = type_name
    found = ""
    for step in selection.steps:
        name = step.field.name
        found = _UNITS.get(f"{inside}.{name}") or found
        inside = step.field.type.base
    return found or next((unit for suffix, unit in _SUFFIXES.items() if _ends(path, suffix)), "")


def _ends(path: str, suffix: str) -> bool:
    """Whether the name at the end of a path ends like that, an index aside."""
    return path.partition("[")[0].lower().endswith(suffix)


def _of(unit: str, type_name: str, *names: str) -> Iterator[tuple[str, str]]:
    package, _, name = type_name.partition("/")
    yield from ((f"{package}/msg/{name}.{field}", unit) for field in names)


_SUFFIXES = {"_m": "m", "_mps": "m/s", "_s": "s", "_ms": "ms", "_rad": "rad", "_deg": "°", "_hz": "Hz", "voltage": "V"}
_UNITS = dict(
    [
        *_of("m", "geometry_msgs/Point", "x", "y", "z"),
        *_of("m", "geometry_msgs/Point32", "x", "y", "z"),
        *_of("m", "geometry_msgs/Pose2D", "x", "y"),
        *_of("rad", "geometry_msgs/Pose2D", "theta"),
        *_of("m", "geometry_msgs/Transform", "translation"),
        *_of("m/s", "geometry_msgs/Twist", "linear"),
        *_of("rad/s", "geometry_msgs/Twist", "angular"),
        *_of("m/s²", "geometry_msgs/Accel", "linear"),
        *_of("rad/s²", "geometry_msgs/Accel", "angular"),
        *_of("N", "geometry_msgs/Wrench", "force"),
        *_of("N·m", "geometry_msgs/Wrench", "torque"),
        *_of("kg", "geometry_msgs/Inertia", "m"),
        *_of("rad/s", "sensor_msgs/Imu", "angular_velocity"),
        *_of("m/s²", "sensor_msgs/Imu", "linear_acceleration"),
        *_of("T", "sensor_msgs/MagneticField", "magnetic_field"),
        *_of("m", "sensor_msgs/LaserScan", "ranges", "range_min", "range_max"),
        *_of("rad", "sensor_msgs/LaserScan", "angle_min", "angle_max", "angle_increment"),
        *_of("s", "sensor_msgs/LaserScan", "time_increment", "scan_time"),
        *_of("m", "sensor_msgs/Range", "range", "min_range", "max_range"),
        *_of("rad", "sensor_msgs/Range", "field_of_view"),
        *_of("V", "sensor_msgs/BatteryState", "voltage", "cell_voltage"),
        *_of("A", "sensor_msgs/BatteryState", "current"),
        *_of("Ah", "sensor_msgs/BatteryState", "charge", "capacity", "design_capacity"),
        *_of("°C", "sensor_msgs/BatteryState", "temperature", "cell_temperature"),
        *_of("°C", "sensor_msgs/Temperature", "temperature"),
        *_of("Pa", "sensor_msgs/FluidPressure", "fluid_pressure"),
        *_of("lx", "sensor_msgs/Illuminance", "illuminance"),
        *_of("°", "sensor_msgs/NavSatFix", "latitude", "longitude"),
        *_of("m", "sensor_msgs/NavSatFix", "altitude"),
        *_of("rad or m", "sensor_msgs/JointState", "position"),
        *_of("rad/s or m/s", "sensor_msgs/JointState", "velocity"),
        *_of("N·m or N", "sensor_msgs/JointState", "effort"),
        *_of("m/s", "ackermann_msgs/AckermannDrive", "speed"),
        *_of("m/s²", "ackermann_msgs/AckermannDrive", "acceleration"),
        *_of("rad", "ackermann_msgs/AckermannDrive", "steering_angle"),
        *_of("rad/s", "ackermann_msgs/AckermannDrive", "steering_angle_velocity"),
        *_of("m", "nav_msgs/MapMetaData", "resolution"),
        *_of("s", "builtin_interfaces/Time", "sec"),
        *_of("s", "builtin_interfaces/Duration", "sec"),
        *_of("ns", "builtin_interfaces/Time", "nanosec"),
        *_of("ns", "builtin_interfaces/Duration", "nanosec"),
    ]
)
