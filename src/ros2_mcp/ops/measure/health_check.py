"""Health of a robot: what should be there and is not, what is silent or slow, what cannot match, what diagnostics say.

The parts that judge are pure functions on what a source knows; nothing here asks whether it is live or recorded.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.measure.diagnostics import DIAGNOSTICS, Diagnostic, DiagnosticTable
from ros2_mcp.ops.measure.flow import Silence, periods_s, rate_hz, silence_in
from ros2_mcp.ops.results import Report, iso_time, silent
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Capture, GraphSnapshot, Missing, Source, Stream
from ros2_mcp.ops.topics.info import mismatches
from ros2_mcp.robot import TopicEndpoints
from ros2_mcp_bridge.limits import MAX_RATE_HZ

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.columns import Arrivals

# Topics that are listened to, and of those images and clouds: a check must not overload a weak robot.
MAX_MEASURED = 60
MAX_LARGE = 4
# Entries of the result's lists, the worst first, so that the report on a very broken robot fits into a result, too.
MAX_ROWS = 60
MAX_FINDINGS = 40
MAX_STATUSES = 30
MAX_NAMES = 30
# Names in the note: which topics were not measured, and which could not be.
_MAX_SKIPPED = 8
_MAX_FAILED = 5
# A topic is slow below this share of the rate that is expected of it: a few seconds are not whole periods.
RATE_TOLERANCE = 0.9
# A stream is interrupted if nothing came for this many of its median periods, and for this long.
STOPPED_PERIODS = 10
STOPPED_S = 1.0

LARGE_TYPES = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"})
# Types of sensors that stream as long as they live. On any other topic silence may be intended.
STREAM_TYPES = LARGE_TYPES | {
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/MagneticField",
    "sensor_msgs/msg/MultiEchoLaserScan",
    "sensor_msgs/msg/PointCloud",
    "sensor_msgs/msg/Range",
    "nav_msgs/msg/Odometry",
}
_OPTIONAL_TRANSPORT = "/compressedDepth"  # image_transport offers it for every image, and sends it for depth only
_DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"

Severity = Literal["critical", "warning"]
Verdict = Literal["HEALTHY", "DEGRADED", "CRITICAL"]
State = Literal["OK", "MISSING", "SILENT", "STOPPED", "INTERRUPTED", "SLOW", "QUIET", "NOT MEASURED"]


@dataclass(frozen=True, slots=True)
class Expectations:
    """What the caller expects to be there, and how fast."""

    topics: Sequence[str] = ()
    services: Sequence[str] = ()
    nodes: Sequence[str] = ()
    check_rates: bool = True
    min_rate_hz: float = 1.0


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is wrong, and what to do about it."""

    severity: Severity
    subject: str
    problem: str
    recommendation: str


@dataclass(frozen=True, slots=True)
class TopicRow:
    """A topic in the table. `QUIET` is silence that is no fault by itself: of commands, events, latched data.

    `INTERRUPTED`: messages came, then none for over a second and ten periods; `STOPPED` if none came after that.
    """

    topic_name: str
    topic_type: str
    publishers: int
    subscribers: int
    state: State
    rate_hz: float | None
    expected: bool


@dataclass(frozen=True, slots=True)
class Health:
    """A report on the robot.

    `CRITICAL`: something expected is missing or silent, or diagnostics report an error. `DEGRADED`: a sensor is silent,
    has stopped, was interrupted or is slow, endpoints cannot match, nodes share a name, or diagnostics warn; of a
    recording also if they reported something that was over before its end. Topics that nobody listens to, or nobody
    publishes on, are listed but are no fault by themselves. A `rate_hz` of null: fewer than two messages came.
    `counts` says how many there are where a list is cut; the worst come first.
    """

    verdict: Verdict
    findings: Sequence[Finding]
    topics: Sequence[TopicRow]
    diagnostics: Sequence[Diagnostic]
    publishers_without_subscribers: Sequence[str]
    subscribers_without_publishers: Sequence[str]
    counts: Mapping[str, int]
    source: str
    note: str

    def summary(self) -> list[str]:
        """The verdict, and a line for each finding."""
        lines = [f"{row.severity}: {named(row.subject)}: {row.problem} {row.recommendation}" for row in self.findings]
        return [f"{self.verdict}. {self.note}".rstrip(), *lines]


