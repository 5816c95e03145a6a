"""Health of a robot: what should be there and is not, what is silent or slow, what cannot match, what it says itself.

The parts that judge are pure functions on what a source knows; nothing here asks whether it is live or recorded.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.ops.measure.diagnostics import DIAGNOSTICS, Diagnostic, DiagnosticTable
from ros2_mcp.ops.measure.flow import Silence, rate_hz, silence_in
from ros2_mcp.ops.results import Report, iso_time, silent
from ros2_mcp.ops.sources.source import Capture, GraphSnapshot, Missing, Source
from ros2_mcp.ops.topics.info import mismatches
from ros2_mcp.robot import TopicEndpoints
from ros2_mcp_bridge.limits import MAX_RATE_HZ

MAX_MEASURED = 60
MAX_LARGE = 4
MAX_ROWS = 60
MAX_FINDINGS = 40
MAX_STATUSES = 30
MAX_NAMES = 30
RATE_TOLERANCE = 0.9
"""A topic is slow below this share of the rate that is expected of it."""
STOPPED_PERIODS = 10
STOPPED_S = 1.0
"""A stream is interrupted if nothing came for so many of its median periods, and for so long."""

LARGE_TYPES = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"})
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
"""Types of sensors that stream as long as they live. On any other topic silence may be what is meant."""
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
    publishes on, are told but are no fault by themselves. A `rate_hz` of null: fewer than two messages came.
    `counts` tells how many there are where a list is cut; the worst come first.
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

    def summary(self) -> str:
        """The verdict, and a line for each finding."""
        lines = [f"{each.severity}: {each.subject}: {each.problem} {each.recommendation}" for each in self.findings]
        return "\n".join([f"{self.verdict}. {self.note}".rstrip(), *lines])


@dataclass(frozen=True, slots=True)
class Flow:
    """What came on one topic in the time of measuring.

    `most_hz` is the highest rate that its silences allow. `silence` is where a stream stopped or was interrupted.
    """

    count: int
    rate_hz: float | None
    most_hz: float
    silence: Silence | None = None


async def check_health(source: Source, expected: Expectations, report: Report = silent) -> Health:
    """Looks at the graph, listens to topics and to diagnostics at the same time, and judges.

    Raises:
        BadName: for an expected name that ROS does not allow.
        BadValue: if a number is out of range.
    """
    bounded("min_expected_rate_hz", expected.min_rate_hz, 0.0, MAX_RATE_HZ, "Hz")
    expected = _normalized(expected)
    graph = await source.graph()
    chosen, skipped = to_measure(graph, expected) if expected.check_rates else ([], [])
    measured, reported = await asyncio.gather(
        source.captures(chosen, report, times_only=True),
        source.captures([DIAGNOSTICS] if _is_published(graph, DIAGNOSTICS) else []),
    )
    if any(_missing(graph, expected)):  # it may only just have appeared
        graph = await source.graph()
    told, trouble = await asyncio.to_thread(_reported, [each for each in reported if isinstance(each, Capture)])
    flows = {capture.topic: flow(capture) for capture in measured if isinstance(capture, Capture)}
    failed = [each for each in measured if isinstance(each, Missing)]
    return _judge(source, graph, expected, flows, told, f"{_note(graph, skipped, failed)} {trouble}".strip())


def _reported(captures: Sequence[Capture]) -> tuple[DiagnosticTable, str]:
    """What the components said; and in words, what of it could not be decoded."""
    table, trouble = DiagnosticTable(), ""
    for capture in captures:
        if capture.type != _DIAGNOSTICS_TYPE:
            continue
        try:
            readable, messages, trouble = capture.readable()
        except BadData as error:
            return table, f"Diagnostics cannot be read: {error}"
        for sample, message in zip(readable.samples, messages, strict=True):
            table.take(message, sample.received_ns)
    return table, trouble


def _normalized(expected: Expectations) -> Expectations:
    return Expectations(
        [names.absolute(name) for name in expected.topics],
        [names.absolute(name, "service") for name in expected.services],
        [names.absolute(name, "node") for name in expected.nodes],
        expected.check_rates,
        expected.min_rate_hz,
    )


def to_measure(graph: GraphSnapshot, expected: Expectations) -> tuple[list[str], list[str]]:
    """Which topics to listen to: those expected, then the others as far as the bounds go; and those left out."""
    wanted = [name for name in expected.topics if _is_published(graph, name)]
    others = [name for name in sorted(graph.topics) if name not in wanted and _is_measured(graph.topics[name])]
    others.sort(key=lambda name: not _streams(graph.topics[name]))
    large = [name for name in others if LARGE_TYPES.intersection(graph.topics[name].types)]
    chosen = [*wanted, *(name for name in others if name not in large[MAX_LARGE:])]
    left_out = [*large[MAX_LARGE:], *chosen[MAX_MEASURED:]]
    return chosen[:MAX_MEASURED], left_out


def flow(capture: Capture) -> Flow:
    """The rate of a capture's messages, the highest that its longest silence allows, and where it was interrupted."""
    times = [(sample.received_ns - capture.start_ns) / 1e9 for sample in capture.samples]
    edges = [0.0, *times, capture.duration_s]
    longest = max(later - earlier for earlier, later in pairwise(edges))
    received_ns = [sample.received_ns for sample in capture.samples]
    silence = silence_in(received_ns, capture.end_ns, STOPPED_PERIODS, STOPPED_S)
    return Flow(len(times), rate_hz(times), 1 / longest if longest > 0 else 0.0, silence)


