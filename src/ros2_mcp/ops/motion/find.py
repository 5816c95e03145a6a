"""What a robot is driven by and seen with, found in its graph: command input, odometry, scan, and where that sits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.space.frames import pose_in
from ros2_mcp.robot import Robot
from ros2_mcp.robot.resolution import Destination

DRIVEN_TYPES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""Command inputs that steer on the spot, too. What steers like a car needs its wheel base, which nobody tells."""
ODOMETRY = "nav_msgs/msg/Odometry"
SCAN = "sensor_msgs/msg/LaserScan"
_INPUTS = ("cmd_vel",)
_ODOMETRIES = ("odometry/filtered", "odom", "odometry", "odometry/wheels")
_SCANS = ("scan",)
"""What these topics are usually called, the better first: fused odometry is that of robot_localization."""
_FIRST_S = 4.0
"""For a first message: a publisher that missed our announcement is discovered with the next one, 3 s later."""
_MOST_NAMED = 6


@dataclass(frozen=True, slots=True)
class Found:
    """A topic with its type."""

    topic: str
    type: str

    @property
    def feed(self) -> Mapping[str, str]:
        """As a controller is told of it."""
        return {"topic": self.topic, "type": self.type}


async def command_input(robot: Robot, given: str = "") -> Destination:
    """Where velocity commands go: the given topic, else the one that somebody listens to.

    Raises:
        NotFound: if there is none; with those that there are, of types that cannot be driven so.
        BadInput: if there are several, or the given one is of another type.
    """
    if not given:
        rows = await robot.graph.topics()
        found = [row.name for row in rows if row.subscribers and set(row.types) & set(DRIVEN_TYPES)]
        given = _only("command input", "topic_name", found, _INPUTS)
    destination = await robot.types.destination(given, "")
    if destination.type not in DRIVEN_TYPES:
        raise BadInput(
            f"{named(destination.topic)} has the type {named(destination.type)}: a motion needs Twist or TwistStamped.",
            "Send that type with ros2_topic_publish.",
        )
    return destination


async def odometry_of(robot: Robot, given: str = "", beside: str = "") -> Found:
    """Where the robot tells how it moves: the given topic, else the only odometry, or that beside the command input.

    Raises:
        NotFound: if there is none.
        BadInput: if it is not clear which.
    """
    return await _published(robot, "odometry", "odometry", given, ODOMETRY, _ODOMETRIES, beside)


async def scan_of(robot: Robot, given: str = "", beside: str = "") -> Found:
    """The laser scan that shows what is in the way; raises as `odometry_of`."""
    return await _published(robot, "laser scan", "scan", given, SCAN, _SCANS, beside)


async def first_message(robot: Robot, found: Found) -> Mapping[str, Any]:
    """The next message of a topic, in full; raises `NotFound` if none comes."""
    async with robot.listen(found.topic, found.type, max_samples=2) as listening:
        async for sample in listening.samples(_FIRST_S):
            return await robot.values.in_full(listening.type, sample.data)
    raise NotFound(f"No message on {named(found.topic)} within {_FIRST_S:g} s.", "ros2_topic_info shows who publishes.")


async def mount_of(robot: Robot, scan_frame: str, base_frame: str) -> Mapping[str, Sequence[float]]:
    """Where a scanner sits in the base's frame: `translation` (m) and `rotation` (quaternion x, y, z, w).

    Raises:
        NotFound: if the transforms do not tell it.
    """
    scan_frame, base_frame = scan_frame.lstrip("/"), base_frame.lstrip("/")
    if scan_frame == base_frame:
        return {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0)}

    try:
        pose = (await pose_in(Live(robot), base_frame, scan_frame)).pose
    except RobotError as error:
        problem = f"The position of {named(scan_frame)} on the robot is unknown, so its scan cannot guard: {error}"
        raise NotFound(
            problem, "Look at the frames with ros2_tf_tree, or leave guard_m out to drive unguarded."
        ) from error
    return {"translation": list(pose.translation), "rotation": list(pose.rotation)}


def header_frame(message: Mapping[str, Any]) -> str:
    """The `header.frame_id` of a message."""
    return str(cast("Mapping[str, Any]", message.get("header") or {}).get("frame_id", ""))


async def _published(
    robot: Robot, what: str, argument: str, given: str, type_name: str, usual: Sequence[str], beside: str
) -> Found:
    if given:
        topic = names.absolute(given)
        present = await robot.graph.wait_for(topic, publishers=1, timeout_s=_FIRST_S)  # it may have just appeared
        found = await robot.types.topic(present)
        if found != type_name:
            raise BadInput(f"{named(topic)} has the type {named(found)}, {argument} needs {type_name}.")
        return Found(topic, found)
    rows = await robot.graph.topics()
    topics = [row.name for row in rows if row.publishers and type_name in row.types]
    within = f"{beside.rpartition('/')[0]}/" if beside else "/"
    near = [topic for topic in topics if topic.startswith(within)]
    beside_it = next((within + name for name in usual if within + name in near), "")
    if not topics:
        raise await robot.graph.missing(
            f"No {what} was found in the graph.", f"Give it as {argument}; ros2_topic_list shows the topics."
        )
    return Found(beside_it or _only(what, argument, near or topics, usual), type_name)


def _only(what: str, argument: str, topics: Sequence[str], usual: Sequence[str]) -> str:
    """The only topic, or the only one that is called as usual."""
    for name in usual:
        called = [topic for topic in topics if topic.endswith(f"/{name}")]
        if len(called) == 1:
            return called[0]
    if len(topics) == 1:
        return topics[0]
    shown = listed(sorted(topics), _MOST_NAMED)
    raise BadInput(f"{len(topics)} topics may be the {what}: {shown}.", f"Give the right one as {argument}.")
