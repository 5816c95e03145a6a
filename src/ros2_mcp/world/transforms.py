"""The tree of coordinate frames that tf2_msgs/msg/TFMessage tells, over time, as tf2 keeps it.

What tf2 does is from its documented behaviour (ROS 2 "tf2" concepts; REP 105 for names of frames): each frame has one
parent; transforms are kept by their stamps and interpolated between two of them; of a static one the last told holds
for all times; "latest" is the newest time that all edges between two frames have; before the first and after the last
stamp of an edge there is nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.poses import Pose, normalised
from ros2_mcp.values.writers import Writers
from ros2_mcp.world.frame_edges import KEPT_NS, Edge, Told
from ros2_mcp_common.finite import not_finite, word_for

if TYPE_CHECKING:
    from ros2_mcp.model.samples import Sample
    from ros2_mcp.values.cdr import Codec

BASES = ("base_link", "base_footprint")
"""What the frame of a robot's body is called, by REP 105; with a prefix where there are several robots."""
MOST_KEPT = 6_000
"""Of one edge: 30 s at 200 Hz, the fastest that is usual."""
MOST_TOLD = 300_000
"""Of all edges together: some 100 MB, and 30 s of 100 joints at 100 Hz."""
MOST_FRAMES = 2_000
"""The largest robots have some hundreds; a publisher that invents names without end is bounded by it."""
_TF_TYPE = "tf2_msgs/msg/TFMessage"
_DEEPEST = 1_000
"""Frames from a leaf to the root; deeper trees go in circles."""
OTHER_CLOCK_NS = 60_000_000_000
"""Between stamp and receipt: no delay, and no badly set clock of a second computer, is usually as long."""
_STANDS_NS, _STANDS_PERIODS = 1_000_000_000, 5
"""All stamps stand still after a second, and five periods of the edge that is told most often."""
_UNIT = 0.01
"""How far the squared length of a quaternion may be from 1; tf2 refuses what is further off."""


_PARTS = (*(f"translation.{axis}" for axis in "xyz"), *(f"rotation.{axis}" for axis in "xyzw"))


@dataclass(frozen=True, slots=True)
class Located:
    """Where a frame is in another one: `pose`, at `stamp_ns` (None: all between them is static, so at any time).

    `chain` are the frames from the one that is located to the target; `edges` those between them, in this order.
    """

    target: str
    frame: str
    pose: Pose
    stamp_ns: int | None
    chain: Sequence[str]
    edges: Sequence[Edge]