def _judge(
    source: Source,
    graph: GraphSnapshot,
    expected: Expectations,
    flows: Mapping[str, Flow],
    told: DiagnosticTable,
    note: str,
) -> Health:
    diagnostics = told.rows
    rows = [_row(graph, name, flows.get(name), expected) for name in sorted({*graph.topics, *expected.topics})]
    findings = [
        *_missing(graph, expected),
        *(finding for row in rows for finding in _flow_finding(graph, row, flows.get(row.topic_name), expected)),
        *_graph_findings(graph),
        *(_diagnosis(status) for status in diagnostics if status.level != "OK"),
        *(map(_past, told.past) if not source.is_live else ()),
    ]
    findings.sort(key=lambda finding: finding.severity)  # critical before warning
    severities = {finding.severity for finding in findings}
    visible = [row for row in rows if not names.is_hidden(row.topic_name) and row.topic_name not in OF_EVERY_NODE]
    visible.sort(key=lambda row: (row.state in ("OK", "QUIET", "NOT MEASURED"), not row.expected))
    return Health(
        "CRITICAL" if "critical" in severities else "DEGRADED" if severities else "HEALTHY",
        findings[:MAX_FINDINGS],
        visible[:MAX_ROWS],
        [_brief(status) for status in diagnostics[:MAX_STATUSES]],
        [row.topic_name for row in visible if row.publishers and not row.subscribers][:MAX_NAMES]
        if graph.nodes
        else [],
        [row.topic_name for row in visible if row.subscribers and not row.publishers][:MAX_NAMES],
        {
            "topics": len(graph.topics),
            "nodes": len(graph.nodes or ()),
            "services": len(graph.services or ()),
            "measured": len(flows),
            "findings": len(findings),
            "diagnostics": len(diagnostics),
        },
        source.words,
        note,
    )


def _brief(status: Diagnostic) -> Diagnostic:
    """Without the values where all is well."""
    return replace(status, values={}) if status.level == "OK" else status


def _row(graph: GraphSnapshot, name: str, measured: Flow | None, expected: Expectations) -> TopicRow:
    found = graph.topics.get(name, TopicEndpoints(name, (), ()))
    is_expected = name in expected.topics
    return TopicRow(
        name,
        ", ".join(found.types),
        len(found.publishers),
        len(found.subscribers),
        _state(found, measured, is_expected, expected.min_rate_hz),
        measured.rate_hz if measured else None,
        is_expected,
    )


def _state(found: TopicEndpoints, measured: Flow | None, is_expected: bool, min_rate_hz: float) -> State:
    if is_expected and not found.publishers:
        return "MISSING"
    if measured is None:
        return "NOT MEASURED"
    if not measured.count:
        return "SILENT" if is_expected or _streams(found) else "QUIET"
    if _is_latched(found) or not (is_expected or _streams(found)):
        return "OK"
    if measured.silence:
        return "STOPPED" if measured.silence.is_end else "INTERRUPTED"
    found_hz = measured.most_hz if measured.rate_hz is None else measured.rate_hz
    return "SLOW" if found_hz < RATE_TOLERANCE * min_rate_hz else "OK"


