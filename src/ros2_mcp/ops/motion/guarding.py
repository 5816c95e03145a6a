"""Find the sensors by which a drive keeps clear of obstacles, their mounts, and the robot's outline."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.errors import BadData, BadInput, NotFound, RobotError
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.motion.body import body_of
from ros2_mcp.ops.motion.find import Found, first_decoded, given_topic, located_on
from ros2_mcp.robot import Robot
from ros2_mcp.world.transforms import Located
from ros2_mcp_common.language.scans import no_bearings

DEFAULT_GUARD_M = 0.2
"""The distance that is kept free ahead of the outline by default. It leaves room to turn in place, and for the errors
of odometry and scan. Doors are passed, because only the space ahead counts."""
SCAN, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
MOST_SENSORS = 4
"""A scanner at each corner. Each costs a subscription in the bridge, and a check of each of its messages."""
_USUAL = "scan"
"""The usual name of the scan that other nodes use, if several topics are from the same scanner."""
_DERIVED = ("costmap", "clearing_endpoints", "voxel", "map")
"""Parts of the names of clouds that no sensor sent, but a planner or a mapper computed."""
WITHOUT = "guard_m=0 drives without checking for obstacles."


@dataclass(frozen=True, slots=True)
class Sight:
    """A sensor in use: its topic, and its mount on the base. `looks` is its frame and, for a scan, its first and last
    angle (rad): topics in which these are equal are the same sensor, raw, filtered or merged.
    """

    found: Found
    looks: tuple[object, ...]
    mount: Mapping[str, Sequence[float]]


@dataclass(frozen=True, slots=True)
class Guarding:
    """The sensors by which a drive keeps `guard_m` free: `asked` are the settings for its controller,
    `note` a sentence for the result.
    """

    guard_m: float
    topics: Sequence[str]
    hears: Sequence[str]
    asked: Mapping[str, Any]
    note: str


async def guarding(
    robot: Robot, base_frame: str, guard_m: float | None, given: str = "", beside: str = ""
) -> Guarding | None:
    """Find how a drive keeps clear: by the `given` topic, else by all scans of the robot, else by its clouds. Return
    None if it has neither and no distance was requested (`guard_m` is None).

    Raises:
        NotFound: if none of its sensors can guard: they send no messages, or their mounts are unknown.
        BadInput: if the given topic is neither a scan nor a cloud.
    """
    found = [await given_topic(robot, given, "scan", (SCAN, CLOUD))] if given else await candidates(robot, beside)
    if not found and guard_m is None:
        return None
    if not found:
        raise await robot.graph.missing(
            "No laser scan and no point cloud was found in the graph.",
            f"Give it as scan; ros2_topic_list shows the topics. {WITHOUT}",
        )
    looking = asyncio.gather(*(_sight(robot, one, base_frame, bool(given)) for one in found))
    body, tried = await asyncio.gather(body_of(robot, base_frame, beside), looking)
    sights = _one_of_each([one for one in tried if isinstance(one, Sight)])
    problems = [one for one in tried if isinstance(one, RobotError)]
    if not sights:
        reasons = dict.fromkeys(
            error.message.rstrip(".") for error in problems
        )  # one reason for all sensors in one frame
        raise NotFound("; ".join(reasons) + ".", WITHOUT)
    distance_m = DEFAULT_GUARD_M if guard_m is None else guard_m
    topics = [one.found.topic for one in sights]
    unused = list(dict.fromkeys(f"Not used: {error.message}" for error in problems))
    return Guarding(
        guard_m=distance_m,
        topics=topics,
        hears=[one.found.type for one in sights],
        asked={
            "guard_m": distance_m,
            "body": body.sides,
            "sensors": [{**one.found.feed, "mount": one.mount, "heights": body.heights} for one in sights],
        },
        note=" ".join(
            [f"It keeps {distance_m:g} m free ahead of its outline, by {listed(topics, 4)}.", body.known_by, *unused]
        ),
    )


async def candidates(robot: Robot, beside: str) -> Sequence[Found]:
    """Return the scans of the robot that is commanded on the topic `beside`; if it has none, its clouds."""
    rows = [row for row in await robot.graph.topics() if row.publishers]
    within = f"{beside.rpartition('/')[0]}/"
    for kind in (SCAN, CLOUD):
        all_of = [row.name for row in rows if kind in row.types]
        if kind == CLOUD:
            all_of = [topic for topic in all_of if not any(word in topic for word in _DERIVED)]
        near = [topic for topic in all_of if topic.startswith(within)] or all_of
        if near:
            usual_first = sorted(near, key=lambda topic: (topic.rpartition("/")[2] != _USUAL, len(topic), topic))
            return [Found(topic, kind) for topic in usual_first[: 2 * MOST_SENSORS]]
    return []


async def _sight(robot: Robot, found: Found, base_frame: str, is_given: bool) -> Sight | RobotError:
    """Return the sensor with its mount, or the error of a sensor that sends no messages or is not fixed to the robot.
    The error of a given topic is raised.
    """
    try:
        message = await first_decoded(robot, found)
        if found.type == SCAN and (why := no_bearings(message)):
            raise BadData(f"{named(found.topic)} has no bearings, so it cannot be used to detect obstacles: {why}.")
        frame = str(message.header.frame_id).lstrip("/")
        located = await located_on(robot, frame, base_frame)
        if located is None:
            mount: Mapping[str, Sequence[float]] = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0)}
        elif is_given or _is_carried(located):
            mount = {"translation": list(located.pose.translation), "rotation": list(located.pose.rotation)}
        else:
            return BadInput(f"{named(found.topic)} is in the frame {named(frame)}, which is not on the robot.")
    except RobotError as error:
        if is_given:
            raise
        return error
    turn = (round(message.angle_min, 2), round(message.angle_max, 2)) if found.type == SCAN else ()
    return Sight(found, (frame, *turn), mount)


def _is_carried(located: Located) -> bool:
    """Return whether the base carries a frame. It does not carry a map, although the
    map's pose in the base is known.
    """
    return all(
        edge.child == frame or not edge.moving for frame, edge in zip(located.chain, located.edges, strict=False)
    )


def _one_of_each(sights: Sequence[Sight]) -> Sequence[Sight]:
    """Return the first topic of each sensor."""
    first = {one.looks: one for one in reversed(sights)}
    return [one for one in sights if first[one.looks] is one][:MOST_SENSORS]
