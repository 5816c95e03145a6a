"""The robot's sensors in words: topic, type, rate, mount, range and field of view of each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.nav2 import is_drawn_by_nav2
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.body import MountInWords
from ros2_mcp.ops.space.heads import Head
from ros2_mcp.ops.space.inputs import LOW_LEVEL, REPORT
from ros2_mcp_common.finite import not_finite

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
SENSORS = (
    "sensor_msgs/msg/LaserScan",
    _IMAGE,
    "sensor_msgs/msg/Range",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/MagneticField",
    "sensor_msgs/msg/FluidPressure",
    _COMPRESSED,
    "sensor_msgs/msg/Temperature",
    "sensor_msgs/msg/RelativeHumidity",
    "sensor_msgs/msg/Illuminance",
)
"""Message types of sensors, in the order in which they are listed."""
MISSED = frozenset(SENSORS[:7])
"""Types whose silence is a fault; drivers advertise the others even for devices that lack the sensor."""
_OF_ROS = (
    "ackermann_msgs", "action_msgs", "actionlib_msgs", "bond", "builtin_interfaces", "control_msgs",
    "controller_manager_msgs", "diagnostic_msgs", "geometry_msgs", "lifecycle_msgs", "map_msgs", "moveit_msgs",
    "nav2_msgs", "nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "service_msgs", "shape_msgs",
    "statistics_msgs", "std_msgs", "stereo_msgs", "tf2_msgs", "trajectory_msgs", "type_description_interfaces",
    "unique_identifier_msgs", "visualization_msgs",
)  # fmt: skip
"""Packages of standard messages: their sensors are in `SENSORS`, and their other types are not specific to a robot."""
ODOMETRY, JOINT_STATE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
_DESCRIPTIONS = ("robot_description", "robot_description_semantic")
_WHOLE_HZ = 9.95


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor's topic. `state` is its rate, `silent`, or the charge of a battery; `at` is x y z in m and the rotation
    of `frame` in the base's frame, which `note` qualifies; `sees` is the range in m and the angle of a scanner; `view`
    is the horizontal field of view of a camera in degrees.
    """

    topic: str
    type: str
    state: str = ""
    frame: str = ""
    at: str = ""
    note: str = ""
    sees: str = ""
    view: str = ""

    @property
    def line(self) -> str:
        """The sensor in words, such as `/scan LaserScan 10 Hz in laser at 0.2 0 0.3 yaw 180°, 0.1 to 12 m over
        360°`.
        """
        view = f"{self.view}° wide" if self.view else ""
        at = f"at {self.at}" if self.at else ""
        where = f"in {named(self.frame)} {at}".rstrip() + self.note if self.frame else ""
        said = " ".join(filter(None, (named(self.topic), named(self.type), self.state, view, where)))
        return f"{said}, {self.sees}" if self.sees else said


def ranked(graph: GraphSnapshot) -> Sequence[tuple[TopicEndpoints, str]]:
    """Return the topics of sensors with their types. The first topic of each type precedes the second of any, so that a
    cut list shows every type; types are in the order of `SENSORS`. Compressed copies of images are excluded.
    """
    published = [one for one in graph.topics.values() if one.publishers and not is_drawn_by_nav2(one)]
    pictures = {one.topic for one in published if _IMAGE in one.types}
    of_kind: dict[str, list[TopicEndpoints]] = {kind: [] for kind in SENSORS}
    for one in sorted(published, key=lambda one: one.topic):
        kind = next((kind for kind in one.types if kind in of_kind), "")
        is_copy = kind == _COMPRESSED and one.topic.rpartition("/")[0] in pictures
        if kind and not is_copy:
            of_kind[kind].append(one)
    found = [
        (place, rank, one, kind)
        for rank, (kind, all_of) in enumerate(of_kind.items())
        for place, one in enumerate(all_of)
    ]
    return [(one, kind) for _, _, one, kind in sorted(found, key=lambda each: each[:2])]


