"""The frame tree as text and as a picture, with the health of each edge."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import NotFound, NoTransform
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.pictures import BOUNDS, Picture
from ros2_mcp.model.text import counted, is_name, named
from ros2_mcp.ops.results.results import HIDDEN, IF_ANY, SAID, Report, WithPictures, facts, reporting, silent
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.edges import EdgeRow, edge_row, in_words, stale_in_words
from ros2_mcp.ops.space.frames import disputed_roots, frames_of, separate_roots
from ros2_mcp.ops.space.standing_time import look_for_clock, other_clock, standing_time
from ros2_mcp.ops.space.tellers import Tellers, silent_in_words, tellers_of
from ros2_mcp.ops.space.unheard import followed_in_words, unheard_publishers
from ros2_mcp.world.no_transform import circle_in_words, edge_in_words, seconds_in_words, stamp_in_words
from ros2_mcp.world.transforms import FrameTree

_MOST_LINES = 150
"""The most lines of the text: the largest robots have that many frames, and a result is limited to 12 kB."""

_AGAIN_NS = 4_000_000_000
"""Time to wait for the second message of an edge, without which its rate is not known, and for the first message of a
publisher, which may be discovered late."""

_LEAST_GAP_NS, _GAP_PERIODS = 2_000_000_000, 10
"""A gap in a recording is reported from this length and number of usual periods on: a busy machine causes shorter gaps,
and an edge published irregularly has many.
"""

_LOOK_S = 0.2
"""Interval at which silent publishers are checked again."""

_MOST_DRAWN = 80
"""The most characters of a name in the picture: a longer one makes it too wide to read."""


@dataclass(frozen=True, slots=True)
class FrameProblem:
    """A problem of frames, in a sentence; `publisher` is the node responsible, if it is known."""

    problem: str
    publisher: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tree(WithPictures):
    """All frames as a tree. With more than one of `roots` there are several trees, without a transform between them.
    `edges` lists parents before their children. `problems` has a sentence for each problem; without any the tree is
    healthy.
    """

    frames: int = field(metadata=SAID)
    roots: Sequence[str] = field(metadata=SAID)
    edges: Sequence[EdgeRow] = field(metadata=SAID)
    problems: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    read_from: str
    note: str = ""
    lines: Sequence[str] = field(default=(), metadata=HIDDEN)
    found: Sequence[FrameProblem] = field(default=(), metadata=HIDDEN)
    disputed: int = field(default=0, metadata=HIDDEN)
    """The number of roots that are separate only because a frame has two parents."""

    def summary(self) -> list[str]:
        """Return the problems, then the tree."""
        count = len(self.roots) - self.disputed
        trees = f"{count} trees" if count != 1 else "one tree"
        health = counted(len(self.problems), "problem") if self.problems else "healthy"
        more = len(self.lines) - _MOST_LINES
        left_out = [f"… and {more} more frames: give one as frame to see what is below it."] if more > 0 else []
        lines = [f"{self.frames} frames in {trees}, {health}.", *self.problems, *self.lines[:_MOST_LINES], *left_out]
        return [*lines, *([self.note] if self.note else [])]


async def tf_tree(
    source: Source, frame: str = "", duration_s: float = 2.0, *, picture: bool = True, report: Report = silent
) -> Tree:
    """Return the frame tree, or the part below `frame`. Live, listen for `duration_s` so that rates are known, and up
    to 4 s longer for an edge received only once.
    Raises:
        NoTransform: if no transform was received.
        NotFound: if there is no frame of that name.
        UnknownInterface, LinkError: as `frames_of`.
    """
    tree = await _listened(source, duration_s, report)
    unheard = await unheard_publishers(source)
    tellers = await _heard_out(source, tree, duration_s)
    wrong, harmless = (_silent(source, tellers, harmless=which) for which in (False, True))
    if not tree.frames:
        absence = (await source.graph()).absence
        found = [*unheard, *wrong, *harmless, *([absence] if absence else [])]
        said = " ".join(found) or "Nothing was received on /tf or /tf_static."
        raise NoTransform("never published", f"No transform has been received. {said}")
    top = frame.strip().lstrip("/")
    if top and top not in tree.frames:
        raise NotFound(f"No transform names the frame {named(top)}.", did_you_mean(top, list(tree.frames)))
    listener, covers = source.transforms, source.covers_ns
    at_ns = listener.now_ns() if listener else covers[1] if covers else _newest_ns(tree)
    await look_for_clock(source, tree)
    stands = await standing_time(source, tree, at_ns)
    said = [*_note(tree), *await other_clock(source, tree), *followed_in_words(source, tree), *harmless]
    rows = {child: edge_row(tree, edge, at_ns, tellers, time_stands=bool(stands)) for child, edge in tree.edges.items()}
    walk = list(_walk(tree, [top] if top else tree.roots))
    lines = [_line(name, depth, rows.get(name)) for name, depth in walk]
    found = [
        *(FrameProblem(problem) for problem in (*unheard, *wrong, *filter(None, [stands]))),
        *_problems(tree, rows, [name for name, _ in walk], tellers, whole=not top),
        *(FrameProblem(problem) for problem in _gaps(source, tree, walk)),
    ]
    images = [await asyncio.to_thread(_picture, walk, rows)] if picture else []
    return Tree(
        frames=len(walk),
        roots=[top] if top else tree.roots,
        edges=[rows[name] for name, _ in walk if name in rows],
        problems=[one.problem for one in found],
        found=found,
        read_from="live" if source.is_live else source.words,
        note=" ".join(said),
        lines=lines,
        disputed=0 if top else len(disputed_roots(tree)),
        pictures=facts(images),
        images=images,
    )


async def _listened(source: Source, duration_s: float, report: Report) -> FrameTree:
    if (listener := source.transforms) is None:
        return await frames_of(source, report=report)
    await load("ros2_mcp.pictures.plot")  # with numpy: not before it is needed
    tree = await listener.listening()
    deadline = monotonic() + duration_s
    async with reporting(report, duration_s, lambda: f"{len(tree.frames)} frames"):
        # The rate of an edge published once a second needs more than two messages.
        while (left_s := deadline - monotonic()) > 0 and (monotonic() - (listener.since or 0.0)) < duration_s:
            await listener.news(left_s)
        if not tree.frames:
            tree = await frames_of(source, until=lambda tree: bool(tree.frames))
        while duration_s and listener.tree is tree and (left_ns := _once_ns(tree, listener.now_ns())) > 0:
            await listener.news(left_ns / 1e9)
    return tree


async def _heard_out(source: Source, tree: FrameTree, duration_s: float) -> Tellers:
    """Return the publishers of the edges; listen a little longer for publishers that are silent so far, as they may be
    discovered late.
    """
    tellers = await tellers_of(source, tree)
    listener = source.transforms
    while listener and duration_s and listener.tree is tree and tellers.is_silent:
        left_s = _AGAIN_NS / 1e9 - listener.listened_s
        if left_s <= 0:
            break
        await listener.news(min(left_s, _LOOK_S))
        tellers = await tellers_of(source, tree)
    return tellers


def _once_ns(tree: FrameTree, now_ns: int) -> int:
    """Return how much longer to wait for the second message of edges received only once, in ns."""
    once = [edge for edge in tree.edges.values() if edge.moving and edge.received == 1]
    return max((edge.last_received_ns + _AGAIN_NS - now_ns for edge in once), default=0)


def _newest_ns(tree: FrameTree) -> int:
    return max((max(edge.last_received_ns, edge.refused_ns) for edge in tree.edges.values()), default=0)


def _walk(tree: FrameTree, tops: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Yield every frame below `tops` with its depth, parents first; each frame of a loop once."""
    below: dict[str, list[str]] = {}
    for edge in tree.edges.values():
        if edge.newest:
            below.setdefault(edge.newest.parent, []).append(edge.child)
    seen: set[str] = set()
    waiting = [(name, 0) for name in reversed(tops)]
    while waiting:
        name, depth = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        yield name, depth
        waiting += [(child, depth + 1) for child in sorted(below.get(name, ()), reverse=True)]