@dataclass(frozen=True, slots=True)
class Flow:
    """What came on one topic in the time of measuring.

    `most_hz` is the highest rate that its silences allow. `silence` is where a stream stopped or was interrupted.
    `until_ns` is up to when that was looked for, where the times of all messages were too many to keep.
    """

    count: int
    rate_hz: float | None
    most_hz: float
    silence: Silence | None = None
    until_ns: int = 0


async def check_health(source: Source, expected: Expectations, report: Report = silent) -> Health:
    """Looks at the graph, listens to topics and to diagnostics at the same time, and judges.

    Raises:
        BadName: for an expected name that ROS does not allow.
        BadValue: if a number is out of range.
    """
    bounded("min_expected_rate_hz", expected.min_rate_hz, 0.0, MAX_RATE_HZ, "Hz")
    expected = replace(
        expected,
        topics=[names.absolute(name) for name in expected.topics],
        services=[names.absolute(name, "service") for name in expected.services],
        nodes=[names.absolute(name, "node") for name in expected.nodes],
    )
    graph = await source.graph()
    chosen, skipped = to_measure(graph, expected) if expected.check_rates else ([], [])
    has_diagnostics = DIAGNOSTICS in graph.topics and bool(graph.topics[DIAGNOSTICS].publishers)
    from ros2_mcp.ops.measure.columns import Arrivals, Room

    room = Room()
    measured, reported = await asyncio.gather(
        source.captures(chosen, lambda _: Arrivals(room), report, times_only=True),
        source.captures([DIAGNOSTICS] if has_diagnostics else [], _Statuses),
    )
    if any(_missing(graph, expected)):  # it may only just have appeared
        graph = await source.graph()
    diagnostics, trouble = DiagnosticTable(), ""
    for capture in reported:
        if isinstance(capture, Capture):
            diagnostics, trouble = capture.kept.table, capture.kept.trouble
    flows = {capture.topic: flow(capture) for capture in measured if isinstance(capture, Capture)}
    failed = [missing for missing in measured if isinstance(missing, Missing)]
    rows = [_row(graph, name, flows.get(name), expected) for name in sorted({*graph.topics, *expected.topics})]
    findings = [
        *_missing(graph, expected),
        *(finding for row in rows for finding in _flow_finding(graph, row, flows.get(row.topic_name), expected)),
        *_graph_findings(graph),
        *_diagnostic_findings(diagnostics, with_past=not source.is_live),
    ]
    findings.sort(key=lambda finding: finding.severity)  # critical before warning
    visible = [row for row in rows if not names.is_hidden(row.topic_name) and row.topic_name not in OF_EVERY_NODE]
    visible.sort(key=lambda row: (row.state in ("OK", "QUIET", "NOT MEASURED"), not row.expected))
    # a recording knows who published, and neither nodes nor subscribers
    without_subscribers = [row.topic_name for row in visible if graph.nodes and row.publishers and not row.subscribers]
    without_publishers = [row.topic_name for row in visible if row.subscribers and not row.publishers]
    return Health(
        verdict="HEALTHY" if not findings else "CRITICAL" if findings[0].severity == "critical" else "DEGRADED",
        findings=findings[:MAX_FINDINGS],
        topics=visible[:MAX_ROWS],
        diagnostics=[replace(row, values={}) if row.level == "OK" else row for row in diagnostics.rows[:MAX_STATUSES]],
        publishers_without_subscribers=without_subscribers[:MAX_NAMES],
        subscribers_without_publishers=without_publishers[:MAX_NAMES],
        counts={
            "topics": len(graph.topics),
            "nodes": len(graph.nodes or ()),
            "services": len(graph.services or ()),
            "measured": len(flows),
            "findings": len(findings),
            "diagnostics": len(diagnostics.rows),
        },
        source=source.words,
        note=" ".join(filter(None, (_note(graph, skipped, failed), trouble, _bounds(flows)))),
    )


def to_measure(graph: GraphSnapshot, expected: Expectations) -> tuple[list[str], list[str]]:
    """Which topics to listen to: those expected, then the others as far as the bounds go; and those left out."""

    def is_measurable(topic: TopicEndpoints) -> bool:
        is_own = topic.topic in OF_EVERY_NODE or names.is_hidden(topic.topic)
        return bool(topic.publishers) and len(topic.types) == 1 and not is_own

    first = [name for name in expected.topics if name in graph.topics and graph.topics[name].publishers]
    others = [name for name in sorted(graph.topics) if name not in first and is_measurable(graph.topics[name])]
    others.sort(key=lambda name: not _streams(graph.topics[name]))
    large = [name for name in others if LARGE_TYPES.intersection(graph.topics[name].types)]
    chosen = [*first, *(name for name in others if name not in large[MAX_LARGE:])]
    return chosen[:MAX_MEASURED], [*large[MAX_LARGE:], *chosen[MAX_MEASURED:]]