def sensors_of(
    graph: GraphSnapshot,
    heads: Mapping[str, Head],
    mounts: Mapping[str, MountInWords],
    ranges: Mapping[str, str],
    batteries: Mapping[str, str],
    views: Mapping[str, str],
) -> list[Sensor]:
    """Return the sensors in the order of `ranked`, with batteries after the first; `mounts` by frame, the others by
    topic.
    """
    found: list[Sensor] = []
    for one, type_name in ranked(graph):
        head = heads.get(one.topic)
        frame = head.frame if head else ""
        mount = mounts.get(frame, MountInWords())
        sensor = Sensor(one.topic, type_name.rpartition("/")[2], _state_in_words(head), frame, mount.at, mount.note)
        found.append(replace(sensor, sees=ranges.get(one.topic, ""), view=views.get(one.topic, "")))
    return [*found[:1], *(Sensor(topic, "BatteryState", said) for topic, said in batteries.items()), *found[1:]]


def _state_in_words(head: Head | None) -> str:
    return "" if head is None else "silent" if not head.count else rate_in_words(head)


def rate_in_words(head: Head) -> str:
    """Return the rate in words; empty if it is not known."""
    return "under 2 Hz" if head.is_rare else _rate_in_words(head.rate_hz)


def _rate_in_words(rate_hz: float | None) -> str:
    """Return a rate with two digits, as more are not significant; empty if it is not known."""
    if rate_hz is None:
        return ""
    return f"{rate_hz:.0f} Hz" if rate_hz >= _WHOLE_HZ else f"{rate_hz:.2g} Hz"


def sees_in_words(message: Any) -> str:
    """Return the range in m and the angle of a LaserScan or Range; "unknown" with the reason for values that are not
    finite.
    """
    if hasattr(message, "min_range"):
        nearest, farthest, wide_rad = "min_range", "max_range", float(message.field_of_view)
        unknown_width = not_finite(message, "field_of_view")
    else:
        nearest, farthest = "range_min", "range_max"
        wide_rad = abs(float(message.angle_max) - float(message.angle_min))
        unknown_width = not_finite(message, "angle_min", "angle_max")
    wide = f" over {math.degrees(wide_rad):.0f}°" if math.isfinite(wide_rad) and wide_rad > 0 else ""
    wide = f", angle unknown ({unknown_width})" if unknown_width else wide
    if why := not_finite(message, nearest, farthest):
        return f"range unknown ({why}){wide}"
    return f"{getattr(message, nearest):.3g} to {getattr(message, farthest):.3g} m{wide}"


def view_in_words(message: Any) -> str:
    """Return the horizontal field of view in degrees from a CameraInfo; empty if its focal length is not set."""
    focal_px = float(message.k[0])
    if not (math.isfinite(focal_px) and focal_px > 0):
        return ""
    return f"{math.degrees(2 * math.atan(message.width / 2 / focal_px)):.0f}"


def charge_of(message: Any) -> float | None:
    """Return the charge of a BatteryState, from 0 to 1; None if the message does not report it."""
    share = float(message.percentage)
    share = share / 100 if share > 1 else share  # some drivers send percent, contrary to the definition
    is_told = 0 < share <= 1 or (share == 0 and message.capacity > 0)  # 0 without a capacity was never set
    return share if is_told else None


def state_topics(graph: GraphSnapshot) -> list[tuple[str, str]]:
    """Return other topics on which the robot reports about itself, with their types: odometry and joint states first,
    then types of the manufacturer (bumpers, motors), and plain numbers and states.
    """
    return [
        (one.topic, one.types[0])
        for one in sorted(graph.topics.values(), key=lambda one: (not _is_usual(one), one.topic.count("/"), one.topic))
        if one.publishers and "/_" not in one.topic and (_is_usual(one) or _is_own(one))
        if REPORT.search(one.topic) or not LOW_LEVEL.search(one.topic)
    ]


def _is_usual(topic: TopicEndpoints) -> bool:
    kind = topic.types[0]
    return kind == ODOMETRY or (kind == JOINT_STATE and topic.topic.endswith("joint_states"))


def _is_own(topic: TopicEndpoints) -> bool:
    package = topic.types[0].partition("/")[0]
    is_plain = package == "std_msgs" and not topic.topic.endswith(_DESCRIPTIONS)
    return is_plain or package not in _OF_ROS
