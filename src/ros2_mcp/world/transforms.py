"""The tree of coordinate frames from tf2_msgs/msg/TFMessage over time, with the rules of tf2.

The rules follow tf2's documentation (ROS 2 "tf2" concepts; REP 105 for names of frames): each frame has one parent;
transforms are stored by stamp and interpolated between two stamps; the last static transform is valid for all times;
"latest" is the newest time that all edges between two frames have; before the first and after the last stamp of an edge
there is no transform.
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
"""The frame of a robot's body by REP 105; with a prefix if there are several robots."""
MOST_KEPT = 6_000
"""Transforms of one edge: 30 s at 200 Hz, the highest usual rate."""
MOST_TOLD = 300_000
"""Transforms of all edges together: some 100 MB, and 30 s of 100 joints at 100 Hz."""
MOST_FRAMES = 2_000
"""The largest robots have some hundreds; this limits a publisher that keeps inventing names."""
_TF_TYPE = "tf2_msgs/msg/TFMessage"
_DEEPEST = 1_000
"""Frames from a leaf to the root; deeper trees have loops."""
OTHER_CLOCK_NS = 60_000_000_000
"""Difference of stamp and receipt that shows another clock: no delay, and no badly set clock, is usually as long."""
_STANDS_NS, _STANDS_PERIODS = 1_000_000_000, 5
"""All stamps are frozen if none advances for a second, and for five periods of the edge with the highest rate."""
_UNIT = 0.01
"""Tolerance of the squared length of a quaternion from 1; tf2 rejects larger deviations."""


_PARTS = (*(f"translation.{axis}" for axis in "xyz"), *(f"rotation.{axis}" for axis in "xyzw"))


@dataclass(frozen=True, slots=True)
class Located:
    """The pose of a frame in another frame at `stamp_ns` (None: all edges between them are static, so at any time).

    `chain` are the frames from the located one to the target; `edges` those between them, in this order.
    """

    target: str
    frame: str
    pose: Pose
    stamp_ns: int | None
    chain: Sequence[str]
    edges: Sequence[Edge]