class FrameTree:
    """All frames, each with what was told of its parent, bounded.

    With `around_ns` those transforms are kept that are nearest to that time, else the newest. `frames` are all names,
    those of roots too. `advanced_ns` is when a stamp last came that was not there yet. `messages` counts those of each
    topic, `left_out` transforms of more frames than are kept, `nameless` those whose frame has no name (child_frame_id
    is empty). `namespace` is that of the topics on which they are told, such as /robot1; empty of /tf itself.
    `is_recorded`: all of it was read from a recording, of which `holes` could not be read. `has_clock` is whether
    somebody tells simulated time, None where nobody has looked: without it a stamp near 1970 is no simulated time.
    """

    def __init__(self, around_ns: int | None = None) -> None:
        self.edges: dict[str, Edge] = {}
        self.frames: dict[str, None] = {}
        self.messages = {"/tf": 0, "/tf_static": 0}
        self.left_out = 0
        self.nameless = 0
        self.advanced_ns = 0
        self.namespace = ""
        self.is_recorded = False
        self.holes: Sequence[tuple[int, int]] = ()
        self.has_clock: bool | None = None
        self.damaged = 0
        self.trouble = ""
        self._around_ns = around_ns
        self._writers = {True: Writers(by_frames=True), False: Writers()}

    def decoded(self, codec: Codec, samples: Iterable[Sample]) -> list[tuple[Any, Sample]]:
        """TFMessages with their samples; those that cannot be decoded are counted as `damaged`, with their `trouble`.

        It may run in another thread while the tree is asked; `add` must not.
        """
        found: list[tuple[Any, Sample]] = []
        for sample in samples:
            try:
                found.append((codec.decode(_TF_TYPE, sample.data), sample))
            except BadData as error:
                self.damaged, self.trouble = self.damaged + 1, str(error)
        return found

    def take_in(self, messages: Iterable[tuple[Any, Sample]], *, is_static: bool) -> None:
        """Takes in what `decoded` gives."""
        for message, sample in messages:
            self.add(message, sample.received_ns, is_static=is_static, sequence=sample.sequence)

    def add(self, message: Any, received_ns: int, *, is_static: bool, sequence: int | None = None) -> None:
        """Takes in a TFMessage; `sequence` is its publisher's number, which tells several publishers apart."""
        self.messages["/tf_static" if is_static else "/tf"] += 1
        children = [one.child_frame_id for one in message.transforms]
        writer = self._writers[is_static].of(sequence, children, received_ns)
        for one in message.transforms:
            child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            edge = self._edge(child)
            if edge is None:
                continue
            edge.on_static = is_static
            is_slashed = "/" in (one.child_frame_id[:1], one.header.frame_id[:1])
            edge.slashed = f"{one.header.frame_id} → {one.child_frame_id}" if is_slashed else ""
            at, turned = one.transform.translation, one.transform.rotation
            pose, why = _pose_of((at.x, at.y, at.z), (turned.x, turned.y, turned.z, turned.w), child, parent)
            if why or parent == edge.refused_parent:  # with another parent it is told by somebody else
                edge.refused = why
            if parent:
                self.frames.setdefault(parent)
            if pose is None:
                edge.refused_parent, edge.refused_writer, edge.refused_ns = parent, writer, received_ns
                continue
            stamp_ns = one.header.stamp.sec * 1_000_000_000 + one.header.stamp.nanosec
            told = Told(parent, pose, stamp_ns, received_ns, writer)
            if is_static:
                edge.is_left = False
                edge.add_static(told)
                continue
            edge.add_moving(told)
            if not edge.moving:
                continue
            if stamp_ns and not edge.frozen:
                self.advanced_ns = max(self.advanced_ns, received_ns)
            most = max(2, min(MOST_KEPT, MOST_TOLD // max(len(self.edges), 1)))
            if len(edge.moving) > most or (self._around_ns is None and edge.stamps[0] < edge.stamps[-1] - 2 * KEPT_NS):
                # In larger steps, so that a list is not moved with each message.
                edge.forget(most - most // 8, self._around_ns)

    def _edge(self, child: str) -> Edge | None:
        if child in self.edges:
            return self.edges[child]
        if not child or len(self.edges) >= MOST_FRAMES:
            self.nameless += not child
            self.left_out += 1
            return None
        self.frames.setdefault(child)
        self.edges[child] = Edge(child)
        return self.edges[child]

    def writers(self, *, is_static: bool) -> Mapping[int, frozenset[str]]:
        """The publishers that were heard on one of both topics, and the frames that each has told."""
        return self._writers[is_static].frames

    def publishers(self, *, is_static: bool) -> int:
        """How many publishers were heard on one of both topics."""
        return self._writers[is_static].count

    def heard_ns(self, *, is_static: bool) -> Mapping[int, tuple[int, int]]:
        """When these publishers were heard first and last, in ns."""
        return self._writers[is_static].heard_ns

    # ── asking ─────────────────────────────────────────────────────────────────────────────────────────────────

    def find(self, target: str, frame: str, at_ns: int | None = None) -> Located | None:
        """Where a frame is in the target, at a time, or as late as all edges between them allow.

        None where that is not known, or cannot be trusted; `no_transform.why_none` says why.
        """
        if target not in self.frames or frame not in self.frames:
            return None
        if target == frame:
            return Located(target, frame, Pose(), None, [frame], [])
        time_ns = self.common_ns(target, frame) if at_ns is None else at_ns
        chain = self._chain(target, frame, lambda edge: edge.newest if time_ns is None else edge.at(time_ns))
        if chain is None or self.circle_of(frame) or any(edge.two_parents for edge in chain.edges):
            return None
        if self.hidden_circle(target, frame, chain.edges):
            return None
        return chain.located(target, frame, time_ns if any(edge.moving for edge in chain.edges) else None)

    def common_ns(self, target: str, frame: str) -> int | None:
        """The newest time that all edges between two frames have; None where none of them moves."""
        return min((edge.stamps[-1] for edge in self.connected(target, frame) or () if edge.moving), default=None)

    def newest(self, target: str, frame: str) -> Located | None:
        """The same out of the newest of each edge, which need not be of one time: for pictures, not for motion."""
        chain = self._chain(target, frame, lambda edge: edge.newest)
        return chain.located(target, frame, self.common_ns(target, frame)) if chain else None

    def connected(self, target: str, frame: str) -> Sequence[Edge] | None:
        """The edges between two frames as they were last told, whenever that was; None where there is no way."""
        chain = self._chain(target, frame, lambda edge: edge.newest)
        return chain.edges if chain else None

    def way_up(self, frame: str) -> Sequence[Edge]:
        """The edges from a frame to its root as they were last told; where they go in a circle, once around."""
        return [edge for edge, _ in self._up(frame, lambda edge: edge.newest)]

    def circle_of(self, frame: str) -> list[str]:
        """The frames of the circle to which the way up from a frame leads, each below the next; empty where it has a
        root.
        """
        up = self._up(frame, lambda edge: edge.newest)
        children = [edge.child for edge, _ in up]
        last = up[-1][1].parent if up else frame
        return children[children.index(last) :] if last in children else []

    def circle_by(self, frame: str) -> list[str]:
        """The frames of a circle that goes up from this one by any of its parents, each below the next; empty where
        there is none. A further parent may hide it from `circle_of`, which goes by what was told last.
        """
        came: dict[str, str] = {}
        waiting = [frame]
        while waiting:
            name = waiting.pop()
            edge = self.edges.get(name)
            for parent in edge.parents if edge else ():
                if parent == frame:
                    path = [name]
                    while path[-1] != frame:
                        path.append(came[path[-1]])
                    return path[::-1]
                if parent not in came:
                    came[parent] = name
                    waiting.append(parent)
        return []

    def hidden_circle(self, target: str, frame: str, edges: Sequence[Edge]) -> list[str]:
        """The circle of which one of these edges between two frames is a part, though a further parent of one of its
        frames hides it: the same edge is then told the other way round, too, and neither can be trusted.
        """
        between = {edge.child for edge in edges}  # of these it is known already whether they have two parents
        above = {
            edge.child: edge for name in (frame, target) for edge in self.way_up(name) if edge.child not in between
        }
        for edge in above.values():
            circle = self.circle_by(edge.child) if edge.two_parents else []
            steps = {*zip(circle, [*circle[1:], *circle[:1]], strict=True)}
            if any(one.newest and (one.child, one.newest.parent) in steps for one in edges):
                return circle
        return []

    def root_of(self, frame: str) -> str:
        """The root of a frame's tree, as it was last told; of frames that go in a circle the first by name."""
        if circle := self.circle_of(frame):
            return min(circle)
        up = self._up(frame, lambda edge: edge.newest)
        return up[-1][1].parent if up else frame

    def children_of(self, parent: str) -> list[str]:
        """The frames right below one, as they were last told, sorted."""
        return sorted(edge.child for edge in self.edges.values() if edge.newest and edge.newest.parent == parent)

    @property
    def roots(self) -> list[str]:
        """Every root, that of the largest tree first; frames of which nothing valid was told are roots, too."""
        sizes: dict[str, int] = {}
        for frame in self.frames:
            root = self.root_of(frame)
            sizes[root] = sizes.get(root, 0) + 1
        return sorted(sizes, key=lambda root: (-sizes[root], root))

    @property
    def clock_ns(self) -> int:
        """How far the stamps are behind the clock of the receiver, where they are of another one; else 0.

        So it is on simulated time, and where a bag is played.
        """
        lags = sorted(edge.lag_ns for edge in self.edges.values() if edge.moving)
        # Of as many of both, those by the receiver's clock count.
        middle = min(lags[(len(lags) - 1) // 2], lags[len(lags) // 2], key=abs) if lags else 0
        return middle if abs(middle) > OTHER_CLOCK_NS else 0

    def stood_ns(self, at_ns: int) -> int:
        """For how long no stamp has gone on, where all are of another clock than the receiver's; 0 where one has, or
        where that is no longer than usual.
        """
        if not self.clock_ns:
            return 0
        rates = [edge.received_hz for edge in self.edges.values() if edge.moving and edge.received_hz]
        usual_ns = max(_STANDS_NS, round(_STANDS_PERIODS * 1e9 / max(rates))) if rates else _STANDS_NS
        stood_ns = at_ns - self.advanced_ns
        return stood_ns if stood_ns > usual_ns else 0

    def reaches(self, at_ns: int) -> bool:
        """Whether that time lies among the stamps."""
        moving = [edge for edge in self.edges.values() if edge.moving]
        return any(edge.stamps[0] <= at_ns <= edge.stamps[-1] for edge in moving)

    @property
    def base(self) -> str:
        """The frame of the robot's body; empty where there is none, or of which robot is not clear."""
        for base in BASES:
            found = [base] if base in self.frames else [name for name in self.frames if name.rpartition("/")[2] == base]
            if len(found) == 1:
                return found[0]
        return ""

    def _up(self, frame: str, at: Callable[[Edge], Told | None]) -> list[tuple[Edge, Told]]:
        steps: list[tuple[Edge, Told]] = []
        seen = {frame}
        while (edge := self.edges.get(frame)) and (told := at(edge)) and len(steps) < _DEEPEST:
            steps.append((edge, told))
            frame = told.parent
            if frame in seen:
                break
            seen.add(frame)
        return steps

    def _chain(self, target: str, frame: str, at: Callable[[Edge], Told | None]) -> _Chain | None:
        """The way from a frame up to the first one that the target is below, too, and down from there."""
        up, down = self._up(frame, at), self._up(target, at)
        below_target = {target: 0, **{told.parent: place for place, (_, told) in reversed(list(enumerate(down, 1)))}}
        if frame in below_target:
            return _Chain([], down[: below_target[frame]])
        for count, (_, told) in enumerate(up, 1):
            if told.parent in below_target:
                return _Chain(up[:count], down[: below_target[told.parent]])
        return None


@dataclass(frozen=True, slots=True)
class _Chain:
    """The steps up from a frame to the common one, and those up from the target to it."""

    up: Sequence[tuple[Edge, Told]]
    down: Sequence[tuple[Edge, Told]]

    @property
    def edges(self) -> Sequence[Edge]:
        return [edge for edge, _ in (*self.up, *reversed(self.down))]

    def located(self, target: str, frame: str, stamp_ns: int | None) -> Located:
        frame_in_common, target_in_common = _composed(self.up), _composed(self.down)
        names = [frame, *(told.parent for _, told in self.up), *(edge.child for edge, _ in reversed(self.down))]
        pose = target_in_common.inverse @ frame_in_common
        return Located(target, frame, pose, stamp_ns, names, self.edges)


def _composed(steps: Iterable[tuple[Edge, Told]]) -> Pose:
    pose = Pose()
    for _, told in steps:
        pose = told.pose @ pose
    return pose


def _pose_of(
    at: tuple[float, float, float], turned: tuple[float, float, float, float], child: str, parent: str
) -> tuple[Pose | None, str]:
    """The pose, or why it is none, for the same reasons as tf2 refuses it."""
    if not parent:
        return None, "its parent has no name (header.frame_id is empty)"
    if parent == child:
        return None, "it is published as its own parent"
    if not all(map(math.isfinite, (*at, *turned))):
        parts = zip(_PARTS, (*at, *turned), strict=True)
        return None, next(f"its {name} is {word_for(number)}" for name, number in parts if not math.isfinite(number))
    squared = sum(part * part for part in turned)
    if abs(squared - 1) > _UNIT:
        return None, f"its rotation is not a unit quaternion: {', '.join(f'{part:.4g}' for part in turned)}"
    return Pose(at, normalised(turned)), ""


def pose_of(pose: Any) -> Pose:
    """A geometry_msgs/msg/Pose; a rotation of all zeros, which nobody has filled in, is none.

    Raises:
        ValueError: if it has numbers that are not finite, with the first of them.
    """
    if why := not_finite(pose, "position", "orientation"):
        raise ValueError(why)
    at, q = pose.position, pose.orientation
    turned = (q.x, q.y, q.z, q.w)
    return Pose((at.x, at.y, at.z), normalised(turned) if any(turned) else (0.0, 0.0, 0.0, 1.0))
