"""The frames of a source, and where one frame is in another: what everything that knows of space builds on.

`pose_in(source, "map", "base_link")` is where the robot is; it raises `NoTransform` with the reason in words.
`frames_of(source)` is the whole tree, for those who ask it several questions.
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
"""Frames in which a robot's place is meant, the better first (REP 105)."""
APPEARING_S = 4.0
"""A publisher may be discovered up to 3 s late, and sends once a second at least; after that a frame is not there."""
_SETTLED_S = 0.5
"""From the first question on: by then a second publisher of what moves has told its share, and there are rates."""
_ELSEWHERE_S = 1.0
"""Without any frame, before it is looked whether there are some in a namespace: discovery has begun by then."""
_BURST_S = 0.05
"""For the rest of a burst of messages, which come as fast as the network carries them."""
_NEWS_S = 0.5
"""For what is about to come to a tree that has listened for longer: a time just passed, or an edge that is slow."""
_BEFORE_NS, _AFTER_NS = 10_000_000_000, 1_000_000_000
"""The part of a recording that is read for one time: what tf2 would keep, and what may be stamped ahead."""


async def pose_in(source: Source, target: str, frame: str, at_ns: int | None = None) -> Located:
    """Where a frame is in the target: `Located.pose`, with its stamp and the chain of edges.

    Args:
        source: the robot, or a recording.
        target: the frame in which the answer is meant, such as `map`.
        frame: the frame that is asked for, such as `base_link`.
        at_ns: by the stamps; None: as late as all edges between them allow (of a recording, at its end).

    Raises:
        NoTransform: with the reason, in words, once it is clear that waiting does not help.
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
    """The roots of the trees between which a transform is missing, that of the largest first.

    MAVROS always tells odom with its copies for other axes (odom_ned) in a tree of their own, which lacks nothing.
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
    """The roots of trees to which a frame with two parents would belong as well: what lies between them is told by
    somebody, and is in dispute. Of those of one frame all but the largest's.
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
    """The frames of a robot now, or of a recording around a time; live it is not complete before `until` holds.

    Args:
        source: the robot, or a recording.
        at_ns: of a recording, the time by the stamps around which it is read; None: its end.
        until: whether the tree has what is needed; if not, a little is waited for it, and of a recording all is read.
        patience_s: live, how long after the first question what is not there may still appear.
        report: is told how far the reading of a long recording has come.

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
            if is_there and was_waited_for:  # it may be the first message of a burst, of which the last is the newest
                await asyncio.sleep(_BURST_S)
            break
        was_waited_for = not is_there
        await listener.news(end - monotonic())
    if not tree.frames and listener.listened_s > _ELSEWHERE_S and await listener.moved():
        return await _live(listener, until, patience_s)
    return tree


async def _recorded(source: Source, at_ns: int | None, until: Callable[[FrameTree], bool], report: Report) -> FrameTree:
    """First the seconds around the time, which is where its transforms are; all of it only where those lack any."""
    start_ns, end_ns = source.covers_ns or (0, 0)
    around_ns = end_ns if at_ns is None else at_ns
    if start_ns <= around_ns <= end_ns and end_ns - start_ns > _BEFORE_NS + _AFTER_NS:
        near = source.part(around_ns - _BEFORE_NS, around_ns + _AFTER_NS)
        tree = await _read(near, at_ns, report)
        if until(tree):
            return tree
    return await _read(source, at_ns, report)


class _Transforms:
    """Takes the messages of one topic into a tree."""

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

    # What is static holds from when it was told on, however long before the part that is asked for that was, and
    # whatever the recording says of its durability: not every recorder keeps that.
    await source.from_beginning().captures([tree.namespace + TF_STATIC], keep)
    found = await source.captures([tree.namespace + TF], keep, report)
    tree.holes = [hole for one in found if isinstance(one, Capture) for hole in one.holes]
    return tree


async def _namespace(source: Source) -> str:
    """The only namespace of which a recording has transforms, where it has none of /tf and /tf_static themselves."""
    recorded = await source.publishing(TF_TYPE)
    if not LISTENS.keys().isdisjoint(recorded):
        return ""
    found = {name.removesuffix(topic) for name in recorded for topic in LISTENS if name.endswith(topic)}
    return found.pop() if len(found) == 1 else ""
