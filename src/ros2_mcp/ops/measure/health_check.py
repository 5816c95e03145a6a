"""Health check of a robot: missing names, silent or slow topics, endpoints that cannot match, diagnostics and more.

Judging is done by pure functions on the data of a source, and does not depend on whether it is live or recorded.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData, UnknownInterface
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.model.nav2 import is_drawn_by_nav2
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import listed, named
from ros2_mcp.model.times import both_times
from ros2_mcp.ops.measure.checks import NEEDS, findings_in
from ros2_mcp.ops.measure.diagnostics import DIAGNOSTICS, Diagnostic, DiagnosticTable
from ros2_mcp.ops.measure.evidence import (
    LARGE_TYPES,
    LEAST_LISTENED_S,
    ONCE_A_SECOND,
    STEADY_TYPES,
    Evidence,
    Expectations,
    Flow,
    State,
    TopicRow,
    is_latched,
    streams,
)
from ros2_mcp.ops.measure.findings import Finding, joined
from ros2_mcp.ops.measure.flow import is_burst, periods_s, silence_in
from ros2_mcp.ops.measure.readers import read as read_parts
from ros2_mcp.ops.measure.rivals import Rivals
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, four_digits, microseconds, silent
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Capture, GraphSnapshot, Missing, Source, Stream
from ros2_mcp.robot import Robot, TopicEndpoints
from ros2_mcp.robot.transforms import TF, TF_STATIC
from ros2_mcp_common.wire.limits import MAX_RATE_HZ

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.finite import Finite
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

__all__ = ["Expectations", "Health", "check_health", "flow", "to_measure"]

# The most topics that are measured, and images and clouds among them: a check must not overload a weak robot.
MAX_MEASURED = 60
MAX_LARGE = 4
# The most topics of motion read in full to find values that are not finite: some of odometry, some IMUs.
MAX_OF_MOTION = 12
# Lengths of the result's lists, the worst first, so that the report on a very broken robot still fits into a result.
MAX_ROWS = 60
MAX_FINDINGS = 40
MAX_STATUSES = 30
MAX_NAMES = 30
_LEAST_GROUPED = 10
"""Topics without a fault that only Nav2's own nodes publish: a whole stack has sixty, and is one line."""
# The most names in the note: of topics not measured, and of topics that failed.
_MAX_SKIPPED = 8
_MAX_FAILED = 5
# The most joint state topics with several publishers read in full, to see whether the publishers contradict each other.
_MOST_RIVALS = 4
# Types of streams that may end: commands, plans, and markers that show them.
_FOR_A_WHILE = frozenset(
    {
        "ackermann_msgs/msg/AckermannDrive",
        "ackermann_msgs/msg/AckermannDriveStamped",
        "geometry_msgs/msg/PointStamped",
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
        "nav_msgs/msg/Path",
        "sensor_msgs/msg/Joy",
        "trajectory_msgs/msg/JointTrajectory",
        "visualization_msgs/msg/Marker",
        "visualization_msgs/msg/MarkerArray",
    }
)
# A topic is slow below this share of the expected rate: a few seconds do not hold whole periods.
RATE_TOLERANCE = 0.9
# A stream is interrupted if no message is received for this many usual periods, and for this long.
STOPPED_PERIODS = 10
STOPPED_S = 1.0

_JOINT_STATE = "sensor_msgs/msg/JointState"
_DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"

Verdict = Literal["HEALTHY", "DEGRADED", "CRITICAL"]
Presence = Literal["OK", "MISSING", "UNKNOWN"]
_NO_FAULT: Sequence[State] = ("OK", "QUIET", "NOT MEASURED")