def _missing(graph: GraphSnapshot, expected: Expectations) -> Iterator[Finding]:
    for topic in expected.topics:
        if topic not in graph.topics:
            hint = names.did_you_mean(topic, list(graph.topics), "Start the node that publishes it.")
            yield Finding("critical", topic, "The expected topic is not there.", hint)
        elif not graph.topics[topic].publishers:
            yield Finding("critical", topic, "Nobody publishes on the expected topic.", "Start its publisher.")
    for what, wanted, there in (
        ("service", expected.services, graph.services),
        ("node", expected.nodes, graph.nodes),
    ):
        known = wanted if there is None else there  # what a source does not know is not missing
        for name in wanted:
            if name not in known:
                hint = names.did_you_mean(name, known, "Start it, or correct the name.")
                yield Finding("critical", name, f"The expected {what} is not there.", hint)


def _flow_finding(
    graph: GraphSnapshot, row: TopicRow, measured: Flow | None, expected: Expectations
) -> Iterator[Finding]:
    if row.state in ("SILENT", "STOPPED", "INTERRUPTED"):
        by = ", ".join(sorted({each.node for each in graph.topics[row.topic_name].publishers}))
        advice = f"Look at {by}: its device, parameters and log."
        problem = f"Published by {by}, but nothing came."
        if measured and measured.silence:
            problem = _interrupted(measured.silence)
        yield Finding("critical" if row.expected else "warning", row.topic_name, problem, advice)
    elif row.state == "SLOW":
        rate = "fewer than two messages came" if row.rate_hz is None else f"{row.rate_hz:.2f} Hz"
        problem = f"Slow: {rate}, at least {expected.min_rate_hz:g} Hz expected."
        advice = "Look at its publisher's load and rate parameter, or lower min_expected_rate_hz."
        yield Finding("warning", row.topic_name, problem, advice)


def _interrupted(silence: Silence) -> str:
    since = f"from {iso_time(silence.from_ns)} on"
    if silence.is_end:
        return f"It has stopped: nothing in the last {silence.duration_s:.1f} s, {since}."
    return f"It was interrupted: nothing for {silence.duration_s:.1f} s {since}."


def _graph_findings(graph: GraphSnapshot) -> Iterator[Finding]:
    for topic, found in graph.topics.items():
        for sentence in mismatches(found.publishers, found.subscribers):
            yield Finding("warning", topic, sentence, "They never exchange a message: align type and QoS of the two.")
        if _streams(found) and found.subscribers and not found.publishers:
            waiting = ", ".join(sorted({each.node for each in found.subscribers}))
            problem = f"{waiting} waits for it, but nobody publishes."
            yield Finding("warning", topic, problem, "Start the sensor's driver, or correct a remapping.")
    for name, count in Counter(graph.nodes or ()).items():
        if count > 1:
            yield Finding("warning", name, f"{count} nodes have this name.", "Rename or stop all but one.")


def _diagnosis(status: Diagnostic) -> Finding:
    severity: Severity = "critical" if status.level == "ERROR" else "warning"
    return Finding(severity, status.name, f"Diagnostics say {status.level}: {status.message}.", "See its values.")


def _past(status: Diagnostic) -> Finding:
    problem = f"Diagnostics said {status.level} at {status.received_at}: {status.message}."
    return Finding("warning", status.name, problem, "It has become better since.")


def _note(graph: GraphSnapshot, skipped: Sequence[str], failed: Sequence[Missing]) -> str:
    notes = [] if graph.settled else ["Discovery had not settled: ask again."]
    if skipped:
        listed = ", ".join(skipped[:8]) + (f" and {len(skipped) - 8} more" if len(skipped) > 8 else "")
        notes.append(f"Not measured, to spare the robot: {listed} (expected_topics are always measured).")
    if graph.nodes is None or graph.services is None:
        notes.append("Nodes and services are not known here.")
    if failed:
        notes.append(f"Could not be measured: {'; '.join(f'{each.topic}: {each.error}' for each in failed[:5])}")
    return " ".join(notes)


def _is_published(graph: GraphSnapshot, topic: str) -> bool:
    return topic in graph.topics and bool(graph.topics[topic].publishers)


def _is_measured(found: TopicEndpoints) -> bool:
    is_of_ros = found.topic in OF_EVERY_NODE or names.is_hidden(found.topic)
    return bool(found.publishers) and len(found.types) == 1 and not is_of_ros


def _streams(found: TopicEndpoints) -> bool:
    is_stream = STREAM_TYPES.intersection(found.types) and not found.topic.endswith(_OPTIONAL_TRANSPORT)
    return bool(is_stream) and not _is_latched(found)


def _is_latched(found: TopicEndpoints) -> bool:
    return bool(found.publishers) and all(each.qos.durability == "transient_local" for each in found.publishers)
