"""The evidence for the checks that find out why a robot with Nav2 does not navigate. This module reads nothing
itself."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal, cast

from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.log.read import LogLine
from ros2_mcp.ops.measure.diagnostics import Diagnostic
from ros2_mcp.ops.results.results import HIDDEN
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.robot import TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.ops.space.tellers import Tellers
    from ros2_mcp.world.costmap import CostGrid
    from ros2_mcp.world.frame_edges import Edge
    from ros2_mcp.world.transforms import FrameTree

VELOCITIES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
SCAN, CLOUD, ODOMETRY = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
POSE, GRID = "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/OccupancyGrid"
SENSORS = (SCAN, CLOUD, "sensor_msgs/msg/Range")
ROLES = (
    *("bt_navigator", "planner_server", "controller_server", "smoother_server", "behavior_server", "route_server"),
    *("velocity_smoother", "collision_monitor", "waypoint_follower", "docking_server", "map_server", "amcl"),
    *("local_costmap", "global_costmap", "slam_toolbox"),
)
"""Names of Nav2's nodes as launch files set them; a prefix or a namespace may precede them."""
STALE_NS = 1_500_000_000
"""Moving transforms are published about ten times a second, at the slowest once; on a busy machine there are pauses."""
_SUPERVISOR = re.compile(r"lifecycle_manager(_\w+)?$")
_TOOLS = re.compile(r"rosbag|record|foxglove|rviz|rqt|plotjuggler|^_ros2|ros2cli|ros2_mcp|teleop")
"""Nodes that subscribe to commands without carrying them out."""

_LINE = 240
"""Characters of a line of the log: its reason is often at the end."""

Rank = Literal["stops everything", "stops some goals", "makes it worse"]
RANKS: Sequence[Rank] = ("stops everything", "stops some goals", "makes it worse")