@dataclass(frozen=True, slots=True)
class Health:
    """A report on the robot.

    `CRITICAL`: there is no robot, or no messages arrive and none of its nodes answers; an expected name is missing, or
    an expected topic has no messages; a topic that had a publisher earlier in this session has none any more; or
    diagnostics report an error. `DEGRADED`: a sensor sends no messages, has stopped, was interrupted, is slow, has old
    stamps, or sends motion values that are not finite; a node has left; endpoints cannot match; nodes share a name or
    offer the same service; a type is unknown where the bridge runs; diagnostics warn or report an inactive component;
    frames, lifecycle nodes, controllers, parameters or clocks have a fault; nothing could be measured at all; or, in a
    recording, diagnostics reported a problem that was over before the end. Topics without a subscriber or a publisher
    are listed, but are not faults by themselves. All faults of one node and its topics are one finding.

    A `rate_hz` of null means too few messages. `services` and `nodes` are the expected ones. `counts` has the full
    length of each shortened list; the worst entries come first. `other_topics` maps the remaining topics to their
    state, such as `OK, 10 Hz`; many of Nav2's own are counted in one row.
    """

    verdict: Verdict = field(metadata=SAID)
    findings: Sequence[Finding] = field(metadata=SAID)
    topics: Sequence[TopicRow]
    other_topics: Mapping[str, str]
    services: Mapping[str, Presence]
    nodes: Mapping[str, Presence]
    diagnostics: Sequence[Diagnostic]
    publishers_without_subscribers: Sequence[str]
    subscribers_without_publishers: Sequence[str]
    counts: Mapping[str, int]
    source: str
    note: str = field(metadata=IF_ANY)

    def summary(self) -> list[str]:
        """Return the verdict, and a line for each finding."""
        lines = [f"{row.severity}: {named(row.subject)}: {row.problem} {row.recommendation}" for row in self.findings]
        return [f"{self.verdict}. {self.note}".rstrip(), *lines]


