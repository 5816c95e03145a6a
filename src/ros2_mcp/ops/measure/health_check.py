"""Health of a robot: what should be there and is not, what is silent or slow, what cannot match, what diagnostics say.

The parts that judge are pure functions on what a source knows; nothing here asks whether it is live or recorded.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData, UnknownInterface
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import listed, named, quoted
from ros2_mcp.model.times import both_times
from ros2_mcp.ops.measure.diagnostics import DIAGNOSTICS, Diagnostic, DiagnosticTable
from ros2_mcp.ops.measure.findings import Finding, joined
from ros2_mcp.ops.measure.flow import Silence, is_burst, periods_s, silence_in
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, four_digits, microseconds, silent
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Capture, GraphSnapshot, Missing, Source, Stream
from ros2_mcp.ops.topics.info import mismatches
from ros2_mcp.robot import TopicEndpoints
from ros2_mcp_common.wire.limits import MAX_RATE_HZ

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.finite import Finite
    from ros2_mcp.ops.topics.arrivals import AgedArrivals, Ages

# Topics that are listened to, and of those images and clouds: a check must not overload a weak robot.
MAX_MEASURED = 60
MAX_LARGE = 4
# Topics of motion that are read in full, for values that are not finite: a robot has some of odometry, some IMUs.
MAX_OF_MOTION = 12
# Entries of the result's lists, the worst first, so that the report on a very broken robot fits into a result, too.
MAX_ROWS = 60
MAX_FINDINGS = 40
MAX_STATUSES = 30
MAX_NAMES = 30
# Names in the note: which topics were not measured, and which could not be.
_MAX_SKIPPED = 8
_MAX_FAILED = 5
# Names that several nodes share: a robot's nodes, so that it is seen whether all of them are there twice.
_MAX_SHARED = 12
# A topic is slow below this share of the rate that is expected of it: a few seconds are not whole periods.
RATE_TOLERANCE = 0.9
# A stream is interrupted if nothing came for this many of its usual periods, and for this long.
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

Verdict = Literal["HEALTHY", "DEGRADED", "CRITICAL"]
State = Literal[
    "OK", "MISSING", "SILENT", "STOPPED", "INTERRUPTED", "SLOW", "OLD STAMPS", "NOT FINITE", "QUIET", "NOT MEASURED"
]
Presence = Literal["OK", "MISSING", "UNKNOWN"]
_NO_FAULT: Sequence[State] = ("OK", "QUIET", "NOT MEASURED")


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


@dataclass(frozen=True, slots=True)
class Health:
    """A report on the robot.

    `CRITICAL`: no robot is there, or nothing comes of it and none of its nodes answers; something expected is missing
    or silent, what was published earlier in this session has no publisher any more, or diagnostics report an error.
    `DEGRADED`: a sensor is silent, has stopped, was interrupted, is slow, has old stamps or values of motion that are
    not finite, a node has left, endpoints cannot match, nodes share a name, a type is unknown where the bridge runs, or
    diagnostics warn; of a recording also if they reported something that was over before its end. Topics that nobody
    listens to, or nobody publishes on, are listed but are no fault by themselves. What is wrong with one node and its
    topics is one finding. A `rate_hz` of null: too few messages came. `services` and `nodes` are those that are
    expected. `counts` says how many there are where a list is cut; the worst come first. `in_short` has the other
    topics with their state, as `OK, 10 Hz`.
    """

    verdict: Verdict = field(metadata=SAID)
    findings: Sequence[Finding] = field(metadata=SAID)
    topics: Sequence[TopicRow]
    in_short: Mapping[str, str]
    services: Mapping[str, Presence]
    nodes: Mapping[str, Presence]
    diagnostics: Sequence[Diagnostic]
    publishers_without_subscribers: Sequence[str]
    subscribers_without_publishers: Sequence[str]
    counts: Mapping[str, int]
    source: str
    note: str = field(metadata=IF_ANY)

    def summary(self) -> list[str]:
        """The verdict, and a line for each finding."""
        lines = [f"{row.severity}: {named(row.subject)}: {row.problem} {row.recommendation}" for row in self.findings]
        return [f"{self.verdict}. {self.note}".rstrip(), *lines]


@dataclass(frozen=True, slots=True)
class Flow:
    """What came on one topic in the time of measuring.

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


