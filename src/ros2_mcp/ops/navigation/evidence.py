"""What was read of a robot with Nav2, for the checks that say why it does not navigate. Nothing here asks the robot."""

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
"""What Nav2's nodes are called, as launch files do; a prefix or a namespace may stand before it."""
STALE_NS = 1_500_000_000
"""What moves is told ten times a second; once a second at the slowest, and a busy machine makes pauses."""
_SUPERVISOR = re.compile(r"lifecycle_manager(_\w+)?$")
_TOOLS = re.compile(r"rosbag|record|foxglove|rviz|rqt|plotjuggler|^_ros2|ros2cli|ros2_mcp|teleop")
"""Nodes that listen to commands and carry none of them out."""

_LINE = 240
"""Characters of a line of the log: the reason often stands at its end."""

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
    """Of its check, in the chain of causes."""

    def __str__(self) -> str:
        return f"{self.cause} {self.proof}".strip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """What came on one topic while it was listened to, for `duration_s`: `messages` with their times of receipt, each
    with the number of its publisher (0: not known). `count` is how many there were; `kept` what was sent before, to
    late subscribers. `ages_s` are receipts minus stamps of those that have a header."""

    topic: str
    type: str
    nodes: Sequence[str]
    count: int = 0
    duration_s: float = 0.0
    messages: Sequence[tuple[int, Any, int]] = ()
    kept: Sequence[Any] = ()
    ages_s: Sequence[float] = ()
    frame_id: str = ""

    @property
    def newest(self) -> Any:
        """The last message, whenever it was sent; None of none."""
        return self.messages[-1][1] if self.messages else self.kept[-1] if self.kept else None

    @property
    def is_silent(self) -> bool:
        """Whether nothing came, though somebody publishes."""
        return bool(self.nodes) and not self.count

    @property
    def rate_hz(self) -> float:
        """How often it came."""
        return self.count / self.duration_s if self.duration_s else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """The tree of frames at `at_ns`, listened to for `listened_s`, and who tells its edges."""

    tree: FrameTree
    tellers: Tellers
    at_ns: int
    listened_s: float
    owners: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """The nodes that publish on /tf and on /tf_static, by topic."""
    stale_ns: int = STALE_NS

    def silent_ns(self, edge: Edge) -> int:
        """For how long nothing was told of an edge, by receipt: a stamp may lie ahead, as AMCL's does."""
        return self.at_ns - edge.last_received_ns

    def is_stale(self, edge: Edge) -> bool:
        """Whether it is told no longer."""
        period_ns = 1e9 / edge.received_hz if edge.received_hz else 0.0
        return bool(edge.moving) and self.silent_ns(edge) > max(self.stale_ns, 5 * period_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """Where it is to go: metres in the frame of the costmap, or why that is not known."""

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


class States(dict[str, str]):
    """Lifecycle states by node ("": it did not answer); `answered_s` is how long each took to answer, at best."""

    def __init__(self, states: Mapping[str, str], answered_s: Mapping[str, float]) -> None:
        super().__init__(states)
        self.answered_s = answered_s


@dataclass(frozen=True, slots=True, kw_only=True)
class NavEvidence:
    """All that was read; what was not is None, and a check that needs it is not run.

    `parameters` are by node, `states` the lifecycle states by node ("": it did not answer), `heard` what came on topics
    of velocities, sensors, odometry and poses, `log` the warnings and errors of the last minutes, the oldest first.
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
    now_ns: int = 0

    # ── who is who ───────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def nodes(self) -> Sequence[str]:
        """The nodes that are there."""
        return self.graph.nodes or ()

    def of_role(self, *roles: str) -> list[str]:
        """The nodes with one of these roles, in this order."""
        return [node for role in roles for node in self.nodes if is_of_role(node, role)]

    @property
    def supervisors(self) -> list[str]:
        """The nodes that Nav2 calls lifecycle managers; without the node of its own that each has for its services."""
        return [node for node in self.nodes if _SUPERVISOR.search(node) and not node.endswith("_service_client")]

    def managed(self, supervisor: str) -> list[str]:
        """The nodes that a manager brings up, in its order, with their full names."""
        listed = self.value(supervisor, "node_names")
        namespace = supervisor.rpartition("/")[0]
        names = cast("Sequence[object]", listed) if isinstance(listed, (list, tuple)) else ()
        return [str(name) if str(name).startswith("/") else f"{namespace}/{name}" for name in names]

    @property
    def is_nav2(self) -> bool:
        """Whether anything of Nav2 is there, or was earlier in this session."""
        known = (*self.nodes, *self.graph.left.nodes)
        return any(_SUPERVISOR.search(node) or is_of_role(node, *ROLES[:3]) for node in known)

    @property
    def robots_nodes(self) -> list[str]:
        """Nodes of Nav2 itself."""
        return [*self.supervisors, *self.of_role(*ROLES)]

    # ── asking ───────────────────────────────────────────────────────────────────────────────────────────────────

    def value(self, node: str, name: str) -> Any:
        """A parameter; None where it is not known."""
        return (self.parameters or {}).get(node, {}).get(name)

    def values(self, name: str, *roles: str) -> dict[str, Any]:
        """A parameter of all nodes with these roles, where it is set."""
        found = {node: self.value(node, name) for node in self.of_role(*roles)}
        return {node: value for node, value in found.items() if value is not None}

    def topics(self, *types: str) -> list[TopicEndpoints]:
        """The topics of these types, by name."""
        return [topic for _, topic in sorted(self.graph.topics.items()) if not set(types).isdisjoint(topic.types)]

    def topic(self, name: str) -> TopicEndpoints:
        """A topic; without endpoints where it is not there."""
        return self.graph.topics.get(name) or TopicEndpoints(name, (), ())

    def of(self, *types: str) -> list[Heard]:
        """What was heard of topics of these types."""
        return [one for one in (self.heard or {}).values() if one.type in types]

    def lines(self, pattern: str, *roles: str) -> list[LogLine]:
        """The lines of the log with that text (a regular expression), of nodes with these roles; of none: of all."""
        found = re.compile(pattern, re.IGNORECASE)
        return [
            line
            for line in self.log or ()
            if found.search(line.text) and (not roles or any(is_of_role(part, *roles) for part in _parts(line.node)))
        ]

    def is_active(self, node: str) -> bool:
        """Whether it does its work; a node without a lifecycle always does."""
        return (self.states or {}).get(node, "active") == "active"

    @property
    def goal_runs(self) -> bool:
        """Whether the navigator drives now: Nav2's own velocities come."""
        return any(
            any(is_of_role(node, "controller_server", "behavior_server") for node in one.nodes) and one.count
            for one in self.of(*VELOCITIES)
        )


def is_of_role(node: str, *roles: str) -> bool:
    """Whether a node is called so, a prefix before it or not."""
    last = node.rpartition("/")[2]
    return any(last == role or last.endswith(f"_{role}") for role in roles)


def is_tool(node: str) -> bool:
    """Whether it is a recorder, a display or the like: it listens, and carries nothing out."""
    return bool(_TOOLS.search(node.rpartition("/")[2]))


def nodes_of(endpoints: Sequence[Endpoint]) -> list[str]:
    """The names of their nodes, each once."""
    return sorted({endpoint.node for endpoint in endpoints})


def resolved(node: str, topic: str) -> str:
    """A topic as a node means it, by the namespace of the node."""
    if not topic or topic.startswith("/"):
        return topic
    return f"{node if topic.startswith('~') else node.rpartition('/')[0]}/{topic.lstrip('~/')}"


def speed_of(message: Any) -> tuple[float, float, float]:
    """Of a Twist or TwistStamped: m/s ahead and to the left, rad/s."""
    twist = getattr(message, "twist", message)
    return float(twist.linear.x), float(twist.linear.y), float(twist.angular.z)


def is_zero(message: Any) -> bool:
    """Whether a command is that to stand."""
    return not any(math.isfinite(part) and abs(part) > 1e-3 for part in speed_of(message))


def line_age_s(evidence: NavEvidence, line: LogLine) -> float | None:
    """How long ago a line of the log was said; None where its time cannot be read."""
    try:
        said = datetime.fromisoformat(line.time.replace("Z", "+00:00"))
    except ValueError:
        return None
    return max(evidence.now_ns / 1e9 - said.timestamp(), 0.0) if evidence.now_ns else None


def said(line: LogLine) -> str:
    """What a node said, within a sentence: long enough for its reason to be in it."""
    return f"{named(line.node)} said {quoted(line.text, _LINE)}"


def _parts(node: str) -> list[str]:
    return [f"/{part}" for part in node.split("/") if part]


Need = Literal["parameters", "states", "heard", "frames", "grids", "log", "diagnostics", "goal"]
"""Parts of the evidence that are read beside the graph."""
