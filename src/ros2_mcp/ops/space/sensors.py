"""The robot's sensors in words: which there are, how often they come, where each sits and how far it sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.heads import Head
from ros2_mcp.ops.space.inputs import LOW_LEVEL, in_short

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
"""In the order in which they are told."""
_OF_ROS = (
    "ackermann_msgs", "action_msgs", "actionlib_msgs", "bond", "builtin_interfaces", "control_msgs",
    "controller_manager_msgs", "diagnostic_msgs", "geometry_msgs", "lifecycle_msgs", "map_msgs", "moveit_msgs",
    "nav2_msgs", "nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "service_msgs", "shape_msgs",
    "statistics_msgs", "std_msgs", "stereo_msgs", "tf2_msgs", "trajectory_msgs", "type_description_interfaces",
    "unique_identifier_msgs", "visualization_msgs",
)  # fmt: skip
"""Packages of messages that are of no robot's own: what of them is a sensor's stands above."""


def ranked(graph: GraphSnapshot) -> Sequence[tuple[TopicEndpoints, str]]:
    """The topics of sensors with their types: of each kind the first one before the second of any, for who sees only
    some; the kinds in the order of `SENSORS`. A compressed copy of a picture is no sensor of its own.
    """
    published = [one for one in graph.topics.values() if one.publishers]
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


def sensors_in_words(
    graph: GraphSnapshot,
    heads: Mapping[str, Head],
    mounts: Mapping[str, str],
    ranges: Mapping[str, str],
    batteries: Mapping[str, float | None],
) -> list[str]:
    """A line each: topic, type, rate, frame with its place in `mounts`, and what it sees; batteries after the first."""
    found: list[str] = []
    told = set[str]()
    for one, type_name in ranked(graph):
        head = heads.get(one.topic)
        said = f"{named(one.topic)} {type_name.rpartition('/')[2]}"
        if head and not head.count:
            said += " silent"
        elif head and head.rate_hz:
            said += f" {head.rate_hz:.3g} Hz"
        if head and head.frame:  # of several sensors in one frame the first tells where it sits
            said += f" in {named(head.frame)}{'' if head.frame in told else mounts.get(head.frame, '')}"
            told.add(head.frame)
        found.append(f"{said}, {ranges[one.topic]}" if one.topic in ranges else said)
    full = {topic: "" if share is None else f" {share:.0%}" for topic, share in batteries.items()}
    return [*found[:1], *(f"{named(topic)} BatteryState{said}" for topic, said in full.items()), *found[1:]]


def of_own_types(graph: GraphSnapshot, most: int) -> str:
    """What else the robot publishes in types of its makers: such as bumpers, motors, sound; empty where nothing is."""
    found = [
        f"{named(one.topic)} {named(one.types[0].rpartition('/')[2])}"
        for one in sorted(graph.topics.values(), key=lambda one: (one.topic.count("/"), one.topic))
        if one.publishers and "/_" not in one.topic and one.types[0].partition("/")[0] not in _OF_ROS
        if not LOW_LEVEL.search(one.topic)
    ]
    return f"of its own types: {in_short(found, most)}" if found else ""