async def check_health(source: Source, expected: Expectations, report: Report = silent) -> Health:
    """Looks at the graph, listens to topics and to diagnostics at the same time, and judges.

    Raises:
        BadName: for an expected name that ROS does not allow.
        BadValue: if a number is out of range.
    """
    bounded("min_expected_rate_hz", expected.min_rate_hz, 0.0, MAX_RATE_HZ, "Hz")
    expected = replace(
        expected,
        topics=[await source.name_of(name) for name in expected.topics],
        services=[names.absolute(name, "service") for name in expected.services],
        nodes=[names.absolute(name, "node") for name in expected.nodes],
    )
    graph = await source.graph()
    chosen, skipped = to_measure(graph, expected) if expected.check_rates else ([], [])
    has_diagnostics = DIAGNOSTICS in graph.topics and bool(graph.topics[DIAGNOSTICS].publishers)
    from ros2_mcp.ops.measure.columns import Room
    from ros2_mcp.ops.measure.finite import MOTION_TYPES, Finite
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

    room = Room()
    of_motion = [name for name in chosen if MOTION_TYPES.issuperset(graph.topics[name].types)][:MAX_OF_MOTION]

    def in_full(stream: Stream) -> Finite | _Statuses:
        return Finite(stream) if stream.type in MOTION_TYPES else _Statuses(stream, source.began_ns)

    measured, read = await asyncio.gather(
        source.captures(chosen, lambda stream: AgedArrivals(stream, room), report, times_only=True),
        source.captures([*([DIAGNOSTICS] if has_diagnostics else []), *of_motion], in_full),
    )
    if any(_missing(graph, expected)):  # it may only just have appeared
        graph = await source.graph()
    kept = {capture.topic: capture.kept for capture in read if isinstance(capture, Capture)}
    finite = {topic: found for topic, found in kept.items() if isinstance(found, Finite)}
    statuses = kept.get(DIAGNOSTICS)
    diagnostics, trouble = (
        (statuses.table, statuses.trouble) if isinstance(statuses, _Statuses) else (DiagnosticTable(), "")
    )

    def flowed() -> dict[str, Flow]:
        return {
            capture.topic: replace(flow(capture), finite=finite.get(capture.topic))
            for capture in measured
            if isinstance(capture, Capture)
        }

    flows = await asyncio.to_thread(flowed)  # of millions of messages it takes half a second
    failed = [missing for missing in measured if isinstance(missing, Missing)]
    rows = [_row(graph, name, flows.get(name), expected) for name in sorted({*graph.topics, *expected.topics})]
    moving = [flow.count for name, flow in flows.items() if not _is_latched(graph.topics[name])]
    is_quiet = not (any(moving) or diagnostics.rows)
    found = [
        *_gone(graph, expected),
        *_hung(await source.hung(graph.nodes or ()) if is_quiet else (), expected),
        *_missing(graph, expected),
        *_nothing(graph, source),
        *(finding for row in rows for finding in _flow_finding(graph, row, flows.get(row.topic_name), expected)),
        *_graph_findings(graph),
        *_type_conflicts(graph, expected),
        *_unknown_types(failed),
        *_diagnostic_findings(graph, diagnostics, with_past=not source.is_live),
    ]
    return _report(
        graph,
        joined(found),
        rows,
        diagnostics,
        expected=expected,
        measured=len(flows),
        source=source.words,
        note=" ".join(filter(None, (_note(graph, skipped, failed), trouble, _bounds(flows)))),
    )


