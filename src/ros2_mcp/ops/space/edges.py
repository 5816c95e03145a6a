"""The edges of the frame tree as results show them: who tells each, how often, and when last."""

from __future__ import annotations

from dataclasses import dataclass

from ros2_mcp.codec.frame_edges import Edge
from ros2_mcp.codec.no_transform import UNIX_FROM_NS, seconds_in_words
from ros2_mcp.codec.transforms import OTHER_CLOCK_NS, FrameTree
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.results import four_digits, microseconds
from ros2_mcp.ops.space.tellers import Tellers

_PERIODS = 5.0
"""An edge that was last told so many of its usual periods ago has stopped."""
_LEAST_STALE_NS = 1_000_000_000
"""The slowest usual publishers tell an edge once a second, and a busy machine makes pauses."""
_IN_TURN = 3
"""Jumps of the stamps: a clock that is set jumps once, a bag in a loop not while another publisher tells the edge."""
_FROZEN = 10
"""Messages in a row with a stamp that was there already; nobody resends as often on purpose."""
_SAME_M, _SAME_DEG = 1e-3, 0.1
"""What two publishers tell is the same up to there: the rounding of float32, and of a description."""
_RARELY_HZ = 1 / 1.5
"""The slowest usual publishers of what moves send once a second."""
_AHEAD_NS = 2_500_000_000
"""Localisations stamp up to 1 s ahead, on purpose (`transform_tolerance`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeRow:
    """One edge: where `child` is in `parent`. `age_s` is how long before the time of the answer it was last told (null
    for a static one, which holds for all times), `rate_hz` how often it is. `publisher` is the node that tells it:
    `probably …` where several publish and it is concluded, `one of …` where that is not known; empty in a recording,
    which does not keep it.
    """

    parent: str
    child: str
    is_static: bool
    publisher: str = ""
    rate_hz: float | None = None
    age_s: float | None = None
    problem: str = ""

    def words(self) -> str:
        """It in brackets, behind a name."""
        told = [] if self.is_static else [f"{self.rate_hz:.3g} Hz" if self.rate_hz else "told once"]
        told = ["static"] if self.is_static else told
        if self.age_s is not None:
            told.append(f"{seconds_in_words(round(self.age_s * 1e9))} old")
        if self.publisher:
            told.append(self.publisher)
        return ", ".join(told)


def edge_row(
    tree: FrameTree, edge: Edge, at_ns: int, tellers: Tellers | None = None, *, time_stands: bool = False
) -> EdgeRow:
    """An edge as it is at a time by the receiver's clock; `time_stands`: all stamps stand still, which is said once and
    not of each.
    """
    newest = edge.newest
    age_ns = max(at_ns - edge.stamps[-1] - tree.clock_ns, 0) if edge.moving else None
    is_other_clock = bool(edge.moving) and abs(edge.lag_ns - tree.clock_ns) > OTHER_CLOCK_NS
    if is_other_clock:  # its stamps say nothing about its age
        age_ns = max(at_ns - edge.last_received_ns, 0)
    is_with_others = edge.moving and tree.advanced_ns - edge.moving[-1].received_ns <= _LEAST_STALE_NS
    if edge.unstamped and not edge.moving:
        age_ns = max(at_ns - edge.last_received_ns, 0)
    publisher = tellers.of(edge) if tellers else ""
    return EdgeRow(
        parent=newest.parent if newest else edge.refused_parent,
        child=edge.child,
        is_static=edge.is_static or (newest is None and edge.on_static),
        publisher=publisher,
        rate_hz=four_digits(edge.rate_hz),
        age_s=None if age_ns is None else microseconds(age_ns / 1e9),
        problem="; ".join(
            [
                *_who_tells(edge, tellers),
                *_how_told(edge, at_ns),
                *_leaps(edge, at_ns),
                *(
                    ()
                    if time_stands and is_with_others
                    else _when_told(tree, edge, at_ns, publisher, is_other_clock=is_other_clock)
                ),
            ]
        ),
    )


def in_words(row: EdgeRow) -> str:
    """What is wrong with an edge, as a sentence."""
    edge = f"{named(row.parent)} → {named(row.child)}" if row.parent else named(row.child)
    return f"{edge} {row.problem}."


def _who_tells(edge: Edge, tellers: Tellers | None) -> list[str]:
    """Whether several tell it, and how far what they tell is apart."""
    parts: list[str] = []
    if edge.two_parents:
        parents = [f"{named(one)}{tellers.by_whom(edge, one) if tellers else ''}" for one in edge.parents]
        parts.append(f"has two parents at the same time: {' and '.join(parents)}")
    if len(edge.writers) > 1 and not edge.two_parents:
        who = tellers.of(edge) if tellers else ""
        parts.append(f"is told by several publishers{f' ({who})' if who else ''}, so that it may jump between them")
    if (apart := edge.apart) and (apart[0] > _SAME_M or apart[1] > _SAME_DEG):
        where = "" if len(edge.writers) > 1 else "is told differently by two publishers, or by one that began again: "
        parts.append(f"{where}what they tell is {apart[0]:.3g} m and {apart[1]:.3g}° apart")
    return parts


def _how_told(edge: Edge, at_ns: int) -> list[str]:
    """What is wrong with its messages, whenever they came."""
    parts: list[str] = []
    if edge.refused:
        parts.append(f"is refused: {edge.refused}")
    if edge.unstamped:
        parts.append("has no stamp (header.stamp is 0: not set, or use_sim_time without a /clock)")
    if edge.slashed:
        parts.append(f"is told with a leading slash ({quoted(edge.slashed)}): tf2 has no such names, and takes it off")
    if edge.jumps:
        last = edge.jumps[-1]
        step = f"{'back' if last.to_ns < last.from_ns else 'forward'} by {seconds_in_words(last.to_ns - last.from_ns)}"
        times = f", the last of {len(edge.jumps)} jumps" if len(edge.jumps) > 1 else ""
        cause = "its clock was set, or a bag or simulation restarted"
        if len(edge.writers) > 1 and len(edge.jumps) > _IN_TURN:
            cause = "its publishers stamp by two clocks, in turn: a bag is played beside the robot?"
        ago = seconds_in_words(max(at_ns - last.received_ns, 0))
        parts.append(f"had its stamps jump {step}, {ago} ago{times} ({cause})")
    if edge.static and edge.moving:
        parts.append("is told on /tf and on /tf_static")
    return parts


def _leaps(edge: Edge, at_ns: int) -> list[str]:
    """Whether it went suddenly to another place; a localisation may once, when it finds where it is."""
    leaps, corrects = edge.leaps, edge.child.rpartition("/")[2] == "odom"
    if not leaps or (corrects and len(leaps) == 1):
        return []
    last = leaps[-1]
    many = f", the last of {len(leaps)} such jumps" if len(leaps) > 1 else ""
    ago = seconds_in_words(max(at_ns - last.received_ns, 0))
    what = "odometry" if edge.newest and edge.newest.parent.rpartition("/")[2] == "odom" else "its source"
    cause = "a localisation that changes its mind" if corrects else f"{what} was reset, or is at fault"
    return [
        f"jumped by {last.far_m:.3g} m and {last.turned_deg:.3g}° within {seconds_in_words(last.within_ns)}, {ago} "
        f"ago{many} ({cause})"
    ]


def _when_told(tree: FrameTree, edge: Edge, at_ns: int, publisher: str, *, is_other_clock: bool) -> list[str]:
    """Whether it is late, silent or early, by its stamps and by when it came."""
    if not edge.moving:
        return []
    silent_ns = at_ns - edge.last_received_ns
    age_ns, ahead_ns = at_ns - edge.stamps[-1] - tree.clock_ns, tree.clock_ns - edge.lag_ns
    limit_ns = max(_LEAST_STALE_NS, _PERIODS * (1e9 / edge.rate_hz if edge.rate_hz else 0))
    parts: list[str] = []
    if is_other_clock:
        away = f"{seconds_in_words(edge.lag_ns)} {'behind' if edge.lag_ns > 0 else 'ahead of'} the robot's clock"
        clock = "simulated time" if edge.stamps[-1] < UNIX_FROM_NS else "another clock"
        parts.append(f"is stamped by {clock}, {away}, unlike the others")
        age_ns = silent_ns
    if age_ns > limit_ns:
        by = f", by {publisher}" if publisher else ""
        if edge.received == 1:
            rarely = "too rarely for what moves; what does not move belongs on /tf_static"
            parts.append(f"was told once, {seconds_in_words(age_ns)} ago{by}: {rarely}")
        elif silent_ns > limit_ns:
            usual = f", after {edge.rate_hz:.3g} Hz" if edge.rate_hz else ""
            parts.append(f"is stale: last told {seconds_in_words(age_ns)} ago{usual}{by}")
        elif edge.frozen > _FROZEN:
            again = f"the same stamp again and again, now {seconds_in_words(age_ns)} old"
            parts.append(f"is told now with {again}: tf2 ignores what repeats")
        else:
            old = f"stamps that are {seconds_in_words(age_ns)} old"
            parts.append(f"is told now with {old}: a delay, or the clock of another computer")
    elif edge.rate_hz and edge.rate_hz < _RARELY_HZ:
        every = f"every {1 / edge.rate_hz:.3g} s ({edge.rate_hz:.2g} Hz)"
        parts.append(f"is told too rarely for what moves, {every}: what is looked up is as old, and not there for now")
    if ahead_ns > _AHEAD_NS and not is_other_clock:
        parts.append(
            f"is stamped {seconds_in_words(ahead_ns)} ahead, in the future (by the clock of another computer?)"
        )
    return parts
