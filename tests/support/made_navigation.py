"""Evidence of a robot with Nav2 as the checks of navigation judge it, made without a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from types import SimpleNamespace
from typing import Any

import numpy as np

from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.log.read import LogLine
from ros2_mcp.ops.navigation.checks import nav_findings_in
from ros2_mcp.ops.navigation.evidence import Frames, Heard, NavEvidence, NavFinding
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.tellers import Tellers
from ros2_mcp.robot import TopicEndpoints
from ros2_mcp.world.costmap import CostGrid
from ros2_mcp.world.transforms import FrameTree

TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
POSE, GRID = "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/OccupancyGrid"
NOW_NS = 1_800_000_000_000_000_000
SERVERS = ["/controller_server", "/planner_server", "/bt_navigator"]
MANAGER = "/lifecycle_manager_navigation"
CHAIN = (
    ("/cmd_vel_nav", TWIST, ["/controller_server", "/behavior_server"], ["/velocity_smoother"]),
    ("/cmd_vel_smoothed", TWIST, ["/velocity_smoother"], ["/collision_monitor"]),
    ("/cmd_vel", TWIST, ["/collision_monitor", "/docking_server"], ["/base"]),
    ("/odom", ODOMETRY, ["/base"], ["/controller_server"]),
)


def topic(name: str, kind: str, by: Sequence[str], to: Sequence[str], **qos: Any) -> TopicEndpoints:
    published, heard = QoS(**qos), QoS()

    def ends(nodes: Sequence[str], policies: QoS) -> list[Endpoint]:
        return [Endpoint(node, kind, "", node, policies) for node in nodes]

    return TopicEndpoints(name, ends(by, published), ends(to, heard))


def both(name: str, *parts: TopicEndpoints) -> TopicEndpoints:
    """One topic out of the endpoints of several."""
    return TopicEndpoints(
        name, [end for part in parts for end in part.publishers], [end for part in parts for end in part.subscribers]
    )


def found(
    *topics: TopicEndpoints,
    nodes: Sequence[str] = (),
    services: Mapping[str, Sequence[str]] | None = None,
    **parts: Any,
) -> list[NavFinding]:
    """The findings where Nav2 runs, and these topics are there."""
    named = {end.node for one in topics for end in (*one.publishers, *one.subscribers)}
    everybody = list(dict.fromkeys([*SERVERS, MANAGER, *nodes, *sorted(named)]))
    graph = GraphSnapshot({one.topic: one for one in topics}, everybody, services or {})
    return nav_findings_in(NavEvidence(graph=graph, now_ns=NOW_NS, **parts))


def told(findings: Sequence[NavFinding]) -> list[str]:
    return [str(one) for one in findings]


def made(*rows: tuple[str, str, Sequence[str], Sequence[str]]) -> list[TopicEndpoints]:
    return [topic(*row) for row in rows]


def twist(ahead: float = 0.0, turn: float = 0.0) -> Any:
    return SimpleNamespace(linear=SimpleNamespace(x=ahead, y=0.0, z=0.0), angular=SimpleNamespace(x=0.0, y=0.0, z=turn))


def odometry(ahead: float = 0.0, child: str = "base_link") -> Any:
    return SimpleNamespace(twist=SimpleNamespace(twist=twist(ahead)), child_frame_id=child)


def heard(name: str, kind: str, by: Sequence[str], messages: Sequence[Any] = (), **more: Any) -> dict[str, Heard]:
    rows = [(NOW_NS + number * 100_000_000, message, more.pop("writer", 1)) for number, message in enumerate(messages)]
    given: dict[str, Any] = {"count": len(rows), "duration_s": 2.0, **more}
    return {name: Heard(topic=name, type=kind, nodes=by, messages=rows, **given)}


def frames(*edges: tuple[str, str, float], static: Sequence[tuple[str, str]] = (), ahead_s: float = 0.0) -> Frames:
    """Edges (parent, child, seconds since it was last told), each told ten times a second until then."""
    tree = FrameTree()

    def message(parent: str, child: str, stamp_ns: int) -> Any:
        stamp = SimpleNamespace(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)
        transform = SimpleNamespace(
            translation=SimpleNamespace(x=0.0, y=0.0, z=0.0), rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        )
        one = SimpleNamespace(
            header=SimpleNamespace(stamp=stamp, frame_id=parent), child_frame_id=child, transform=transform
        )
        return SimpleNamespace(transforms=[one])

    for number, (parent, child, age_s) in enumerate(edges):
        for step in range(20, -1, -1):
            at_ns = NOW_NS - round(age_s * 1e9) - step * 100_000_000
            stamp_ns = at_ns + round(ahead_s * 1e9) if child == "odom" else at_ns
            tree.add(message(parent, child, stamp_ns), at_ns, is_static=False, sequence=number * 100_000 + 20 - step)
    for parent, child in static:
        tree.add(message(parent, child, 1), NOW_NS - 60_000_000_000, is_static=True)
    return Frames(tree=tree, tellers=Tellers(tree, {}, {}), at_ns=NOW_NS, listened_s=2.0)


WELL = frames(("map", "odom", 0.1), ("odom", "base_link", 0.05), static=[("base_link", "laser")], ahead_s=1.0)


def scan(ranges: Sequence[float], frame: str = "laser") -> Any:
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame),
        angle_min=-math.pi,
        angle_increment=2 * math.pi / len(ranges),
        angle_max=0.0,
        range_min=0.05,
        range_max=10.0,
        ranges=np.array(ranges, np.float32),
    )


def line(node: str, text: str, level: str = "ERROR", age_s: float = 5.0) -> LogLine:
    return LogLine(datetime.fromtimestamp(NOW_NS / 1e9 - age_s, timezone.utc).isoformat(), level, node, text)


def managed(
    states: Mapping[str, str], *lines: LogLine, names: Sequence[str] = SERVERS, **more: Any
) -> list[NavFinding]:
    parameters = {MANAGER: {"node_names": [name.strip("/") for name in names], **more.pop("of_supervisor", {})}}
    return found(states=states, parameters={**parameters, **more.pop("parameters", {})}, log=list(lines), **more)


ACTIVE = dict.fromkeys(SERVERS, "active")


def parts_of(tree: Frames, flows: Mapping[str, Heard] = {}, **parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {"frames": tree, "heard": flows, "parameters": {f"/{name}": each for name, each in parameters.items()}}


SCANS = heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 5, frame_id="laser")
ODOMS = heard("/odom", ODOMETRY, ["/base"], [odometry()] * 20, frame_id="odom")
READ = (
    topic("/scan", SCAN, ["/lidar"], ["/local_costmap/local_costmap", "/amcl"]),
    topic("/odom", ODOMETRY, ["/base"], []),
)


def grid(cells: Any, corner: tuple[float, float] = (-2.0, -2.0)) -> CostGrid:
    x, y = corner
    origin = SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.0), orientation=SimpleNamespace(x=0, y=0, z=0, w=1))
    info = SimpleNamespace(width=cells.shape[1], height=cells.shape[0], resolution=0.1, origin=origin)
    return CostGrid(SimpleNamespace(header=SimpleNamespace(frame_id="map"), info=info, data=cells.ravel()))


def room() -> CostGrid:
    cells = np.zeros((40, 40), np.int8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 100, 100, 100, 100
    return grid(cells)


def in_room(beams: int = 120) -> list[float]:
    """Ranges from the middle of the room."""
    angles = [-math.pi + number * 2 * math.pi / beams for number in range(beams)]
    return [1.95 / max(abs(math.cos(angle)), abs(math.sin(angle))) for angle in angles]