def _report(
    graph: GraphSnapshot,
    findings: Sequence[Finding],
    rows: Sequence[TopicRow],
    diagnostics: DiagnosticTable,
    *,
    expected: Expectations,
    measured: int,
    source: str,
    note: str,
) -> Health:
    """The lists within their bounds, the worst first; `measured` topics were listened to."""
    visible = [row for row in rows if not names.is_hidden(row.topic_name) and row.topic_name not in OF_EVERY_NODE]
    visible.sort(key=lambda row: (row.state in _NO_FAULT, not row.expected))
    in_full = [row for row in visible if row.expected or row.state not in _NO_FAULT]
    # a recording knows who published, and neither nodes nor subscribers
    without_subscribers = [row.topic_name for row in visible if graph.nodes and row.publishers and not row.subscribers]
    without_publishers = [row.topic_name for row in visible if row.subscribers and not row.publishers]
    return Health(
        verdict="HEALTHY" if not findings else "CRITICAL" if findings[0].severity == "critical" else "DEGRADED",
        findings=findings[:MAX_FINDINGS],
        topics=in_full[:MAX_ROWS],
        in_short={row.topic_name: _in_short(row) for row in visible[len(in_full) : MAX_ROWS]},
        services=_presence(expected.services, graph.services),
        nodes=_presence(expected.nodes, graph.nodes),
        diagnostics=[replace(row, values={}) if row.level == "OK" else row for row in diagnostics.rows[:MAX_STATUSES]],
        publishers_without_subscribers=without_subscribers[:MAX_NAMES],
        subscribers_without_publishers=without_publishers[:MAX_NAMES],
        counts={
            "topics": len(graph.topics),
            "nodes": len(graph.nodes or ()),
            "services": len(graph.services or ()),
            "measured": measured,
            "findings": len(findings),
            "diagnostics": len(diagnostics.rows),
        },
        source=source,
        note=note,
    )


def _presence(expected: Sequence[str], present: Collection[str] | None) -> dict[str, Presence]:
    """Which of the expected names are there, as far as that is known."""
    if present is None:
        return dict.fromkeys(expected, "UNKNOWN")
    return {name: "OK" if name in present else "MISSING" for name in expected}


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


def flow(capture: Capture[AgedArrivals]) -> Flow:
    """The rate of a capture's messages, the highest that its longest silence allows, and where it was interrupted."""
    import numpy as np

    kept, holes = capture.kept, capture.holes
    end_ns = capture.end_ns if kept.all_kept else kept.last_ns
    bounded = np.sort(np.concatenate((kept.times_ns, np.array([capture.start_ns, end_ns], np.int64))))
    longest_s = float(periods_s(bounded, holes).max(initial=0.0))
    if not kept.all_kept:  # of the beginning only, and that is said
        end_ns = int(kept.times_ns[-1]) if len(kept.times_ns) else capture.start_ns
    silence = silence_in(kept.times_ns, end_ns, STOPPED_PERIODS, STOPPED_S, holes)
    rate = kept.rate_hz(holes)
    if is_burst(kept.count, rate, capture.duration_s):
        rate = None
    until_ns = 0 if kept.all_kept else max(end_ns, 1)
    most_hz = 1 / longest_s if longest_s > 0 else 0.0
    return Flow(kept.seen, rate, most_hz, silence, kept.ages, zero_ns=capture.zero_ns, until_ns=until_ns)


def _in_short(row: TopicRow) -> str:
    return row.state if row.rate_hz is None else f"{row.state}, {row.rate_hz:g} Hz"


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
        elif measured.ages and measured.ages.trouble:
            state = "OLD STAMPS"
    if state == "OK" and measured and measured.finite and measured.finite.found:
        state = "NOT FINITE"
    return TopicRow(
        topic_name=name,
        topic_type=", ".join(topic.types),
        publishers=len(topic.publishers),
        subscribers=len(topic.subscribers),
        state=state,
        rate_hz=four_digits(measured.rate_hz) if measured else None,
        age_s=microseconds(measured.ages.mean_s) if measured and measured.ages else None,
        expected=is_expected,
    )