def flow(capture: Capture[Arrivals]) -> Flow:
    """The rate of a capture's messages, the highest that its longest silence allows, and where it was interrupted."""
    import numpy as np

    kept, holes = capture.kept, capture.holes
    end_ns = capture.end_ns if kept.all_kept else kept.last_ns
    bounded = np.sort(np.concatenate((kept.times_ns, np.array([capture.start_ns, end_ns], np.int64))))
    longest_s = float(periods_s(bounded, holes).max(initial=0.0))
    if not kept.all_kept:  # of the beginning only, and that is said
        end_ns = int(kept.times_ns[-1]) if len(kept.times_ns) else capture.start_ns
    silence = silence_in(kept.times_ns, end_ns, STOPPED_PERIODS, STOPPED_S, holes)
    rate = rate_hz(kept.times_ns, holes) if kept.all_kept else kept.rate_hz
    until_ns = 0 if kept.all_kept else max(end_ns, 1)
    return Flow(kept.count, rate, 1 / longest_s if longest_s > 0 else 0.0, silence, until_ns)


def _row(graph: GraphSnapshot, name: str, measured: Flow | None, expected: Expectations) -> TopicRow:
    topic = graph.topics.get(name, TopicEndpoints(name, (), ()))
    is_expected = name in expected.topics
    must_flow = is_expected or _streams(topic)
    state: State = "OK"
    if is_expected and not topic.publishers:
        state = "MISSING"
    elif measured is None:
        state = "NOT MEASURED"
    elif not measured.count:
        state = "SILENT" if must_flow else "QUIET"
    elif must_flow and not _is_latched(topic):
        highest_hz = measured.most_hz if measured.rate_hz is None else measured.rate_hz
        if measured.silence:
            state = "STOPPED" if measured.silence.is_end else "INTERRUPTED"
        elif highest_hz < RATE_TOLERANCE * expected.min_rate_hz:
            state = "SLOW"
    return TopicRow(
        topic_name=name,
        topic_type=", ".join(topic.types),
        publishers=len(topic.publishers),
        subscribers=len(topic.subscribers),
        state=state,
        rate_hz=measured.rate_hz if measured else None,
        expected=is_expected,
    )


# ── what is wrong ────────────────────────────────────────────────────────────────────────────────────────────────


def _missing(graph: GraphSnapshot, expected: Expectations) -> Iterator[Finding]:
    """What is expected and not there; what a source does not know of (services, nodes) is not missing."""
    for name in expected.topics:
        if name not in graph.topics:
            hint = names.did_you_mean(name, list(graph.topics), "Start the node that publishes it.")
            yield Finding("critical", name, "The expected topic is not there.", hint)
        elif not graph.topics[name].publishers:
            yield Finding("critical", name, "Nobody publishes on the expected topic.", "Start its publisher.")
    kinds = (("service", expected.services, graph.services), ("node", expected.nodes, graph.nodes))
    for kind, expected_names, present in kinds:
        for name in expected_names if present is not None else ():
            if name not in (present or ()):
                hint = names.did_you_mean(name, present or (), "Start it, or correct the name.")
                yield Finding("critical", name, f"The expected {kind} is not there.", hint)


def _flow_finding(
    graph: GraphSnapshot, row: TopicRow, measured: Flow | None, expected: Expectations
) -> Iterator[Finding]:
    """What is wrong with the flow of one topic, if anything is."""
    if row.state == "SLOW":
        rate = "fewer than two messages came" if row.rate_hz is None else f"{row.rate_hz:.2f} Hz"
        problem = f"Slow: {rate}, at least {expected.min_rate_hz:g} Hz expected."
        advice = "Look at its publisher's load and rate parameter, or lower min_expected_rate_hz."
        yield Finding("warning", row.topic_name, problem, advice)
    elif row.state in ("SILENT", "STOPPED", "INTERRUPTED"):
        publishers = _nodes_of(graph.topics[row.topic_name].publishers)
        problem = f"Published by {publishers}, but nothing came."
        if measured and (silence := measured.silence):
            since, for_s = f"from {iso_time(silence.from_ns)} on", f"{silence.duration_s:.1f} s"
            problem = f"It was interrupted: nothing for {for_s} {since}."
            if silence.is_end:
                problem = f"It has stopped: nothing in the last {for_s}, {since}."
        advice = f"Look at {publishers}: its device, parameters and log."
        yield Finding("critical" if row.expected else "warning", row.topic_name, problem, advice)


