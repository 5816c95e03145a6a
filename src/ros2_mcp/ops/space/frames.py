"""The frame tree of a source, and the pose of one frame in another: the base of all spatial operations.

`pose_in(source, "map", "base_link")` is the robot's pose; it raises `NoTransform`, with the reason in words.
`frames_of(source)` is the whole tree, for callers with several questions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from time import monotonic

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.results.results import Report, silent
from ros2_mcp.ops.sources.source import Capture, Source, Stream
from ros2_mcp.robot.transforms import LISTENS, TF, TF_STATIC, TF_TYPE, TransformListener
from ros2_mcp.world.no_transform import why_none
from ros2_mcp.world.transforms import FrameTree, Located

MAP = "map"
WORLDS = (MAP, "odom", "world", "earth")
"""Frames in which a robot's pose is given, in order of preference (REP 105)."""
APPEARING_S = 4.0
"""Time after which a missing frame is taken as absent: discovery takes up to 3 s, and publishers send at least once a
second."""
_SETTLED_S = 0.5
"""Time to listen from the first question on: by then every publisher of a moving edge has sent, and rates can be
measured."""
_ELSEWHERE_S = 1.0
"""Time without any frame before namespaces are searched for transforms: discovery has found topics by then."""
_BURST_S = 0.05
"""Time for the rest of a burst of messages to arrive."""
_NEWS_S = 0.5
"""Least wait on a tree that has listened for longer: for a time just past, or for a slow edge."""
_BEFORE_NS, _AFTER_NS = 10_000_000_000, 1_000_000_000
"""The part of a recording read for one time: as much as tf2 keeps before it, and what may be stamped ahead after it."""


async def pose_in(source: Source, target: str, frame: str, at_ns: int | None = None) -> Located:
    """Return the pose of `frame` in `target`: `Located.pose`, with its stamp and the chain of edges.

    Args:
        source: the robot, or a recording.
        target: the frame in which the pose is expressed, such as `map`.
        frame: the frame whose pose is wanted, such as `base_link`.
        at_ns: a time by the stamps; None: the latest that all edges of the chain allow (in a recording, at its end).

    Raises:
        NoTransform: with the reason in words, once waiting longer cannot help.
        UnknownInterface: if the robot has no tf2_msgs.
        LinkError: if there is no bridge.
    """
    target, frame = target.lstrip("/"), frame.lstrip("/")
    tree = await frames_of(source, at_ns, until=lambda tree: tree.find(target, frame, at_ns) is not None)
    found = tree.find(target, frame, at_ns)
    if found is None:
        raise why_none(tree, target, frame, at_ns)
    return found


def separate_roots(tree: FrameTree) -> Sequence[str]:
    """Return the roots of the trees that lack a transform between them, that of the largest tree first.

    MAVROS always publishes odom with its copies in other axes (odom_ned, odom_frd) as a tree of its own; it is
    excluded. So are trees connected only by a frame with two parents.
    """
    largest, *others = tree.roots or [""]
    of_copies = {
        root
        for root in others
        if (held := [frame for frame in tree.frames if frame != root and tree.root_of(frame) == root])
        and all(frame in (f"{root}_ned", f"{root}_frd") for frame in held)
    }
    held_too = disputed_roots(tree)
    return [root for root in (largest, *others) if root and root not in of_copies and root not in held_too]


def disputed_roots(tree: FrameTree) -> set[str]:
    """Return the roots of trees that are connected only through a frame with two parents. For each such frame, the root
    of its largest tree is excluded: the others would belong to it if the conflict were resolved.
    """
    order = tree.roots
    found = set[str]()
    for edge in tree.edges.values():
        if edge.two_parents:
            roots = {tree.root_of(parent) for parent in edge.parents if parent in tree.frames}
            found |= set(sorted(roots, key=order.index)[1:])
    return found


