"""Find the command input and the odometry of a robot in its graph, and the pose of a frame on the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.space.frames import pose_in
from ros2_mcp.robot import Robot
from ros2_mcp.robot.resolution import Destination
from ros2_mcp.world.transforms import Located

DRIVEN_TYPES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""Types of command inputs that can turn in place, too. A robot that steers like a car needs its
wheel base, which no topic reports."""
ODOMETRY = "nav_msgs/msg/Odometry"
_INPUTS = ("cmd_vel",)
_ODOMETRIES = ("odometry/filtered", "odom", "odometry", "odometry/wheels")
"""The usual names of these topics, the preferred names first: robot_localization publishes fused odometry."""
_FIRST_S = 4.0
"""Time for a first message: a publisher that missed our announcement is discovered with the next announcement, 3 s
later.
"""
_MOST_NAMED = 6


@dataclass(frozen=True, slots=True)
class Found:
    """A topic with its type."""

    topic: str
    type: str

    @property
    def feed(self) -> Mapping[str, str]:
        """The topic in the form that a controller of the bridge gets."""
        return {"topic": self.topic, "type": self.type}


async def command_input(robot: Robot, given: str = "") -> Destination:
    """Return the topic for velocity commands: the given topic, or else the topic that has a subscriber.

    Raises:
        NotFound: if no topic of these types has a subscriber.
        BadInput: if there are several, or the given one is of another type.
    """
    if not given:
        rows = await robot.graph.topics()
        found = [row.name for row in rows if row.subscribers and set(row.types) & set(DRIVEN_TYPES)]
        if not found:
            raise await robot.graph.missing(
                f"No topic of type {' or '.join(DRIVEN_TYPES)} has a subscriber.",
                "Start the base's driver, or give the topic as topic_name; ros2_topic_list shows the topics.",
            )
        given = _only("command input", "topic_name", found, _INPUTS)
    destination = await robot.types.destination(given, "")
    if destination.type not in DRIVEN_TYPES:
        raise BadInput(
            f"{named(destination.topic)} has the type {named(destination.type)}: a motion needs Twist or TwistStamped.",
            "Send that type with ros2_topic_publish.",
        )
    return destination


async def odometry_of(robot: Robot, given: str = "", beside: str = "") -> Found:
    """Return the odometry topic: the given topic, or else the only topic, or the topic in the namespace of the command
    input `beside`.

    Raises:
        NotFound: if there is none.
        BadInput: if several topics may be the odometry.
    """
    return await _published(robot, "odometry", "odometry", given, ODOMETRY, _ODOMETRIES, beside)


async def first_message(robot: Robot, found: Found) -> Mapping[str, Any]:
    """Return the next message of a topic, in full. Raises `NotFound` if none arrives."""
    async with robot.listen(found.topic, found.type, max_samples=2) as listening:
        async for sample in listening.samples(_FIRST_S):
            return await robot.values.in_full(listening.type, sample.data)
    raise _nothing_from(found)


async def located_on(robot: Robot, frame: str, base_frame: str) -> Located | None:
    """Return the pose of a sensor's frame in the base's frame; None if both are the same frame.

    Raises:
        NotFound: if the transforms do not give it.
    """
    frame, base_frame = frame.lstrip("/"), base_frame.lstrip("/")
    if frame == base_frame:
        return None
    try:
        return await pose_in(Live(robot), base_frame, frame)
    except RobotError as error:
        useless = "so the sensor cannot be used to detect obstacles"
        problem = f"The position of {named(frame)} on the robot is unknown, {useless}: {error}"
        raise NotFound(
            problem, "ros2_tf_tree shows the frames. guard_m=0 drives without checking for obstacles."
        ) from error


async def base_frame_of(robot: Robot, odometry: Found) -> str:
    """Return the frame whose motion the odometry reports, `base_link` if it names none. Raises
    `NotFound` if no message arrives.
    """
    return str((await first_message(robot, odometry)).get("child_frame_id", "")) or "base_link"


async def first_decoded(robot: Robot, found: Found) -> Any:
    """Return the next message of a topic, decoded and not rendered: it may be as large as a cloud.
    Raises `NotFound` if none arrives.
    """
    async with robot.listen(found.topic, found.type, max_samples=2) as listening:
        async for sample in listening.samples(_FIRST_S):
            messages: list[Any] = await robot.values.decode_all(listening.type, [sample])
            return messages[0]
    raise _nothing_from(found)


def _nothing_from(found: Found) -> NotFound:
    return NotFound(
        f"No message on {named(found.topic)} within {_FIRST_S:g} s.", "ros2_topic_info shows who publishes."
    )


async def given_topic(robot: Robot, given: str, argument: str, types: Sequence[str]) -> Found:
    """Return the topic that an argument names. Raises `BadInput` if it has none of the types."""
    topic = names.absolute(given)
    present = await robot.graph.wait_for(topic, publishers=1, timeout_s=_FIRST_S)  # it may have just appeared
    found = await robot.types.topic(present)
    if found not in types:
        raise BadInput(f"{named(topic)} has the type {named(found)}, but {argument} needs {' or '.join(types)}.")
    return Found(topic, found)


async def _published(
    robot: Robot, what: str, argument: str, given: str, type_name: str, usual: Sequence[str], beside: str
) -> Found:
    if given:
        return await given_topic(robot, given, argument, (type_name,))
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
    """Return the only topic, or the only topic with a usual name. Raises `BadInput` if there is no such topic."""
    for name in usual:
        called = [topic for topic in topics if topic.endswith(f"/{name}")]
        if len(called) == 1:
            return called[0]
    if len(topics) == 1:
        return topics[0]
    shown = listed(sorted(topics), _MOST_NAMED)
    raise BadInput(f"{len(topics)} topics may be the {what}: {shown}.", f"Give the right one as {argument}.")
