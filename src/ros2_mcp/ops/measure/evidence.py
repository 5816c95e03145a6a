"""The data that a health check has read from a robot or a recording, as input of its checks.

Checks do not depend on whether it is live or recorded. Parts that were not read are None, and checks that need them are
skipped.
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
"""The most names in one finding."""
LARGE_TYPES = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"})
STEADY_TYPES = frozenset({"nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"})
"""Types published continuously by every publisher, whatever its QoS: ros2_control publishes them as transient_local
with Fast DDS."""
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
"""Types that sensors publish continuously. On other topics silence may be intended."""
ONCE_A_SECOND = frozenset({"tf2_msgs/msg/TFMessage", "diagnostic_msgs/msg/DiagnosticArray"})
"""Types published at 1 Hz or more: they are silent if none is received for `LEAST_LISTENED_S`."""
LEAST_LISTENED_S = 2.9
"""Three periods of a topic of 1 Hz, less the time that matching took."""
_OPTIONAL_TRANSPORT = "/compressedDepth"  # image_transport advertises it for every image, and publishes depth only

State = Literal[
    "OK", "MISSING", "SILENT", "STOPPED", "INTERRUPTED", "SLOW", "OLD STAMPS", "NOT FINITE", "QUIET", "NOT MEASURED"
]


@dataclass(frozen=True, slots=True)
class Expectations:
    """The topics, services and nodes that the caller expects, and the least rate."""

    topics: Sequence[str] = ()
    services: Sequence[str] = ()
    nodes: Sequence[str] = ()
    check_rates: bool = True
    min_rate_hz: float = 1.0


@dataclass(frozen=True, slots=True)
class TopicRow:
    """A topic that is expected, or that has a fault. `QUIET` is silence that is no fault by itself: commands, events,
    latched data.

    `SILENT`: no message was received although topics of this type are published continuously, or this one was earlier
    in this session. `from_before` is set if all messages were sent before the check began, and gives the age of the
    newest. `INTERRUPTED`: messages were received, then none for over a second and ten periods; `STOPPED` if none
    followed. `OLD STAMPS`: all stamps of a sensor differ by more than a second from the time of receipt; `age_s` is
    their mean age. `NOT FINITE`: poses, velocities or values of an IMU are NaN or infinite.
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
    """The messages received on one topic during the measurement. `replayed` counts those sent before it and kept for
    late subscribers, the newest of them `replayed_s` seconds before the end by its publisher's clock.

    `most_hz` is the highest rate compatible with the longest silence. `silence` is where a stream stopped or was
    interrupted. `finite` counts messages with values that are not finite, for types of motion. `ages` are those of the
    stamps, None if there are none of this clock. Times count from `zero_ns`; `until_ns` is the end of the search for
    silences, if not all receive times could be kept.
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
        """A note that all messages were sent before the measurement, in words; empty if there are newer messages, or no
        messages.
        """
        return "" if self.count else str(FromBefore(self.replayed, self.replayed, self.replayed_s))


@dataclass(frozen=True, slots=True)
class Ros2Control:
    """The answer of a controller manager: its controllers, and its hardware components (None if it does not list
    them).
    """

    controllers: Sequence[Mapping[str, Any]]
    hardware: Sequence[Mapping[str, Any]] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """All data read. `servers` holds the nodes of each service, `ros2_control` the answers of controller managers by
    their nodes, `robot` further faults found by `ros2_robot`, `navigation` those of `ros2_nav_check`, `rivals` the
    joint state topics with several publishers.
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
"""Parts of the evidence that are read only if a check needs them."""


def nodes_of(endpoints: Sequence[Endpoint]) -> str:
    """Return the names of the endpoints' nodes, each once."""
    return ", ".join(sorted({endpoint.node for endpoint in endpoints}))


def only(nodes: Sequence[str]) -> str:
    """Return the node's name if there is exactly one node, and its name is known; else empty. Findings with the same
    cause are combined.
    """
    return nodes[0] if len(nodes) == 1 and nodes[0].startswith("/") else ""


def streams(topic: TopicEndpoints) -> bool:
    """Return whether messages are expected continuously."""
    if STEADY_TYPES.intersection(topic.types):
        return True
    is_stream = STREAM_TYPES.intersection(topic.types) and not topic.topic.endswith(_OPTIONAL_TRANSPORT)
    return bool(is_stream) and not is_latched(topic) and not is_drawn_by_nav2(topic)


def is_latched(topic: TopicEndpoints) -> bool:
    """Return whether all publishers of a topic keep messages for late subscribers (transient_local)."""
    return bool(topic.publishers) and all(row.qos.durability == "transient_local" for row in topic.publishers)
