"""The edges of the frame tree as shown in results: publisher, rate, age and problems of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.results.results import HIDDEN, four_digits, microseconds
from ros2_mcp.ops.space.tellers import GONE, Tellers
from ros2_mcp.robot.transforms import TF, TF_STATIC
from ros2_mcp.world.frame_edges import Edge
from ros2_mcp.world.no_transform import UNIX_FROM_NS, is_since_boot, seconds_in_words
from ros2_mcp.world.transforms import OTHER_CLOCK_NS, FrameTree

_PERIODS = 5.0
"""An edge is stale if it was last published longer ago than this many of its usual periods …"""
_LEAST_STALE_NS = 1_000_000_000
"""… and longer ago than this: the slowest usual publishers send once a second, and a busy machine makes pauses."""
_IN_TURN = 3
"""More stamp jumps than this, with several publishers, mean two clocks: a clock that is set jumps once, and a looped
bag has no second publisher."""
_FROZEN = 10
"""More messages in a row than this with a repeated stamp are a fault; no publisher resends that often on purpose."""
_SAME_M, _SAME_DEG = 1e-3, 0.1
"""Transforms of two publishers that differ by less are equal: it is the rounding of float32 and of URDF values."""
_RARELY_HZ = 1 / 1.5
"""A moving edge below this rate is reported as too slow: the slowest usual publishers send once a second."""
_AHEAD_NS = 2_500_000_000
"""Stamps further ahead than this are reported: localisation nodes stamp up to 1 s ahead on purpose
(`transform_tolerance`)."""
_NOW_S = -5e-4
"""An age below this is reported as stamped ahead: smaller differences are within the accuracy of synchronised
clocks."""
_LATE_PAUSES = 2
"""An edge published in bursts is stale after this many of its usual pauses without a message."""
_STALE, _PROBABLY = "is stale", "probably "
_MOST_EDGES = 4
"""The most stale edges named in one sentence; the tree marks all of them."""
_TWO_PARENTS, _ON_BOTH = "has two parents at the same time", f"is published on {TF}"


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeRow:
    """One edge: the pose of `child` in `parent`. `age_s` is its age at the time of the answer (null for a static
    edge, which holds at all times; below 0 if it is stamped ahead). `rate_hz` is its rate by its stamps. `publisher` is
    the node that publishes it: `probably …` if that is concluded among several publishers, `one of …` if it is not
    known; empty in a recording, which does not hold the publishers.
    """

    parent: str
    child: str
    is_static: bool
    publisher: str = ""
    rate_hz: float | None = None
    age_s: float | None = None
    problem: str = ""
    stale_s: float | None = field(default=None, metadata=HIDDEN)
    """Age in s if staleness is the only problem: stale edges of one publisher are reported together."""
    of: str = field(default="", metadata=HIDDEN)
    """The one node that publishes the edge, if it is known."""

    def words(self) -> str:
        """Return rate, age and publisher, to be put in brackets after a name."""
        told = [] if self.is_static else [f"{self.rate_hz:.3g} Hz" if self.rate_hz else "published once"]
        told = ["static"] if self.is_static else told
        if self.age_s is not None:
            told.append(age_in_words(self.age_s))
        if self.publisher:
            told.append(self.publisher)
        return ", ".join(told)


def age_in_words(age_s: float) -> str:
    """Return an age in words; a negative one means a stamp ahead of the clock."""
    said = seconds_in_words(round(age_s * 1e9))
    return f"stamped {said} ahead" if age_s < _NOW_S else f"{said if age_s > 0 else '0 ms'} old"


def edge_row(
    tree: FrameTree,
    edge: Edge,
    at_ns: int,
    tellers: Tellers | None = None,
    *,
    time_stands: bool = False,
    is_within: bool = False,
) -> EdgeRow:
    """Return the row of an edge at `at_ns`, a time of the receiver's clock.

    `time_stands`: no stamp in the tree advances; that is reported once, not for each edge. `is_within`: `at_ns` is a
    time inside a recording, which continues after it.
    """
    newest = edge.newest
    age_ns = at_ns - edge.stamps[-1] - tree.clock_ns if edge.moving else None
    if edge.moving and is_within:
        age_ns = edge.age_ns(at_ns - tree.clock_ns)
    is_other_clock = bool(edge.moving) and abs(edge.lag_ns - tree.clock_ns) > OTHER_CLOCK_NS
    if is_other_clock or (edge.unstamped and not edge.moving):  # the stamps say nothing about the age
        age_ns = max(at_ns - edge.last_received_ns, 0)
    is_with_others = edge.moving and tree.advanced_ns - edge.moving[-1].received_ns <= _LEAST_STALE_NS
    publisher = tellers.of(edge) if tellers else ""
    problems = [*_who_tells(tree, edge, tellers), *_how_told(edge, at_ns, publisher), *_leaps(edge, at_ns)]
    stale = ""
    if not (time_stands and is_with_others):
        late = _when_told(tree, edge, at_ns, publisher, is_other_clock=is_other_clock)
        stale = next((part for part in late if part.startswith(_STALE)), "") if not problems and len(late) == 1 else ""
        problems += late
    return EdgeRow(
        parent=newest.parent if newest else edge.refused_parent,
        child=edge.child,
        is_static=edge.is_static or (newest is None and edge.on_static),
        publisher=publisher,
        rate_hz=four_digits(edge.rate_hz),
        age_s=None if age_ns is None else microseconds(age_ns / 1e9),
        problem="; ".join(problems),
        stale_s=age_ns / 1e9 if stale and age_ns is not None else None,
        of=publisher.removeprefix(_PROBABLY).removesuffix(GONE) if _is_one(publisher) else "",
    )


def _is_one(publisher: str) -> bool:
    return bool(publisher) and not publisher.startswith("one of") and " and " not in publisher


def stale_in_words(rows: Sequence[EdgeRow]) -> str:
    """Return one sentence for all stale edges of one publisher."""
    youngest, publisher = min(row.stale_s or 0.0 for row in rows), rows[0].publisher
    edges = [f"{named(row.parent)} → {named(row.child)}" for row in rows]
    more = f" and {len(edges) - _MOST_EDGES} more" if len(edges) > _MOST_EDGES else ""
    by = f" by {publisher}" if publisher else ""
    still = ", which is still in the graph but no longer publishes them" if _is_one(publisher) else ""
    still = "" if GONE in publisher else still
    since = seconds_in_words(round(youngest * 1e9))
    return f"{len(rows)} edges{by} are stale since {since}{still}: {', '.join(edges[:_MOST_EDGES])}{more}."


def in_words(row: EdgeRow) -> str:
    """Return the problem of an edge as a sentence. Its subject is the frame, not the edge, if the frame has two parents
    or the edge has none.
    """
    is_of_frame = row.problem.startswith((_TWO_PARENTS, _ON_BOTH)) or not row.parent
    edge = named(row.child) if is_of_frame else f"{named(row.parent)} → {named(row.child)}"
    return f"{edge} {row.problem}."


def _who_tells(tree: FrameTree, edge: Edge, tellers: Tellers | None) -> list[str]:
    """Return the problems with the edge's publishers: two parents, several publishers, and how far their transforms
    differ.
    """
    parts: list[str] = []
    if edge.two_parents:
        parents = [f"{named(one)}{tellers.by_whom(edge, one) if tellers else ''}" for one in edge.parents]
        circle = tree.circle_by(edge.child)
        wrong = f"; {named(circle[1])} closes a loop" if len(circle) > 1 else ""
        parts.append(f"{_TWO_PARENTS}: {' and '.join(parents)}{wrong}")
    if edge.on_both:
        parent = edge.moving[-1].parent
        who = [tellers.on(topic, edge, parent) if tellers else "" for topic in (TF, TF_STATIC)]
        moving, static = (f" by {one}" if one else "" for one in who)
        parts.append(f"{_ON_BOTH}{moving} and on {TF_STATIC}{static} alike, in {named(parent)} both times")
    is_told_twice = len(edge.writers) > 1 and not edge.two_parents
    if is_told_twice:
        who = tellers.of(edge) if tellers else ""
        parts.append(f"is published by several nodes{f' ({who})' if who else ''}, so it may jump between them")
    if (apart := edge.apart) and (apart[0] > _SAME_M or apart[1] > _SAME_DEG):
        is_said = len(edge.writers) > 1 or edge.on_both
        where = "" if is_said else "is published differently by two nodes, or by one that restarted: "
        far, turned = (0 if size <= least else size for size, least in zip(apart, (_SAME_M, _SAME_DEG), strict=True))
        parts.append(f"{where}their transforms are {far:.3g} m and {turned:.3g}° apart")
    if edge.on_both:
        parts.append("listeners take it as fixed or moving, whichever came first: end one of the two publishers")
    return parts


def _how_told(edge: Edge, at_ns: int, publisher: str) -> list[str]:
    """Return the problems with the edge's messages: refused values, missing stamps, a leading slash, jumps of the
    stamps.
    """
    parts: list[str] = []
    by = f", by {publisher}" if publisher else ""
    if edge.refused and _is_refused_since(edge):
        good = at_ns - edge.last_received_ns
        last = f"; the last valid one came {seconds_in_words(good)} ago" if edge.newest else ""
        parts.append(f"is refused: {edge.refused}{last}{by}")
    elif edge.refused:
        parts.append(f"is refused: {edge.refused}")
    if edge.is_left and edge.is_static:
        who = f" ({publisher})" if publisher else ""
        parts.append(f"is static, and its publisher has left{who}: nodes that start from now on do not get this frame")
    if edge.unstamped:
        parts.append("has no stamp (header.stamp is 0: not set, or use_sim_time without a /clock)")
    if edge.slashed:
        parts.append(
            f"is published with a leading slash ({quoted(edge.slashed)}): tf2 removes the slash here, but rejects such "
            "a name in a lookup"
        )
    if edge.jumps:
        last = edge.jumps[-1]
        step = f"{'back' if last.to_ns < last.from_ns else 'forward'} by {seconds_in_words(last.to_ns - last.from_ns)}"
        times = _first_of([jump.received_ns for jump in edge.jumps], "jumps", at_ns)
        cause = "its clock was set, or a bag or simulation restarted"
        if len(edge.writers) > 1 and len(edge.jumps) > _IN_TURN:
            cause = "its publishers use two clocks: is a bag played while the robot runs?"
        ago = seconds_in_words(max(at_ns - last.received_ns, 0))
        parts.append(f"has stamps that jumped {step}, {ago} ago{times} ({cause})")
    return parts


def _first_of(received_ns: Sequence[int], what: str, at_ns: int) -> str:
    """Return the number of events and the age of the first, to be put after the age of the last; empty if there is only
    one event.
    """
    if len(received_ns) < 2:
        return ""
    first = seconds_in_words(max(at_ns - received_ns[0], 0))
    return f", the last of {len(received_ns)} {what}, the first {first} ago"


def _is_refused_since(edge: Edge) -> bool:
    """Return whether every message since the last valid message was refused."""
    return edge.refused_ns >= edge.last_received_ns


def _leaps(edge: Edge, at_ns: int) -> list[str]:
    """Return the sudden jumps of the transform. A single jump of odom is no problem: it is a localisation that found
    its pose.
    """
    leaps, corrects = edge.leaps, edge.child.rpartition("/")[2] == "odom"
    if not leaps or (corrects and len(leaps) == 1):
        return []
    last = leaps[-1]
    turned = last.turned_deg if last.turned_deg > _SAME_DEG else 0
    many = _first_of([leap.received_ns for leap in leaps], "such jumps", at_ns)
    ago = seconds_in_words(max(at_ns - last.received_ns, 0))
    what = "odometry" if edge.newest and edge.newest.parent.rpartition("/")[2] == "odom" else "its source"
    cause = "the localisation corrected itself" if corrects else f"{what} was reset, or is at fault"
    return [
        f"jumped by {last.far_m:.3g} m and {turned:.3g}° within {seconds_in_words(last.within_ns)}, {ago} "
        f"ago{many} ({cause})"
    ]


def _when_told(tree: FrameTree, edge: Edge, at_ns: int, publisher: str, *, is_other_clock: bool) -> list[str]:
    """Return the problems with the edge's timing (stale, delayed, slow, in bursts, ahead), from stamps and times of
    receipt.
    """
    if not edge.moving:
        return []
    silent_ns = at_ns - edge.last_received_ns
    # The age of an edge that is stamped ahead, as by AMCL, is counted from its receipt.
    age_ns, ahead_ns = max(at_ns - edge.stamps[-1] - tree.clock_ns, silent_ns), tree.clock_ns - edge.lag_ns
    # The rate of receipt is below that of the stamps on a slow simulation, and above it in bursts.
    slowest_hz = min(filter(None, (edge.rate_hz, edge.received_hz)), default=0.0)
    limit_ns = max(_LEAST_STALE_NS, _PERIODS * (1e9 / slowest_hz if slowest_hz else 0))
    by = f", by {publisher}" if publisher else ""
    parts: list[str] = []
    if is_other_clock:
        parts.append(_other_clock(tree, edge, publisher))
        age_ns = silent_ns
    if bursts := edge.bursts:
        limit_ns = max(limit_ns, _LATE_PAUSES * bursts.pause_ns)
        pause = f"about {bursts.pause_ns / 1e9:.2g} s"
        parts.append(
            f"comes in bursts{by}: about {bursts.count} messages at once, then a pause of {pause}: a lookup is up to "
            f"{pause} late, whatever the stamps say"
        )
    if age_ns > limit_ns and not (edge.refused and _is_refused_since(edge)):
        if edge.received == 1:
            rarely = "too rarely for a moving frame; a fixed frame belongs on /tf_static"
            parts.append(f"was published once, {seconds_in_words(age_ns)} ago{by}: {rarely}")
        elif silent_ns > limit_ns:
            usual = f", after {edge.rate_hz:.3g} Hz" if edge.rate_hz else ""
            is_one = publisher and GONE not in publisher and not publisher.startswith("one of")
            still = ", which is still in the graph but no longer publishes it" if is_one else ""
            parts.append(f"{_STALE}: last published {seconds_in_words(age_ns)} ago{usual}{by}{still}")
        elif edge.frozen > _FROZEN:
            again = f"the same stamp again and again, now {seconds_in_words(age_ns)} old"
            parts.append(f"is published now with {again}: tf2 ignores repeated stamps")
        else:
            old = f"stamps that are {seconds_in_words(age_ns)} old"
            parts.append(f"is published now with {old}: a delay, or the clock of another computer")
    elif edge.rate_hz and edge.rate_hz < _RARELY_HZ:
        every = f"every {1 / edge.rate_hz:.3g} s ({edge.rate_hz:.2g} Hz)"
        late = "a lookup is that old, and fails for the present time"
        parts.append(f"is published too rarely for a moving frame, {every}: {late}")
    if ahead_ns > _AHEAD_NS and not is_other_clock:
        parts.append(
            f"is stamped {seconds_in_words(ahead_ns)} ahead, in the future (by the clock of another computer?)"
        )
    return parts


def _other_clock(tree: FrameTree, edge: Edge, publisher: str) -> str:
    """Describe which clock the edge's stamps come from, unlike the other edges' stamps, and the likely cause."""
    away = f"{seconds_in_words(edge.lag_ns)} {'behind' if edge.lag_ns > 0 else 'ahead of'} the robot's clock"
    if tree.clock_ns and abs(edge.lag_ns) < OTHER_CLOCK_NS:
        others = "simulated time" if tree.has_clock else "another time (simulated, or a bag that is played)"
        where = f" at {publisher}" if publisher else ""
        return f"is stamped by the robot's clock (wall time), the others by {others}: use_sim_time is not set{where}"
    if is_since_boot(tree, edge):
        return (
            f"is stamped {edge.stamps[-1] / 1e9:.0f} s into 1970, {away}: the time since its machine started, "
            "which is not synchronised (/clock has no publisher, so it is not simulated time)"
        )
    clock = "simulated time" if edge.stamps[-1] < UNIX_FROM_NS else "another clock"
    return f"is stamped by {clock}, {away}, unlike the others"