def _line(name: str, depth: int, row: EdgeRow | None) -> str:
    said = f" ({row.words()})" if row and row.parent and depth else ""
    # the problem itself is listed once, above the tree
    wrong = f" - {'stale' if row.stale_s is not None else 'see the problems'}" if row and row.problem else ""
    return f"{'  ' * depth}{'└ ' if depth else ''}{named(name)}{said}{wrong}"


def _problems(
    tree: FrameTree, rows: Mapping[str, EdgeRow], names: Sequence[str], tellers: Tellers, *, whole: bool
) -> list[FrameProblem]:
    found: list[FrameProblem] = []
    if whole and len(separate := separate_roots(tree)) > 1:
        roots = ", ".join(map(named, separate))
        problem = f"{len(separate)} trees, with no transform between them; their roots are {roots}."
        found.append(FrameProblem(problem))
    trees = len(found)

    def by(child: str, parent: str) -> str:
        return tellers.by_whom(tree.edges[child], parent)

    hidden = [tree.circle_by(name) for name in names if name in tree.edges and tree.edges[name].two_parents]
    circles = {frozenset(circle): circle for circle in [*map(tree.circle_of, names), *hidden] if circle}
    found += [FrameProblem(f"Frames form a loop: {circle_in_words(circle, by)}.") for circle in circles.values()]
    found += _of_edges([rows[name] for name in names if name in rows and rows[name].problem])
    causes = [edge for name in names if (edge := tree.edges.get(name)) and (edge.two_parents or not edge.newest)]
    # Several trees are a consequence of an edge that is refused, or of a frame with two parents: that cause is listed
    # first.
    return [*found[trees:], *found[:trees]] if causes else found