# ── what is wrong ────────────────────────────────────────────────────────────────────────────────────────────────


def _gone(graph: GraphSnapshot, expected: Expectations) -> Iterator[Finding]:
    """That no robot is there; or what of it was there earlier in this session, and has left.

    A sensor that has left is critical, and what is expected. Anything else may have been closed on purpose: a display,
    a remote control, one of several ways to localise. While discovery is under way, all of it may still come.
    """
    if graph.absence:
        severity = "critical" if graph.settled else "warning"
        yield Finding(severity, "robot", graph.absence, "Start the robot, or start this server in the robot's domain.")
        return
    silenced: dict[tuple[str, ...], list[str]] = {}
    for topic, publishers in graph.left.topics.items():
        silenced.setdefault(tuple(publishers), []).append(topic)
    for publishers, topics in silenced.items():
        gone = [node for node in publishers if node in graph.left.nodes]
        who = f"{listed(gone, MAX_NAMES)} has left:" if gone else f"{listed(publishers, MAX_NAMES)} is there, but"
        problem = f"{who} nobody publishes any longer on {listed(sorted(topics), MAX_NAMES)}."
        advice = "Start the node again; ros2_log_read may show why it ended."
        is_needed = any(graph.left.types.get(name) in STREAM_TYPES or name in expected.topics for name in topics)
        severity = "critical" if is_needed and graph.settled else "warning"
        yield Finding(severity, publishers[0], problem, advice, _only(publishers))
    missed = {node for publishers in silenced for node in publishers}
    for node in sorted(set(graph.left.nodes) - missed):
        problem = "It was running earlier in this session, and has left."
        yield Finding("warning", node, problem, "Start the node again if it is needed.", node)


def _nothing(graph: GraphSnapshot, source: Source) -> Iterator[Finding]:
    """That a recording is empty: nothing in it is wrong, and nothing right."""
    if graph.nodes is None and not graph.topics:  # a recording knows no nodes
        yield Finding(
            "warning", source.title, "The recording has no messages, so nothing can be judged.", "Record again."
        )


def _hung(nodes: Sequence[str], expected: Expectations) -> Iterator[Finding]:
    """That nothing at all comes of a robot whose nodes do not answer either."""
    if nodes:
        who = f"one of {listed(nodes, MAX_NAMES)} answers."
        problem = f"Nothing came on any topic, and n{who}" if expected.check_rates else f"N{who}"
        yield Finding(
            "critical", "robot", problem, "Check whether the robot is switched on, connected and not hanging."
        )


def _missing(graph: GraphSnapshot, expected: Expectations) -> Iterator[Finding]:
    """What is expected and not there; what a source does not know of (services, nodes) is not missing."""
    for name in expected.topics:
        cause = _only(graph.left.topics.get(name, ()))
        if name not in graph.topics:
            hint = names.did_you_mean(name, list(graph.topics), "Start the node that publishes it.")
            yield Finding("critical", name, "The expected topic does not exist.", hint, cause)
        elif not graph.topics[name].publishers:
            yield Finding("critical", name, "Nobody publishes on the expected topic.", "Start its publisher.", cause)
    kinds = (("service", expected.services, graph.services), ("node", expected.nodes, graph.nodes))
    for kind, expected_names, present in kinds:
        for name in expected_names if present is not None else ():
            if name not in (present or ()):
                hint = names.did_you_mean(name, list(present or ()), "Start its node, or correct the name.")
                cause = name if kind == "node" else ""
                yield Finding("critical", name, f"The expected {kind} is missing.", hint, cause)