def _graph_findings(graph: GraphSnapshot) -> Iterator[Finding]:
    """Endpoints that cannot match, sensors that nodes wait for, names that nodes share."""
    for name, topic in graph.topics.items():
        for sentence in mismatches(topic.publishers, topic.subscribers):
            yield Finding("warning", name, sentence, "They never exchange a message: align type and QoS of the two.")
        if _streams(topic) and topic.subscribers and not topic.publishers:
            problem = f"{_nodes_of(topic.subscribers)} waits for it, but nobody publishes."
            yield Finding("warning", name, problem, "Start the sensor's driver, or correct a remapping.")
    for name, count in Counter(graph.nodes or ()).items():
        if count > 1:
            yield Finding("warning", name, f"{count} nodes have this name.", "Rename or stop all but one.")


def _diagnostic_findings(table: DiagnosticTable, *, with_past: bool) -> Iterator[Finding]:
    """What components report; `with_past` also what was over before the end, of a recording."""
    for row in table.rows:
        if row.level != "OK":
            problem = f"Diagnostics say {row.level}: {quoted(row.message)}."
            yield Finding("critical" if row.level == "ERROR" else "warning", row.name, problem, "See its values.")
    for row in table.past if with_past else ():
        problem = f"Diagnostics said {row.level} at {row.received_at}: {quoted(row.message)}."
        yield Finding("warning", row.name, problem, "It has become better since.")


class _Statuses:
    """What the components report, message by message; and in words, what of it could not be decoded."""

    def __init__(self, stream: Stream) -> None:
        self.table = DiagnosticTable()
        self._stream = stream
        self._undecodable = 0
        self._first_trouble = ""

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time; those of another type say nothing."""
        for sample in samples if self._stream.type == _DIAGNOSTICS_TYPE else ():
            try:
                self.table.add(self._stream.codec.decode(self._stream.type, sample.data), sample.received_ns)
            except BadData as error:
                self._undecodable += 1
                self._first_trouble = self._first_trouble or str(error)

    @property
    def trouble(self) -> str:
        return f"{DIAGNOSTICS}: {undecodable(self._undecodable, self._first_trouble)}" if self._undecodable else ""


def _note(graph: GraphSnapshot, skipped: Sequence[str], failed: Sequence[Missing]) -> str:
    notes = [] if graph.settled else ["Discovery had not settled: ask again."]
    if skipped:
        more = f" and {len(skipped) - _MAX_SKIPPED} more" if len(skipped) > _MAX_SKIPPED else ""
        listed = ", ".join(map(named, skipped[:_MAX_SKIPPED]))
        notes.append(f"Not measured, to spare the robot: {listed}{more} (expected_topics are always measured).")
    if graph.nodes is None or graph.services is None:
        notes.append("Nodes and services are not known here.")
    if failed:
        errors = "; ".join(f"{named(missing.topic)}: {missing.error}" for missing in failed[:_MAX_FAILED])
        notes.append(f"Could not be measured: {errors}")
    return " ".join(notes)


def _bounds(flows: Mapping[str, Flow]) -> str:
    """Up to when topics were looked at for silences, where that is not the end."""
    cut = [f"{name} up to {iso_time(flow.until_ns)}" for name, flow in flows.items() if flow.until_ns]
    return f"Silences were looked for only in: {', '.join(cut)}: more times were too much to keep." if cut else ""


def _nodes_of(endpoints: Sequence[Endpoint]) -> str:
    return ", ".join(sorted({endpoint.node for endpoint in endpoints}))


def _streams(topic: TopicEndpoints) -> bool:
    is_stream = STREAM_TYPES.intersection(topic.types) and not topic.topic.endswith(_OPTIONAL_TRANSPORT)
    return bool(is_stream) and not _is_latched(topic)


def _is_latched(topic: TopicEndpoints) -> bool:
    return bool(topic.publishers) and all(row.qos.durability == "transient_local" for row in topic.publishers)