async def check_health(
    source: Source, expected: Expectations, report: Report = silent, robot: Robot | None = None
) -> Health:
    """Read the graph, measure topics, receive diagnostics and read what the checks need of the `robot`, all at the same
    time, and judge.

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
    contested = [name for name in chosen if _is_contested(graph.topics[name])][:_MOST_RIVALS]

    def in_full(stream: Stream) -> Finite | Rivals | _Statuses:
        if stream.type in MOTION_TYPES:
            return Finite(stream)
        return Rivals(stream) if stream.topic in contested else _Statuses(stream, source.began_ns)

    measured, read, (parts, not_read) = await asyncio.gather(
        source.captures(chosen, lambda stream: AgedArrivals(stream, room), report, times_only=True),
        source.captures([*([DIAGNOSTICS] if has_diagnostics else []), *of_motion, *contested], in_full),
        read_parts(NEEDS, robot, source, graph),
    )
    if any(name not in graph.topics for name in expected.topics) or _lacks(graph, expected):
        graph = await source.graph()  # an expected name may have been discovered since
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

    flows = await asyncio.to_thread(flowed)  # for millions of messages it takes half a second
    failed = [missing for missing in measured if isinstance(missing, Missing)]
    rows = [_row(graph, name, flows, expected) for name in sorted({*graph.topics, *expected.topics})]
    moving = [flow.count for name, flow in flows.items() if not is_latched(graph.topics[name])]
    is_quiet = not (any(moving) or diagnostics.rows)
    evidence = Evidence(
        graph=graph,
        expected=expected,
        is_live=source.is_live,
        source_title=source.title,
        rows=rows,
        flows=flows,
        not_measured=failed,
        diagnostics=diagnostics,
        rivals={topic: found for topic, found in kept.items() if isinstance(found, Rivals)},
        hung=await source.hung(graph.nodes or ()) if is_quiet else (),
        **parts,
    )
    missed = f"Not read, and so not judged: {'; '.join(not_read)}." if not_read else ""
    return _report(
        graph,
        joined(findings_in(evidence)) or _nothing_measured(evidence),
        rows,
        diagnostics,
        expected=expected,
        measured=len(flows),
        source=source.words,
        note=" ".join(
            filter(None, (_note(graph, skipped, failed, is_live=source.is_live), missed, trouble, _bounds(flows)))
        ),
    )


def _is_contested(topic: TopicEndpoints) -> bool:
    """Return whether several nodes publish joint states on the topic."""
    return _JOINT_STATE in topic.types and len({publisher.node for publisher in topic.publishers}) > 1


def _lacks(graph: GraphSnapshot, expected: Expectations) -> bool:
    """Return whether an expected name is missing."""
    topics = [name for name in expected.topics if not graph.topics[name].publishers]
    services = [name for name in expected.services if name not in (graph.services or expected.services)]
    nodes = [name for name in expected.nodes if name not in (graph.nodes or expected.nodes)]
    return bool(topics or services or nodes)


def _nothing_measured(evidence: Evidence) -> list[Finding]:
    """Return a warning that nothing was measured, if no data show that the robot works; else empty."""
    is_expected_there = any(row.expected and row.state == "OK" for row in evidence.rows)
    controllers = [one for control in (evidence.ros2_control or {}).values() for one in control.controllers]
    parts = (any(flow.count for flow in evidence.flows.values()), evidence.diagnostics.rows, evidence.lifecycle)
    if is_expected_there or controllers or any(parts):
        return []
    what = "topics were not read" if not evidence.expected.check_rates else "no message came on any topic"
    problem = f"Nothing was measured: {what}, and no diagnostics were published. The health of the robot is unknown."
    advice = "Name what must be there in expected_topics, expected_services and expected_nodes."
    return [Finding("warning", "robot", problem, advice)]


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
    """Return the report with its lists cut to their limits, the worst first; `measured` is the number of measured
    topics.
    """
    visible = [row for row in rows if not names.is_hidden(row.topic_name) and row.topic_name not in OF_EVERY_NODE]
    visible.sort(key=lambda row: (row.state in _NO_FAULT, not row.expected))
    in_full = [row for row in visible if row.expected or row.state not in _NO_FAULT]
    without_fault = visible[len(in_full) :]
    of_nav2 = [
        row
        for row in without_fault
        if row.topic_name in graph.topics and is_drawn_by_nav2(graph.topics[row.topic_name])
    ]
    grouped = {row.topic_name for row in of_nav2} if len(of_nav2) >= _LEAST_GROUPED else frozenset[str]()
    alone = [row for row in visible if row.topic_name not in grouped]
    # A recording knows the publishers, but neither nodes nor subscribers.
    without_subscribers = [row.topic_name for row in alone if graph.nodes and row.publishers and not row.subscribers]
    without_publishers = [row.topic_name for row in alone if row.subscribers and not row.publishers]
    return Health(
        verdict="HEALTHY" if not findings else "CRITICAL" if findings[0].severity == "critical" else "DEGRADED",
        findings=findings[:MAX_FINDINGS],
        topics=in_full[:MAX_ROWS],
        other_topics={
            **{row.topic_name: _state_in_words(row) for row in alone[len(in_full) : MAX_ROWS]},
            **({f"{len(of_nav2)} topics that only Nav2 publishes": _states_in_words(of_nav2)} if grouped else {}),
        },
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
    """Return for each expected name whether it is present; UNKNOWN if that is not recorded."""
    if present is None:
        return dict.fromkeys(expected, "UNKNOWN")
    return {name: "OK" if name in present else "MISSING" for name in expected}


def to_measure(graph: GraphSnapshot, expected: Expectations) -> tuple[list[str], list[str]]:
    """Return the topics to measure (expected topics first, then others within the limits), and the omitted topics."""

    def is_measurable(topic: TopicEndpoints) -> bool:
        is_own = topic.topic in OF_EVERY_NODE or names.is_hidden(topic.topic)
        return bool(topic.publishers) and len(topic.types) == 1 and not is_own

    first = [name for name in expected.topics if name in graph.topics and graph.topics[name].publishers]
    others = [name for name in sorted(graph.topics) if name not in first and is_measurable(graph.topics[name])]
    others.sort(key=lambda name: not streams(graph.topics[name]))
    large = [name for name in others if LARGE_TYPES.intersection(graph.topics[name].types)]
    chosen = [*first, *(name for name in others if name not in large[MAX_LARGE:])]
    return chosen[:MAX_MEASURED], [*large[MAX_LARGE:], *chosen[MAX_MEASURED:]]


def flow(capture: Capture[AgedArrivals]) -> Flow:
    """Return the flow of a capture: its rate, the highest rate that its longest silence allows, and its
    interruption.
    """
    import numpy as np

    kept, holes = capture.kept, capture.holes
    end_ns = capture.end_ns if kept.all_kept else kept.last_ns
    bounded = np.sort(np.concatenate((kept.times_ns, np.array([capture.start_ns, end_ns], np.int64))))
    longest_s = float(periods_s(bounded, holes).max(initial=0.0))
    if not kept.all_kept:  # only times of the beginning are kept, which `_bounds` reports
        end_ns = int(kept.times_ns[-1]) if len(kept.times_ns) else capture.start_ns
    silence = silence_in(kept.times_ns, end_ns, STOPPED_PERIODS, STOPPED_S, holes)
    rate = kept.rate_hz(holes)
    if is_burst(kept.count, rate, capture.duration_s):
        rate = None
    until_ns = 0 if kept.all_kept else max(end_ns, 1)
    return Flow(
        kept.count,
        rate,
        1 / longest_s if longest_s > 0 else 0.0,
        silence,
        kept.ages,
        zero_ns=capture.zero_ns,
        until_ns=until_ns,
        replayed=kept.replayed,
        replayed_s=max((capture.end_ns - kept.replayed_ns) / 1e9, 0.0) if kept.replayed_ns else None,
        duration_s=capture.duration_s,
    )


def _state_in_words(row: TopicRow) -> str:
    if row.from_before:
        return f"{row.state}, {row.from_before}"
    return row.state if row.rate_hz is None else f"{row.state}, {row.rate_hz:g} Hz"


def _states_in_words(rows: Sequence[TopicRow]) -> str:
    counts = Counter(row.state for row in rows)
    return ", ".join(f"{count} {state}" for state, count in counts.most_common())


def _row(graph: GraphSnapshot, name: str, flows: Mapping[str, Flow], expected: Expectations) -> TopicRow:
    topic, measured = graph.topics.get(name, TopicEndpoints(name, (), ())), flows.get(name)
    is_expected = name in expected.topics
    is_stream = is_expected or streams(topic) or (name in graph.ran and not _FOR_A_WHILE.intersection(topic.types))
    is_kept = is_latched(topic) and not STEADY_TYPES.intersection(topic.types)
    state: State = "OK"
    if is_expected and not topic.publishers:
        state = "MISSING"
    elif measured is None:
        state = "NOT MEASURED"
    elif not measured.count and is_kept and measured.replayed:
        state = "OK"
    elif not measured.count:
        state = "SILENT" if is_stream or _is_late(graph, topic, flows) else "QUIET"
    elif is_stream and not is_kept:
        highest_hz = measured.most_hz if measured.rate_hz is None else measured.rate_hz
        if measured.silence:
            state = "STOPPED" if measured.silence.is_end else "INTERRUPTED"
        elif highest_hz < RATE_TOLERANCE * expected.min_rate_hz and (is_expected or streams(topic)):
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
        from_before=measured.from_before if measured else "",
    )


def _is_late(graph: GraphSnapshot, topic: TopicEndpoints, flows: Mapping[str, Flow]) -> bool:
    """Return whether a topic of a type published at 1 Hz or more was silent for too long.

    A state publisher with only fixed joints is no fault: it has a publisher on /tf, and sends on /tf_static.
    """
    if not ONCE_A_SECOND.intersection(topic.types) or is_latched(topic):
        return False
    if flows[topic.topic].duration_s < LEAST_LISTENED_S:
        return False
    static = f"{topic.topic.removesuffix(TF)}{TF_STATIC}"
    present, heard = graph.topics.get(static), flows.get(static)
    if not topic.topic.endswith(TF) or present is None or heard is None:
        return True
    fixed = {one.node for one in present.publishers} if heard.count or heard.replayed else set[str]()
    return not {one.node for one in topic.publishers} <= fixed


class _Statuses:
    """The diagnostics received, and a note on messages that could not be decoded."""

    def __init__(self, stream: Stream, began_ns: int | None) -> None:
        self.table = DiagnosticTable(began_ns)
        self._stream = stream
        self._undecodable = 0
        self._first_trouble = ""

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages, in the order of time; messages of other types are ignored."""
        for sample in samples if self._stream.type == _DIAGNOSTICS_TYPE else ():
            try:
                self.table.add(self._stream.codec.decode(self._stream.type, sample.data), sample.received_ns)
            except BadData as error:
                self._undecodable += 1
                self._first_trouble = self._first_trouble or str(error)

    @property
    def trouble(self) -> str:
        return f"{DIAGNOSTICS}: {undecodable(self._undecodable, self._first_trouble)}" if self._undecodable else ""


def _note(graph: GraphSnapshot, skipped: Sequence[str], failed: Sequence[Missing], *, is_live: bool) -> str:
    notes = [] if graph.settled else ["Discovery had not settled. Ask again."]
    if skipped:
        names_of = listed(skipped, _MAX_SKIPPED)
        why = "to limit the load on the robot" if is_live else "as there are many, or they are large"
        notes.append(f"Not measured, {why}: {names_of}. Name topics in expected_topics to measure them.")
    if graph.nodes is None or graph.services is None:
        notes.append("A recording does not say which nodes and services ran.")
    others = [missing for missing in failed if not isinstance(missing.error, UnknownInterface)]
    if others:
        errors = "; ".join(f"{named(missing.topic)}: {missing.error}" for missing in others[:_MAX_FAILED])
        notes.append(f"Not measured because of errors: {errors}")
    return " ".join(notes)


def _bounds(flows: Mapping[str, Flow]) -> str:
    """Report the time up to which silences were searched, for topics where that is not the end."""
    cut = [f"{name} up to {both_times(flow.until_ns, flow.zero_ns)}" for name, flow in flows.items() if flow.until_ns]
    return f"Silences were searched only in: {', '.join(cut)}; later times did not fit in memory." if cut else ""