def _flow_finding(
    graph: GraphSnapshot, row: TopicRow, measured: Flow | None, expected: Expectations
) -> Iterator[Finding]:
    """What is wrong with the flow of one topic, if anything is."""
    topic = graph.topics.get(row.topic_name)
    cause = _only(sorted({one.node for one in topic.publishers})) if topic else ""
    if measured and (finite := measured.finite) and finite.found:
        first = both_times(finite.first_ns, measured.zero_ns)
        bad = f"{finite.found} of {finite.looked_at} messages have NaN or infinite values"
        problem = f"{bad}, in {', '.join(finite.fields)}, first at {first}."
        advice = "Check its publisher's inputs and parameters; nodes that compute with these values produce NaN too."
        yield Finding("critical" if row.expected else "warning", row.topic_name, problem, advice, cause)
    if row.state == "SLOW":
        rate = "too few messages came to measure its rate" if row.rate_hz is None else f"{row.rate_hz:.2f} Hz"
        problem = f"Slow: {rate}, at least {expected.min_rate_hz:g} Hz expected."
        advice = "Check its publisher's load and rate parameter, or lower min_expected_rate_hz."
        yield Finding("warning", row.topic_name, problem, advice, cause)
    elif row.state == "OLD STAMPS" and measured and measured.ages:
        advice = "Compare the machines' clocks (chrony, NTP), and check its publisher's load and network."
        yield Finding("warning", row.topic_name, measured.ages.trouble, advice, cause)
    elif row.state in ("SILENT", "STOPPED", "INTERRUPTED"):
        publishers = _nodes_of(graph.topics[row.topic_name].publishers)
        problem = f"{publishers} publishes it, but no message came."
        if measured and (silence := measured.silence):
            since, for_s = f"from {both_times(silence.from_ns, measured.zero_ns)} on", f"{silence.duration_s:.1f} s"
            problem = f"It was interrupted: no message for {for_s} {since}."
            if silence.is_end:
                problem = f"It has stopped: no message in the last {for_s}, {since}."
        advice = f"Check the device, parameters and log of {publishers}."
        yield Finding("critical" if row.expected else "warning", row.topic_name, problem, advice, cause)


def _type_conflicts(graph: GraphSnapshot, expected: Expectations) -> Iterator[Finding]:
    """Topics on which several types are published: who subscribes to one never gets the other."""
    for name, topic in graph.topics.items():
        by_type: dict[str, list[Endpoint]] = {}
        for publisher in topic.publishers:
            by_type.setdefault(publisher.type, []).append(publisher)
        if len(by_type) > 1:
            who = "; ".join(f"{_nodes_of(found)} publishes {type_name}" for type_name, found in by_type.items())
            severity = "critical" if name in expected.topics else "warning"
            advice = "Stop or remap the wrong publisher; the topic cannot be measured until then."
            yield Finding(severity, name, f"Several types on one topic: {who}.", advice)


def _unknown_types(failed: Sequence[Missing]) -> Iterator[Finding]:
    """What cannot be read for want of its type, whoever publishes it: one finding for each type."""
    topics: dict[str, list[Missing]] = {}
    for missing in failed:
        if isinstance(missing.error, UnknownInterface):
            topics.setdefault(missing.error.message, []).append(missing)
    for problem, (first, *others) in topics.items():
        also = f" The same holds for {listed([other.topic for other in others], MAX_NAMES)}." if others else ""
        yield Finding(
            "warning", first.topic, f"The topic cannot be measured or read. {problem}{also}", first.error.hint
        )