def _of_edges(rows: Sequence[EdgeRow]) -> list[FrameProblem]:
    """Return one problem for each edge; stale edges of one publisher are combined."""
    stale: dict[str, list[EdgeRow]] = {}
    for row in rows:
        if row.stale_s is not None:
            stale.setdefault(row.publisher, []).append(row)
    found: list[FrameProblem] = []
    for row in rows:
        group = stale.get(row.publisher, []) if row.stale_s is not None else []
        if len(group) < 2:
            found.append(FrameProblem(in_words(row), row.of))
        elif row is group[0]:
            found.append(FrameProblem(stale_in_words(group), row.of))
    return found


def _gaps(source: Source, tree: FrameTree, walk: Sequence[tuple[str, int]]) -> list[str]:
    """Report gaps of edges within the recording, which the state at its end does not show."""
    found: list[str] = []
    for edge in (tree.edges[name] for name, _ in walk if name in tree.edges) if tree.is_recorded else ():
        from_ns, to_ns = edge.longest_gap() or (0, 0)
        usual_ns = 1e9 / edge.rate_hz if edge.rate_hz else 0.0
        came_ns = from_ns + tree.clock_ns, to_ns + tree.clock_ns
        is_hole = any(start_ns < came_ns[1] and end_ns > came_ns[0] for start_ns, end_ns in tree.holes)
        if to_ns - from_ns <= max(_LEAST_GAP_NS, _GAP_PERIODS * usual_ns) or is_hole:
            continue
        began_ns = None if tree.clock_ns else source.began_ns
        when = f"from {stamp_in_words(from_ns, began_ns)} to {stamp_in_words(to_ns, began_ns)}"
        found.append(f"{edge_in_words(edge)} was silent for {seconds_in_words(to_ns - from_ns)}, {when}.")
    return found


def _note(tree: FrameTree) -> list[str]:
    notes = [undecodable(tree.damaged, tree.trouble)] if tree.damaged else []
    if tree.left_out:
        notes.append(f"Not shown: {counted(tree.left_out, 'transform')} of further frames or frames without a name.")
    return notes


def _silent(source: Source, tellers: Tellers, *, harmless: bool) -> list[str]:
    listener = source.transforms
    return silent_in_words(tellers, listener.listened_s, harmless=harmless) if listener else []


def _picture(walk: Sequence[tuple[str, int]], rows: Mapping[str, EdgeRow]) -> Picture:
    from ros2_mcp.pictures.raster import finished
    from ros2_mcp.pictures.tree import TreeRow, tree_raster

    drawn: list[TreeRow] = []
    for name, depth in walk:
        row = rows.get(name) if depth else None
        kind = "root" if row is None else "problem" if row.problem else "static" if row.is_static else "moving"
        said = (row.problem or row.words()) if row else ""
        shown = name if is_name(name) else ascii(name)
        drawn.append(TreeRow(shown[:_MOST_DRAWN], depth, said, kind))
    return finished(tree_raster(drawn), BOUNDS)
