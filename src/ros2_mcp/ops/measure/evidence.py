"""What a health check has read of a robot or a recording, for the checks that judge it.

Nothing here asks whether it is live or recorded. What was not read is None, and a check that needs it is not run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from ros2_mcp.model.nav2 import is_drawn_by_nav2
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.ops.measure.diagnostics import DiagnosticTable
from ros2_mcp.ops.measure.flow import Silence
from ros2_mcp.ops.nodes.lifecycle import LifecycleState
from ros2_mcp.ops.nodes.parameters import Parameter
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.ops.sources.source import GraphSnapshot, Missing
from ros2_mcp.ops.space.tf_tree import FrameProblem
from ros2_mcp.robot import TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.finite import Finite
    from ros2_mcp.ops.measure.rivals import Rivals
    from ros2_mcp.ops.navigation.evidence import NavFinding
    from ros2_mcp.ops.topics.arrivals import Ages

MAX_NAMES = 30
"""Names in one finding."""
LARGE_TYPES = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"})
STEADY_TYPES = frozenset({"nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"})
"""Types that stream as long as their publisher lives, whatever its QoS: what ros2_control publishes is
transient_local under Fast DDS, and no less a stream."""
STREAM_TYPES = (
    LARGE_TYPES
    | STEADY_TYPES
    | {
        "sensor_msgs/msg/CameraInfo",
        "sensor_msgs/msg/Imu",
        "sensor_msgs/msg/LaserScan",
        "sensor_msgs/msg/MagneticField",
        "sensor_msgs/msg/MultiEchoLaserScan",
        "sensor_msgs/msg/PointCloud",
        "sensor_msgs/msg/Range",
    }
)
"""Types of sensors that stream as long as they live. On any other topic silence may be intended."""
ONCE_A_SECOND = frozenset({"tf2_msgs/msg/TFMessage", "diagnostic_msgs/msg/DiagnosticArray"})
"""Types that come once a second at the slowest: their silence is one after `LEAST_LISTENED_S`."""
LEAST_LISTENED_S = 2.9
"""Three periods of what comes once a second, but for the time that matching took."""
_OPTIONAL_TRANSPORT = "/compressedDepth"  # image_transport offers it for every image, and sends it for depth only

State = Literal[
    "OK", "MISSING", "SILENT", "STOPPED", "INTERRUPTED", "SLOW", "OLD STAMPS", "NOT FINITE", "QUIET", "NOT MEASURED"
]


@dataclass(frozen=True, slots=True)
class Expectations:
    """What the caller expects to be there, and how fast."""

    topics: Sequence[str] = ()
    services: Sequence[str] = ()
    nodes: Sequence[str] = ()
    check_rates: bool = True
    min_rate_hz: float = 1.0


@dataclass(frozen=True, slots=True)
class TopicRow:
    """A topic that is expected, or not as it should be. `QUIET` is silence that is no fault by itself: of commands,
    events, latched data.

    `SILENT`: nothing came, though what has its type is published steadily, or it was, earlier in this session.
    `from_before` says that there is only what was sent before the check began, and how old the newest of it is.
    `INTERRUPTED`: messages came, then none for over a second and ten periods; `STOPPED` if none came after that.
    `OLD STAMPS`: all stamps of a sensor are more than a second from the time of receipt. `age_s` is their mean age.
    `NOT FINITE`: poses, velocities or an IMU's values are NaN or infinite.
    """

    topic_name: str
    topic_type: str
    publishers: int
    subscribers: int
    state: State
    rate_hz: float | None
    age_s: float | None
    expected: bool
    from_before: str = ""


@dataclass(frozen=True, slots=True)
class Flow:
    """What came on one topic in the time of measuring, and how many messages were `replayed`: sent before it, and kept
    for late subscribers, the newest of them `replayed_s` before the end by its publisher's clock.

    `most_hz` is the highest rate that its silences allow. `silence` is where a stream stopped or was interrupted.
    `finite` counts the messages whose values are not, of types of motion.
    `ages` are those of its stamps, None where it has none of this clock. Times count from `zero_ns`; `until_ns`
    is up to when silences were looked for, where the times of all messages were too many to keep.
    """

    count: int
    rate_hz: float | None
    most_hz: float
    silence: Silence | None = None
    ages: Ages | None = None
    finite: Finite | None = None
    zero_ns: int = 0
    until_ns: int = 0
    replayed: int = 0
    replayed_s: float | None = None
    duration_s: float = 0.0

    @property
    def from_before(self) -> str:
        """In words, that there is nothing but what was sent before; empty where there is more, or nothing at all."""
        return "" if self.count else str(FromBefore(self.replayed, self.replayed, self.replayed_s))


@dataclass(frozen=True, slots=True)
class Ros2Control:
    """What a controller manager says: its controllers, and its hardware components (None where it does not tell)."""

    controllers: Sequence[Mapping[str, Any]]
    hardware: Sequence[Mapping[str, Any]] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """All that was read. `servers` has the nodes of each service, `ros2_control` what controller managers say, by their
    nodes, `robot` what else `ros2_robot` finds, `navigation` what `ros2_nav_check` does, `rivals` the topics of joint
    states that several publish.
    """

    graph: GraphSnapshot
    expected: Expectations
    is_live: bool
    source_title: str = ""
    rows: Sequence[TopicRow] = ()
    flows: Mapping[str, Flow] = field(default_factory=dict[str, Flow])
    not_measured: Sequence[Missing] = ()
    diagnostics: DiagnosticTable = field(default_factory=DiagnosticTable)
    rivals: Mapping[str, Rivals] = field(default_factory=dict[str, "Rivals"])
    hung: Sequence[str] = ()
    frames: Sequence[FrameProblem] | None = None
    lifecycle: Sequence[LifecycleState] | None = None
    ros2_control: Mapping[str, Ros2Control] | None = None
    parameters: Mapping[str, Sequence[Parameter]] | None = None
    servers: Mapping[str, Sequence[str]] | None = None
    robot: Sequence[str] | None = None
    navigation: Sequence[NavFinding] | None = None


Need = Literal["frames", "lifecycle", "ros2_control", "parameters", "servers", "robot", "navigation"]
"""Parts of the evidence that are read only where a check asks for them."""


def nodes_of(endpoints: Sequence[Endpoint]) -> str:
    """The names of their nodes, each once."""
    return ", ".join(sorted({endpoint.node for endpoint in endpoints}))


def only(nodes: Sequence[str]) -> str:
    """The one node, if it is one and has a name: what it may be the cause of is one finding."""
    return nodes[0] if len(nodes) == 1 and nodes[0].startswith("/") else ""


def streams(topic: TopicEndpoints) -> bool:
    """Whether messages are to come all the time."""
    if STEADY_TYPES.intersection(topic.types):
        return True
    is_stream = STREAM_TYPES.intersection(topic.types) and not topic.topic.endswith(_OPTIONAL_TRANSPORT)
    return bool(is_stream) and not is_latched(topic) and not is_drawn_by_nav2(topic)


def is_latched(topic: TopicEndpoints) -> bool:
    """Whether what is published is kept for late subscribers, by all publishers."""
    return bool(topic.publishers) and all(row.qos.durability == "transient_local" for row in topic.publishers)