@dataclass(frozen=True, slots=True, kw_only=True)
class NavFinding:
    """Why the robot does not navigate, or not well: the cause, what proves it, in numbers, and what to do.

    `subject` is the node, topic or transform it is found at. `covers` are subjects of what only follows from it.
    """

    rank: Rank
    subject: str
    cause: str
    proof: str
    remedy: str
    covers: Sequence[str] = field(default=(), metadata=HIDDEN)
    place: int = field(default=0, metadata=HIDDEN)
    """Place of its check in the chain of causes."""

    def __str__(self) -> str:
        return f"{self.cause} {self.proof}".strip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """The messages received on one topic during `duration_s`.

    `messages` are (time of receipt in ns, message, number of the publisher; 0 if unknown); of scans and poses only the
    first and last ones may be decoded. `count` is the number received. `kept` are messages that were sent before the
    subscription, to late subscribers. `ages_s` are receipt minus stamp for messages with a header. `longest_gap_s` is
    the longest time without a message.
    """

    topic: str
    type: str
    nodes: Sequence[str]
    count: int = 0
    duration_s: float = 0.0
    messages: Sequence[tuple[int, Any, int]] = ()
    kept: Sequence[Any] = ()
    ages_s: Sequence[float] = ()
    frame_id: str = ""
    longest_gap_s: float = 0.0

    @property
    def newest(self) -> Any:
        """The last message, even if it was sent before the subscription; None without messages."""
        return self.messages[-1][1] if self.messages else self.kept[-1] if self.kept else None

    @property
    def is_silent(self) -> bool:
        """Whether the topic has publishers but no message was received."""
        return bool(self.nodes) and not self.count

    @property
    def rate_hz(self) -> float:
        """Average rate of the messages in Hz."""
        return self.count / self.duration_s if self.duration_s else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """The tree of frames at `at_ns`, after `listened_s` of listening, and the publishers of its edges."""

    tree: FrameTree
    tellers: Tellers
    at_ns: int
    listened_s: float
    owners: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """The nodes that publish on /tf and on /tf_static, by topic."""
    stale_ns: int = STALE_NS

    def silent_ns(self, edge: Edge) -> int:
        """Time since the last message about an edge, by receipt: a stamp may lie in the future, as AMCL's does."""
        return self.at_ns - edge.last_received_ns

    def is_stale(self, edge: Edge) -> bool:
        """Whether a moving edge is no longer published."""
        period_ns = 1e9 / edge.received_hz if edge.received_hz else 0.0
        return bool(edge.moving) and self.silent_ns(edge) > max(self.stale_ns, 5 * period_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """The goal in the frame of the costmap, in m; `why_not` says why it could not be transformed."""

    x_m: float
    y_m: float
    why_not: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grids:
    """The map, as it was published (None: nothing came), and the global costmap with its topic.

    `maps` are the different ones, where several nodes publish on the topic of the map.
    """

    map: CostGrid | None = None
    map_topic: str = ""
    maps: Sequence[CostGrid] = ()
    costs: CostGrid | None = None
    costs_topic: str = ""


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion from one pose to another, in the frame of the first: m ahead, m to the left, rad to the left."""

    ahead_m: float
    left_m: float
    turned_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Probe:
    """A small motion as each witness saw it, by topic: `commanded` m ahead, or, if it `is_turn`, rad to the left.

    `odometry` and `laser` (scans before and after, in the base's frame) have whole motions, `gyro` what was turned, in
    rad about the base's z axis.
    """

    is_turn: bool
    commanded: float
    odometry: Mapping[str, Motion]
    laser: Mapping[str, Motion]
    gyro: Mapping[str, float]


class States(dict[str, str]):
    """Lifecycle states by node ("": no answer); `answered_s` is the shortest time that each node took to answer."""

    def __init__(self, states: Mapping[str, str], answered_s: Mapping[str, float]) -> None:
        super().__init__(states)
        self.answered_s = answered_s


@dataclass(frozen=True, slots=True, kw_only=True)
class NavEvidence:
    """All evidence that was read. A part that was not read is None, and checks that need it are not run.

    `parameters` are by node, `states` lifecycle states by node ("": no answer), `heard` the messages on topics of
    velocities, sensors, odometry and poses, `log` the warnings and errors of the last minutes, the oldest first.
    """

    graph: GraphSnapshot
    parameters: Mapping[str, Mapping[str, Any]] | None = None
    states: Mapping[str, str] | None = None
    heard: Mapping[str, Heard] | None = None
    frames: Frames | None = None
    grids: Grids | None = None
    log: Sequence[LogLine] | None = None
    diagnostics: Sequence[Diagnostic] | None = None
    goal: Goal | None = None
    probes: Sequence[Probe] | None = None
    now_ns: int = 0

    # ── who is who ───────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def nodes(self) -> Sequence[str]:
        """The nodes in the graph."""
        return self.graph.nodes or ()

    def of_role(self, *roles: str) -> list[str]:
        """Return the nodes with one of these roles, in the order of the roles."""
        return [node for role in roles for node in self.nodes if is_of_role(node, role)]

    @property
    def supervisors(self) -> list[str]:
        """Nav2's lifecycle managers, without the second node that each creates for its service clients."""
        return [node for node in self.nodes if _SUPERVISOR.search(node) and not node.endswith("_service_client")]

    def managed(self, supervisor: str) -> list[str]:
        """Return the full names of the nodes that a lifecycle manager brings up, in its order."""
        listed = self.value(supervisor, "node_names")
        namespace = supervisor.rpartition("/")[0]
        names = cast("Sequence[object]", listed) if isinstance(listed, (list, tuple)) else ()
        return [str(name) if str(name).startswith("/") else f"{namespace}/{name}" for name in names]

    @property
    def is_nav2(self) -> bool:
        """Whether a node of Nav2 is in the graph, or was earlier in this session."""
        known = (*self.nodes, *self.graph.left.nodes)
        return any(_SUPERVISOR.search(node) or is_of_role(node, *ROLES[:3]) for node in known)

    @property
    def robots_nodes(self) -> list[str]:
        """All nodes of Nav2."""
        return [*self.supervisors, *self.of_role(*ROLES)]

    # ── asking ───────────────────────────────────────────────────────────────────────────────────────────────────

    def value(self, node: str, name: str) -> Any:
        """Return a parameter of a node; None if it is not known."""
        return (self.parameters or {}).get(node, {}).get(name)

    def values(self, name: str, *roles: str) -> dict[str, Any]:
        """Return a parameter of all nodes with these roles, by node, where it is known."""
        found = {node: self.value(node, name) for node in self.of_role(*roles)}
        return {node: value for node, value in found.items() if value is not None}

    def topics(self, *types: str) -> list[TopicEndpoints]:
        """Return the topics of these types, sorted by name."""
        return [topic for _, topic in sorted(self.graph.topics.items()) if not set(types).isdisjoint(topic.types)]

    def topic(self, name: str) -> TopicEndpoints:
        """Return a topic by name; a topic without endpoints if it does not exist."""
        return self.graph.topics.get(name) or TopicEndpoints(name, (), ())

    def of(self, *types: str) -> list[Heard]:
        """Return what was received on topics of these types."""
        return [one for one in (self.heard or {}).values() if one.type in types]

    def lines(self, pattern: str, *roles: str) -> list[LogLine]:
        """Return the log lines that match a regular expression, from nodes with these roles (without roles: from all
        nodes)."""
        found = re.compile(pattern, re.IGNORECASE)
        return [
            line
            for line in self.log or ()
            if found.search(line.text) and (not roles or any(is_of_role(part, *roles) for part in _parts(line.node)))
        ]

    def is_active(self, node: str) -> bool:
        """Whether a node is active; a node without a lifecycle always is."""
        return (self.states or {}).get(node, "active") == "active"

    @property
    def goal_runs(self) -> bool:
        """Whether a goal is running now: Nav2's controller or behaviour server publishes velocities."""
        return any(
            any(is_of_role(node, "controller_server", "behavior_server") for node in one.nodes) and one.count
            for one in self.of(*VELOCITIES)
        )


def is_of_role(node: str, *roles: str) -> bool:
    """Whether a node has the name of a role, possibly with a prefix."""
    last = node.rpartition("/")[2]
    return any(last == role or last.endswith(f"_{role}") for role in roles)


def is_tool(node: str) -> bool:
    """Whether a node is a recorder, a display or the like: it subscribes, but carries out no commands."""
    return bool(_TOOLS.search(node.rpartition("/")[2]))


def nodes_of(endpoints: Sequence[Endpoint]) -> list[str]:
    """Return the nodes of these endpoints, sorted and without duplicates."""
    return sorted({endpoint.node for endpoint in endpoints})


def resolved(node: str, topic: str) -> str:
    """Return the full name of a topic in a node's namespace."""
    if not topic or topic.startswith("/"):
        return topic
    return f"{node if topic.startswith('~') else node.rpartition('/')[0]}/{topic.lstrip('~/')}"


def speed_of(message: Any) -> tuple[float, float, float]:
    """Return the speeds of a Twist or TwistStamped: m/s ahead, m/s to the left, rad/s."""
    twist = getattr(message, "twist", message)
    return float(twist.linear.x), float(twist.linear.y), float(twist.angular.z)


def is_zero(message: Any) -> bool:
    """Whether a command is the zero."""
    return not any(math.isfinite(part) and abs(part) > 1e-3 for part in speed_of(message))


def line_age_s(evidence: NavEvidence, line: LogLine) -> float | None:
    """Return the age of a log line in s; None if its time cannot be read."""
    try:
        said = datetime.fromisoformat(line.time.replace("Z", "+00:00"))
    except ValueError:
        return None
    return max(evidence.now_ns / 1e9 - said.timestamp(), 0.0) if evidence.now_ns else None


def said(line: LogLine) -> str:
    """Return what a node logged as part of a sentence, long enough to contain the reason."""
    return f"{named(line.node)} said {quoted(line.text, _LINE)}"


def _parts(node: str) -> list[str]:
    return [f"/{part}" for part in node.split("/") if part]


Need = Literal["parameters", "states", "heard", "frames", "grids", "log", "diagnostics", "goal", "probes"]
"""The parts of the evidence that are read in addition to the graph."""