def _graph_findings(graph: GraphSnapshot) -> Iterator[Finding]:
    """Endpoints that cannot match, sensors that nodes wait for, names that nodes share."""
    for name, topic in graph.topics.items():
        for sentence in dict.fromkeys(mismatches(topic.publishers, topic.subscribers)):
            yield Finding(
                "warning",
                name,
                sentence,
                "Give both the same type and compatible QoS; no message passes between them now.",
            )
        if _streams(topic) and topic.subscribers and not topic.publishers:
            problem = f"{_nodes_of(topic.subscribers)} subscribes to it, but nobody publishes."
            cause = _only(graph.left.topics.get(name, ()))
            yield Finding("warning", name, problem, "Start the sensor's driver, or correct a remapping.", cause)
    shared = {name: count for name, count in Counter(graph.nodes or ()).items() if count > 1}
    if len(shared) > 1:  # most likely two robots, or one that was started twice: one fault
        problem = f"{len(shared)} names are shared by several nodes each: {listed(list(shared), _MAX_SHARED)}."
        yield Finding("warning", "nodes", problem, "If two robots share this domain, separate them, or stop one.")
    for name, count in shared.items() if len(shared) == 1 else ():
        yield Finding("warning", name, f"{count} nodes have this name.", "Rename or stop all but one.")


def _diagnostic_findings(graph: GraphSnapshot, table: DiagnosticTable, *, with_past: bool) -> Iterator[Finding]:
    """What components report; `with_past` also what was over before the end, of a recording.

    By convention (`diagnostic_updater`) a component is named after its node: `lidar: status`.
    """
    nodes = {*(graph.nodes or ()), *graph.left.nodes}
    for row in table.rows:
        if row.level != "OK":
            problem = f"Diagnostics report {row.level}: {quoted(row.message)}."
            node = row.name.partition(":")[0].strip("/ ")
            cause = _only([name for name in nodes if name.strip("/") == node or name.endswith(f"/{node}")])
            severity = "critical" if row.level == "ERROR" else "warning"
            yield Finding(severity, row.name, problem, "Check its values.", cause)
    for row in table.past if with_past else ():
        problem = f"Diagnostics reported {row.level} at {row.received_at}: {quoted(row.message)}."
        yield Finding("warning", row.name, problem, "It has become better since.")


class _Statuses:
    """What the components report, message by message; and in words, what of it could not be decoded."""

    def __init__(self, stream: Stream, began_ns: int | None) -> None:
        self.table = DiagnosticTable(began_ns)
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
    notes = [] if graph.settled else ["Discovery had not settled. Ask again."]
    if skipped:
        names_of = listed(skipped, _MAX_SKIPPED)
        notes.append(
            f"Not measured, to limit the load on the robot: {names_of}. Name topics in expected_topics to measure them."
        )
    if graph.nodes is None or graph.services is None:
        notes.append("A recording does not say which nodes and services ran.")
    others = [missing for missing in failed if not isinstance(missing.error, UnknownInterface)]
    if others:
        errors = "; ".join(f"{named(missing.topic)}: {missing.error}" for missing in others[:_MAX_FAILED])
        notes.append(f"Not measured because of errors: {errors}")
    return " ".join(notes)


def _bounds(flows: Mapping[str, Flow]) -> str:
    """Up to when topics were looked at for silences, where that is not the end."""
    cut = [f"{name} up to {both_times(flow.until_ns, flow.zero_ns)}" for name, flow in flows.items() if flow.until_ns]
    return f"Silences were searched only in: {', '.join(cut)}; later times did not fit in memory." if cut else ""


def _nodes_of(endpoints: Sequence[Endpoint]) -> str:
    return ", ".join(sorted({endpoint.node for endpoint in endpoints}))


def _only(nodes: Sequence[str]) -> str:
    """The one node, if it is one and has a name: what it may be the cause of is one finding."""
    return nodes[0] if len(nodes) == 1 and nodes[0].startswith("/") else ""


def _streams(topic: TopicEndpoints) -> bool:
    is_stream = STREAM_TYPES.intersection(topic.types) and not topic.topic.endswith(_OPTIONAL_TRANSPORT)
    return bool(is_stream) and not _is_latched(topic)


def _is_latched(topic: TopicEndpoints) -> bool:
    return bool(topic.publishers) and all(row.qos.durability == "transient_local" for row in topic.publishers)