class FrameTree:
    """All frames with the transforms received for them, bounded in number.

    With `around_ns` the transforms nearest to that time are kept, otherwise the newest. `frames` are all names,
    including roots. `advanced_ns` is the time of receipt of the last new stamp. `messages` counts those of each topic,
    `left_out` transforms beyond the maximum number of frames, `nameless` those with an empty child_frame_id.
    `namespace` is that of the topics, such as /robot1; empty for /tf itself. `is_recorded`: all transforms were read
    from a recording, of which `holes` could not be read. `has_clock` is whether simulated time is published, None if
    not checked: without it, a stamp near 1970 is not simulated time.
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
        """Decode TFMessages; messages that cannot be decoded are counted in `damaged`, with the last error in
        `trouble`.

        This may run in another thread while the tree is queried; `add` must not.
        """
        found: list[tuple[Any, Sample]] = []
        for sample in samples:
            try:
                found.append((codec.decode(_TF_TYPE, sample.data), sample))
            except BadData as error:
                self.damaged, self.trouble = self.damaged + 1, str(error)
        return found

    def take_in(self, messages: Iterable[tuple[Any, Sample]], *, is_static: bool) -> None:
        """Add the messages that `decoded` returns."""
        for message, sample in messages:
            self.add(message, sample.received_ns, is_static=is_static, sequence=sample.sequence)

    def add(self, message: Any, received_ns: int, *, is_static: bool, sequence: int | None = None) -> None:
        """Add a TFMessage; `sequence` is its publisher's sequence number, which distinguishes several publishers."""
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
            if why or parent == edge.refused_parent:  # with another parent it comes from another publisher
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
                # In larger steps, so that the list is not moved with each message.
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
        """Return the publishers received on one of the two topics, each with the frames that it published."""
        return self._writers[is_static].frames

    def publishers(self, *, is_static: bool) -> int:
        """Return the number of publishers received on one of the two topics."""
        return self._writers[is_static].count

    def heard_ns(self, *, is_static: bool) -> Mapping[int, tuple[int, int]]:
        """Return the times of receipt (ns) of the first and the last message of each publisher."""
        return self._writers[is_static].heard_ns

    # ── asking ─────────────────────────────────────────────────────────────────────────────────────────────────

    def find(self, target: str, frame: str, at_ns: int | None = None) -> Located | None:
        """Return the pose of a frame in the target at a time, or at the newest time that all edges between them have.

        None if it is not known, or cannot be trusted; `no_transform.why_none` gives the reason.
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
        """Return the newest time that all edges between two frames have; None if all of them are static."""
        return min((edge.stamps[-1] for edge in self.connected(target, frame) or () if edge.moving), default=None)

    def newest(self, target: str, frame: str) -> Located | None:
        """Return the pose from the newest transform of each edge: for pictures, not for motion.

        The transforms may be of different times.
        """
        chain = self._chain(target, frame, lambda edge: edge.newest)
        return chain.located(target, frame, self.common_ns(target, frame)) if chain else None

    def connected(self, target: str, frame: str) -> Sequence[Edge] | None:
        """Return the edges between two frames by their newest transforms of any time.

        None if they are not connected.
        """
        chain = self._chain(target, frame, lambda edge: edge.newest)
        return chain.edges if chain else None

    def way_up(self, frame: str) -> Sequence[Edge]:
        """Return the edges from a frame to its root, by their newest transforms; in a loop, once around."""
        return [edge for edge, _ in self._up(frame, lambda edge: edge.newest)]

    def circle_of(self, frame: str) -> list[str]:
        """Return the frames of the loop above a frame, each followed by its parent; empty if the frame has a root."""
        up = self._up(frame, lambda edge: edge.newest)
        children = [edge.child for edge, _ in up]
        last = up[-1][1].parent if up else frame
        return children[children.index(last) :] if last in children else []

    def circle_by(self, frame: str) -> list[str]:
        """Return the frames of a loop through this frame by any of its parents, each followed by its parent.

        Empty if there is none. A second parent may hide this loop from `circle_of`, which uses only the newest
        transforms.
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
        """Return the loop that contains one of these edges between two frames, hidden by a second parent of a frame.

        The edge is then also published in reverse, and neither direction can be trusted. Empty if there is none.
        """
        between = {edge.child for edge in edges}  # these are checked for two parents elsewhere
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
        """Return the root of a frame's tree by the newest transforms; in a loop, the first frame by name."""
        if circle := self.circle_of(frame):
            return min(circle)
        up = self._up(frame, lambda edge: edge.newest)
        return up[-1][1].parent if up else frame

    def children_of(self, parent: str) -> list[str]:
        """Return the child frames of a frame by the newest transforms, sorted."""
        return sorted(edge.child for edge in self.edges.values() if edge.newest and edge.newest.parent == parent)

    @property
    def roots(self) -> list[str]:
        """Every root, that of the largest tree first; frames without any valid transform are roots, too."""
        sizes: dict[str, int] = {}
        for frame in self.frames:
            root = self.root_of(frame)
            sizes[root] = sizes.get(root, 0) + 1
        return sorted(sizes, key=lambda root: (-sizes[root], root))

    @property
    def clock_ns(self) -> int:
        """Delay of the stamps behind the receiver's clock in ns, if they are from another clock; else 0.

        This is so with simulated time, and while a bag is played.
        """
        lags = sorted(edge.lag_ns for edge in self.edges.values() if edge.moving)
        # If there are equally many of both kinds, those by the receiver's clock decide.
        middle = min(lags[(len(lags) - 1) // 2], lags[len(lags) // 2], key=abs) if lags else 0
        return middle if abs(middle) > OTHER_CLOCK_NS else 0

    def stood_ns(self, at_ns: int) -> int:
        """Return for how long no stamp has advanced, if all stamps are from another clock than the receiver's.

        Zero if a stamp has advanced, or the pause is not longer than usual.
        """
        if not self.clock_ns:
            return 0
        rates = [edge.received_hz for edge in self.edges.values() if edge.moving and edge.received_hz]
        usual_ns = max(_STANDS_NS, round(_STANDS_PERIODS * 1e9 / max(rates))) if rates else _STANDS_NS
        stood_ns = at_ns - self.advanced_ns
        return stood_ns if stood_ns > usual_ns else 0

    def reaches(self, at_ns: int) -> bool:
        """Return whether a time lies between the first and last stamp of any edge."""
        moving = [edge for edge in self.edges.values() if edge.moving]
        return any(edge.stamps[0] <= at_ns <= edge.stamps[-1] for edge in moving)

    @property
    def base(self) -> str:
        """The frame of the robot's body; empty if there is no body, or several robots have a body."""
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
        """Return the path from a frame up to its first common ancestor with the target, and down from there."""
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
    """The edges from a frame up to the common ancestor, and the edges from the target up to it."""

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
    """Return the pose, or the reason why it is invalid; tf2 rejects the same transforms."""
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
    """Convert a geometry_msgs/msg/Pose; a quaternion of all zeros, which was not set, is no rotation.

    Raises:
        ValueError: if it has numbers that are not finite, with the first of them.
    """
    if why := not_finite(pose, "position", "orientation"):
        raise ValueError(why)
    at, q = pose.position, pose.orientation
    turned = (q.x, q.y, q.z, q.w)
    return Pose((at.x, at.y, at.z), normalised(turned) if any(turned) else (0.0, 0.0, 0.0, 1.0))
