"""A recording of the simulated robot's room, made without ROS: the robot drives from (0, 0) towards (2, 1.3)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp_demo.world import ROOM, World
from support.made_windows import encoded

START_NS = 1_700_000_000_000_000_000
LENGTH_S = 6.0
RATE_HZ = 10
GOAL = (2.0, 1.3)
SPEED = 0.3
"""Metres a second."""
LASER_FORWARD_M = 0.2
"""Where the scanner is mounted on the base."""
ODOM_IN_MAP = (0.4, -0.3, 0.2)
"""x, y and yaw: odometry has drifted."""
BEAMS = 360
RESOLUTION_M = 0.05
TYPES = {
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/global_costmap/costmap": "nav_msgs/msg/OccupancyGrid",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/plan": "nav_msgs/msg/Path",
    "/goal_pose": "geometry_msgs/msg/PoseStamped",
    "/footprint": "geometry_msgs/msg/PolygonStamped",
    "/odom": "nav_msgs/msg/Odometry",
}
LATCHED = {"/map", "/tf_static"}
HALF_LENGTH_M, HALF_WIDTH_M = 0.25, 0.15
"""Of the footprint."""


@dataclass(frozen=True)
class Pose2:
    """A pose in the plane, in metres and radians."""

    x: float
    y: float
    yaw: float

    def then(self, other: Pose2) -> Pose2:
        """`other`, given in this pose's coordinates, in those of this pose's frame."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + cos * other.x - sin * other.y, self.y + sin * other.x + cos * other.y, self.yaw + other.yaw
        )

    def inverse(self) -> Pose2:
        """The pose of this pose's frame in the coordinates of this pose."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.yaw)


def pose_at(seconds: float) -> Pose2:
    """Where the robot truly is in the map, so long after the beginning."""
    heading = math.atan2(GOAL[1], GOAL[0])
    return Pose2(SPEED * seconds * math.cos(heading), SPEED * seconds * math.sin(heading), heading)


def _stamp(at_ns: int) -> dict[str, int]:
    return {"sec": at_ns // 10**9, "nanosec": at_ns % 10**9}


def _turn(yaw: float) -> dict[str, float]:
    return {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


def _transform(header: dict[str, Any], child: str, pose: Pose2, z: float = 0.0) -> dict[str, Any]:
    place = {"translation": {"x": pose.x, "y": pose.y, "z": z}, "rotation": _turn(pose.yaw)}
    return {"header": header, "child_frame_id": child, "transform": place}


def _grid(header: dict[str, Any], costs: bool) -> dict[str, Any]:
    world = World()
    cells, (x, y) = world.occupancy(RESOLUTION_M)
    if costs:  # as Nav2 publishes them: 100 lethal, 99 inscribed, less further away
        rows, columns = cells.shape
        at_x = x + (np.arange(columns) + 0.5) * RESOLUTION_M
        at_y = (y + (np.arange(rows) + 0.5) * RESOLUTION_M)[:, np.newaxis]
        x_min, y_min, x_max, y_max = ROOM
        to_room = np.minimum(np.minimum(at_x - x_min, x_max - at_x), np.minimum(at_y - y_min, y_max - at_y))
        away = np.min([to_room, *(solid.distance(at_x, at_y) for solid in world.mapped)], axis=0)
        far = np.clip(98 * np.exp(-4 * (away - 0.2)), 0, 98).astype(np.int8)
        cells = np.where(cells == -1, -1, np.where(cells == 100, 100, np.where(away < 0.2, 99, far))).astype(np.int8)
    info = {
        "resolution": RESOLUTION_M,
        "width": cells.shape[1],
        "height": cells.shape[0],
        "origin": {"position": {"x": x, "y": y}},
    }
    return {"header": header, "info": info, "data": cells.ravel().tolist()}


def _scan(header: dict[str, Any], pose: Pose2) -> dict[str, Any]:
    laser = pose.then(Pose2(LASER_FORWARD_M, 0, 0))
    angles = -math.pi + np.arange(BEAMS) * 2 * math.pi / BEAMS
    ranges = World().cast(laser.x, laser.y, laser.yaw + angles)
    return {
        "header": {**header, "frame_id": "laser"},
        "angle_min": -math.pi,
        "angle_max": math.pi,
        "angle_increment": 2 * math.pi / BEAMS,
        "range_min": 0.12,
        "range_max": 5.0,
        "ranges": [float(one) if one <= 5.0 else "inf" for one in ranges],
    }


def messages(costs: bool) -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Topic, time and value."""

    def header(frame: str, at_ns: int) -> dict[str, Any]:
        return {"stamp": _stamp(at_ns), "frame_id": frame}

    yield "/map", START_NS, _grid(header("map", START_NS), costs=False)
    if costs:
        yield "/global_costmap/costmap", START_NS, _grid(header("map", START_NS), costs=True)
    mount = _transform(header("base_link", START_NS), "laser", Pose2(LASER_FORWARD_M, 0, 0), z=0.2)
    yield "/tf_static", START_NS, {"transforms": [mount]}
    drift = Pose2(*ODOM_IN_MAP)
    for number in range(round(LENGTH_S * RATE_HZ)):
        at_ns = START_NS + number * 1_000_000_000 // RATE_HZ
        pose = pose_at(number / RATE_HZ)
        in_odom = drift.inverse().then(pose)
        moving = [
            _transform(header("map", at_ns), "odom", drift),
            _transform(header("odom", at_ns), "base_link", in_odom),
        ]
        yield "/tf", at_ns, {"transforms": moving}
        place = {"position": {"x": in_odom.x, "y": in_odom.y}, "orientation": _turn(in_odom.yaw)}
        yield "/odom", at_ns, {"header": header("odom", at_ns), "child_frame_id": "base_link", "pose": {"pose": place}}
        if number % 2 == 0:
            yield "/scan", at_ns, _scan(header("laser", at_ns), pose)
            corners = [(HALF_LENGTH_M, HALF_WIDTH_M), (HALF_LENGTH_M, -HALF_WIDTH_M)]
            corners += [(-x, -y) for x, y in corners]
            points = [{"x": x, "y": y} for x, y in corners]
            yield "/footprint", at_ns, {"header": header("base_link", at_ns), "polygon": {"points": points}}
        if number == RATE_HZ:  # a goal comes one second in
            goal = {"position": {"x": GOAL[0], "y": GOAL[1]}, "orientation": _turn(pose.yaw)}
            yield "/goal_pose", at_ns, {"header": header("map", at_ns), "pose": goal}
            ends = [{"header": header("map", at_ns), "pose": {"position": {"x": x, "y": y}}} for x, y in ((0, 0), GOAL)]
            yield "/plan", at_ns, {"header": header("map", at_ns), "poses": ends}


def room_bag(folder: Path, *, costs: bool = False, without: frozenset[str] = frozenset()) -> Path:
    """Writes the recording; with a costmap if asked for, without these topics."""
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    latched = qos_text([QoS(durability="transient_local")])
    given = {topic for topic in TYPES if topic not in without and (costs or "costmap" not in topic)}
    for topic in sorted(given):
        writer.add_topic(StoredTopic(topic, TYPES[topic], None, "", "", latched if topic in LATCHED else ""))
    for number, (topic, at_ns, value) in enumerate(messages(costs), 1):
        if topic in given:
            writer.write(topic, Sample(at_ns, at_ns, number, encoded(TYPES[topic], value)))
    writer.close()
    return folder