async def frames_of(
    source: Source,
    at_ns: int | None = None,
    *,
    until: Callable[[FrameTree], bool] = lambda _: False,
    patience_s: float = APPEARING_S,
    report: Report = silent,
) -> FrameTree:
    """Return the frame tree of a robot now, or of a recording around a time; live, wait until `until` holds.

    Args:
        source: the robot, or a recording.
        at_ns: of a recording, the time by the stamps around which it is read; None: its end.
        until: returns whether the tree holds what is needed; if not, wait a little, or read the whole recording.
        patience_s: live, how long after the first question a missing frame may still appear.
        report: is called with the progress of reading a long recording.

    Raises:
        UnknownInterface: if the robot has no tf2_msgs.
        LinkError: if there is no bridge.
    """
    if listener := source.transforms:
        return await _live(listener, until, patience_s)
    return await _recorded(source, at_ns, until, report)


async def _live(listener: TransformListener, until: Callable[[FrameTree], bool], patience_s: float) -> FrameTree:
    tree = await listener.listening()
    now = monotonic()
    since = now if listener.since is None else listener.since
    settled, deadline = since + _SETTLED_S, max(since + patience_s, now + min(patience_s, _NEWS_S))
    was_waited_for = False
    while listener.tree is tree:
        is_there = until(tree)
        end = settled if is_there else deadline
        if monotonic() >= end:
            if is_there and was_waited_for:  # this may be the first message of a burst; the last one is the newest
                await asyncio.sleep(_BURST_S)
            break
        was_waited_for = not is_there
        await listener.news(end - monotonic())
    if not tree.frames and listener.listened_s > _ELSEWHERE_S and await listener.moved():
        return await _live(listener, until, patience_s)
    return tree


async def _recorded(source: Source, at_ns: int | None, until: Callable[[FrameTree], bool], report: Report) -> FrameTree:
    """Read the seconds around the time first, where its transforms usually are; the whole recording only if `until`
    fails.
    """
    start_ns, end_ns = source.covers_ns or (0, 0)
    around_ns = end_ns if at_ns is None else at_ns
    if start_ns <= around_ns <= end_ns and end_ns - start_ns > _BEFORE_NS + _AFTER_NS:
        near = source.part(around_ns - _BEFORE_NS, around_ns + _AFTER_NS)
        tree = await _read(near, at_ns, report)
        if until(tree):
            return tree
    return await _read(source, at_ns, report)


class _Transforms:
    """Adds the messages of one topic to a tree."""

    def __init__(self, tree: FrameTree, stream: Stream) -> None:
        self._tree, self._stream = tree, stream

    def add(self, samples: Sequence[Sample]) -> None:
        if self._stream.type == TF_TYPE:
            messages = self._tree.decoded(self._stream.codec, samples)
            self._tree.take_in(messages, is_static=self._stream.topic.endswith(TF_STATIC))


async def _read(source: Source, around_ns: int | None, report: Report) -> FrameTree:
    tree = FrameTree(around_ns)
    tree.namespace = await _namespace(source)
    tree.is_recorded = True

    def keep(stream: Stream) -> _Transforms:
        return _Transforms(tree, stream)

    # A static transform holds from its publication on, which may be long before the part that is asked for, and
    # whatever durability the recording states: not every recorder keeps that.
    await source.from_beginning().captures([tree.namespace + TF_STATIC], keep)
    found = await source.captures([tree.namespace + TF], keep, report)
    tree.holes = [hole for one in found if isinstance(one, Capture) for hole in one.holes]
    return tree


async def _namespace(source: Source) -> str:
    """Return the one namespace in which a recording has transforms; empty if it has /tf or /tf_static, or several
    namespaces.
    """
    recorded = await source.publishing(TF_TYPE)
    if not LISTENS.keys().isdisjoint(recorded):
        return ""
    found = {name.removesuffix(topic) for name in recorded for topic in LISTENS if name.endswith(topic)}
    return found.pop() if len(found) == 1 else ""
