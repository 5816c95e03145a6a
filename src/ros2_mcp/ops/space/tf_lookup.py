"""Look-up of the transform between two frames: at a time, averaged over a duration, or applied to points and
messages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic

import anyio

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadInput, BadValue, NoTransform
from ros2_mcp.model.poses import Pose, angle_between_rad, mean_of, normalised, product
from ros2_mcp.model.text import counted, named, quoted
from ros2_mcp.ops.results.results import EXACT, ON_REQUEST, SAID, Report, microseconds, reporting, silent
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.sources.times import is_relative, parsed_ns
from ros2_mcp.ops.space.described import described_frame
from ros2_mcp.ops.space.edges import EdgeRow, age_in_words, edge_row, in_words
from ros2_mcp.ops.space.frames import frames_of
from ros2_mcp.ops.space.message_field import given_in
from ros2_mcp.ops.space.standing_time import look_for_clock, other_clock, standing_time
from ros2_mcp.ops.space.tellers import Tellers, silent_in_words, tellers_of
from ros2_mcp.ops.space.unheard import followed_in_words, unheard_publishers
from ros2_mcp.world.no_transform import alike, edge_in_words, seconds_in_words, stamp_in_words, why_none
from ros2_mcp.world.transforms import OTHER_CLOCK_NS, FrameTree, Located

MOST_POINTS = 500
"""The most points of one call: enough for a polygon, a path or a plan. Clouds are drawn, not transformed as numbers."""
MOST_S = 600.0
"""The longest duration, as in the other tools that measure."""
_MOST_POSES = 5_000
"""The most poses averaged over a duration: all of 100 s at 50 Hz; of more, every n-th."""
_LOOK_S = 0.5
"""Interval at which poses are taken from the tree, which keeps 30 s."""
_WATCHED_S = 4.5
"""Time from the first question on in which stamps of an unknown clock are watched for a restart."""
_MOST_TOLD = 8
"""The most edges whose publishers an error names."""
_LONG_GAP_NS = 1_000_000_000
"""A longer time between two transforms of an edge is a gap: the slowest usual publishers send once a second."""
_MOST_SHOWN = 3
"""The most transformed points in the text; all are in the values."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LookupRequest:
    """A look-up of `frame` in `target`: at a `time` (empty: the latest), or averaged over `duration_s`. The `points`
    ([x, y, z], or [x, y, z, qx, qy, qz, qw] for poses) in `frame`, or the `field` (`/topic:path`) of a message, are
    transformed into `target`.
    """

    target: str
    frame: str
    time: str = ""
    duration_s: float | None = None
    points: Sequence[Sequence[float]] = ()
    field: str = ""


@dataclass(frozen=True, slots=True)
class Xyz:
    """Metres."""

    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Xyzw:
    """A unit quaternion (x, y, z, w)."""

    x: float
    y: float
    z: float
    w: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """The variation of the pose over the duration, from `count` poses; the pose of the result is their mean.

    `std_*` are the standard deviations of the translation (m) and of the rotation (angle from the mean, degrees).
    `max_deviation_m` and `max_deviation_deg` are the largest deviations from the mean; `moved_m` and `turned_deg` are
    the distance and the angle between the first and the last pose.
    """

    count: int
    std_x_m: float
    std_y_m: float
    std_z_m: float
    std_deg: float
    max_deviation_m: float
    max_deviation_deg: float
    moved_m: float
    turned_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Lookup:
    """The pose of `source` in `target`, as tf2 defines it: rotating a point of `source` and adding the translation
    gives the point in `target`. Roll, pitch and yaw are rotations about the fixed axes x, y, z of `target`.

    `stamp` is the time of the transform by its stamps (null if all transforms in the chain are static or have no
    stamp). `age_s` is the age at the time of the call, or at the end of the recording (null if a time in a recording
    was given). `chain` lists the frames from `source` to `target`, `edges` the transforms between them. `transformed`
    has the given points or poses in `target`: [x, y, z] or [x, y, z, qx, qy, qz, qw].
    """

    target: str = field(metadata=SAID)
    source: str = field(metadata=SAID)
    translation: Xyz = field(metadata=EXACT)
    rotation: Xyzw = field(metadata=EXACT)
    roll_deg: float = field(metadata=SAID)
    pitch_deg: float = field(metadata=SAID)
    yaw_deg: float = field(metadata=SAID)
    distance_m: float
    stamp: str | None = field(metadata=SAID)
    stamp_ns: str | None
    age_s: float | None = field(metadata=SAID)
    is_static: bool = field(metadata=SAID)
    chain: Sequence[str] = field(metadata=SAID)
    edges: Sequence[EdgeRow] = field(metadata=SAID)
    spread: Spread | None = field(default=None, metadata=ON_REQUEST)
    transformed: Sequence[Sequence[float]] | None = field(default=None, metadata=ON_REQUEST)
    read_from: str = field(default="", metadata=SAID)
    note: str = ""

    def summary(self) -> list[str]:
        """Return a line with the pose, lines with spread and transformed points, and a line with the edges of the
        chain.
        """
        at = self.translation
        age = "" if self.age_s is None else f", {age_in_words(self.age_s)}"
        when = "static" if self.is_static else f"{f'at {self.stamp}' if self.stamp else 'without a stamp'}{age}"
        lines = [
            f"{named(self.source)} in {named(self.target)} ({when}): x {at.x:.4f}, y {at.y:.4f}, z {at.z:.4f} m; "
            f"roll {self.roll_deg:.2f}, pitch {self.pitch_deg:.2f}, yaw {self.yaw_deg:.2f} deg."
        ]
        if self.spread:
            one = self.spread
            lines.append(
                f"Mean of {one.count} poses: standard deviation x {one.std_x_m:.2g}, y {one.std_y_m:.2g}, "
                f"z {one.std_z_m:.2g} m, {one.std_deg:.2g} deg; "
                f"moved {one.moved_m:.3g} m, turned {one.turned_deg:.3g} deg."
            )
        if self.transformed:
            shown = ["(" + ", ".join(f"{part:.4f}" for part in one) + ")" for one in self.transformed[:_MOST_SHOWN]]
            more = f" and {len(self.transformed) - len(shown)} more" if len(self.transformed) > len(shown) else ""
            lines.append(f"In {named(self.target)}: {', '.join(shown)}{more}.")
        if self.edges:
            steps = [f"{named(row.parent)} → {named(row.child)} ({row.words()})" for row in self.edges]
            lines.append(f"Chain: {'; '.join(steps)}.")
        return [*lines, *([self.note] if self.note else [])]


async def tf_lookup(source: Source, request: LookupRequest, report: Report = silent) -> Lookup:
    """Look up a transform, and transform points or a message field with it.

    Raises:
        NoTransform: with the reason in words, from the transforms received.
        BadValue: for an invalid time, point or field.
        BadInput: if no frame is given, or arguments contradict each other.
        NotFound, TimedOut, TypeConflict: as `given_in` does for `field`.
        UnknownInterface, LinkError: as `frames_of`.
    """
    if len(request.points) > MOST_POINTS:
        raise BadValue("points", f"{len(request.points)} are given.", f"At most {MOST_POINTS} at once.")
    if request.duration_s is not None:
        bounded("duration_s", request.duration_s, 0.0, MOST_S, "s")
    given: Sequence[Pose] | None = [_given(number, point) for number, point in enumerate(request.points)] or None
    sizes = [len(point) for point in request.points]
    frame, at_ns, notes = request.frame.strip().lstrip("/"), None, list[str]()
    if request.field:
        if given:
            raise BadInput("points and field are both given.", "Give one of them.")
        found = await given_in(source, request.field, MOST_POINTS, report)
        frame, given, sizes = frame or found.frame, found.poses, found.sizes
        at_ns = found.stamp_ns if not request.time and found.stamp_ns else None
        notes += [found.note] if found.note else []
    if not frame:
        raise BadInput("`source` is missing: it is the frame to look up.", "Give source, such as base_link.")
    target = request.target.strip().lstrip("/")
    slashed = [name for name in (request.target.strip(), request.frame.strip()) if name.startswith("/")]
    if slashed:
        notes.append(
            f"tf2 rejects names with a leading slash, such as {' and '.join(map(quoted, slashed))}: this lookup leaves "
            "the slash out, and nodes must do so, too."
        )
    if request.duration_s is not None:
        tree, located, spread = await _over(source, target, frame, request, report)
    else:
        tree, located = await _at(source, target, frame, request.time, at_ns, report)
        spread = None
    return await _answer(source, request, tree, located, spread, _carried(located.pose, given, sizes), notes)


def _given(number: int, point: Sequence[float]) -> Pose:
    """Return a point or pose given by the caller."""
    path = f"points[{number}]"
    if len(point) not in (3, 7):
        raise BadValue(path, f"{len(point)} numbers.", "Write [x, y, z], or [x, y, z, qx, qy, qz, qw] for a pose.")
    at = (point[0], point[1], point[2])
    if len(point) == 3:
        return Pose(at)
    try:
        return Pose(at, normalised((point[3], point[4], point[5], point[6])))
    except ValueError as error:
        raise BadValue(path, "its quaternion has length 0.", "Write 0, 0, 0, 1 for no rotation.") from error


def _carried(pose: Pose, given: Sequence[Pose] | None, sizes: Sequence[int]) -> Sequence[Sequence[float]] | None:
    """Return the given values in the target frame. `sizes` gives the kind of each: 3 a point, 7 a pose, 4 a quaternion,
    0 a vector, of which three numbers are returned.
    """
    if given is None:
        return None
    carried: list[Sequence[float]] = []
    for one, size in zip(given, sizes, strict=True):
        if size == 0:  # a vector has no position: it is only rotated
            carried.append(Pose((0.0, 0.0, 0.0), pose.rotation).applied(one.translation))
        elif size == 4:
            carried.append(product(pose.rotation, one.rotation))
        else:
            there = pose @ one
            carried.append(there.translation if size == 3 else (*there.translation, *there.rotation))
    return carried


# ── at a time ────────────────────────────────────────────────────────────────────────────────────────────────────────


async def _at(
    source: Source, target: str, frame: str, time: str, at_ns: int | None, report: Report
) -> tuple[FrameTree, Located]:
    """Return the tree and the transform at a time: `time` as the caller wrote it, else the stamp `at_ns`."""
    wall_ns = _wall_ns(source, time) if time.strip() else at_ns

    def sought(tree: FrameTree) -> int | None:
        if wall_ns is None or not time.strip():
            return wall_ns
        # "2 s ago" and "12 s in" refer to the receiver's clock; a number may be a stamp of the robot's own clock.
        return wall_ns if not is_relative(time) and tree.reaches(wall_ns) else wall_ns - tree.clock_ns

    def is_there(tree: FrameTree) -> bool:
        return tree.find(target, frame, sought(tree)) is not None

    tree = await frames_of(source, wall_ns, until=is_there, report=report)
    await _watched(source, tree)
    await look_for_clock(source, tree)
    found = tree.find(target, frame, sought(tree))
    if found is None:
        raise await _more_of(source, why_none(tree, target, frame, sought(tree)), tree, (frame, target))
    return tree, found


async def _watched(source: Source, tree: FrameTree) -> None:
    """If stamps come from an unknown clock, listen some seconds to see whether they restart, as in a looped bag."""
    listener = source.transforms
    if listener is None or not tree.clock_ns or listener.listened_s > _WATCHED_S or await listener.clock_publishers():
        return
    while listener.tree is tree and (left_s := _WATCHED_S - listener.listened_s) > 0:
        if any(edge.jumps for edge in tree.edges.values()):
            await anyio.sleep(min(left_s, _LOOK_S))  # for the other edges, whose stamps restart at the same time
            return
        await listener.news(left_s)


async def _more_of(source: Source, error: NoTransform, tree: FrameTree, names: Sequence[str]) -> NoTransform:
    """Return the error with what else is known: the publishers of the edges in question, publishers whose messages are
    not received or that are silent, and what the description says of the frame.
    """
    tellers = await tellers_of(source, tree)
    where = followed_in_words(source, tree)
    if error.reason not in ("never published", "unknown frame", "two trees"):
        who = [*_who_tells(tree, names, tellers, error.reason), *_not_simulated(tree, names, tellers, error.reason)]
        return NoTransform(error.reason, " ".join([error.message, *who, *where]), error.hint)
    more = [*where, *await unheard_publishers(source)]
    if error.reason == "never published" and (absence := (await source.graph()).absence):
        more.append(absence)
    if listener := source.transforms:
        more += silent_in_words(tellers, listener.listened_s)
    more += [
        f"The transform {named(edge.refused_parent)} → {named(edge.child)} is published but rejected: {edge.refused}."
        for edge in tree.edges.values()
        if edge.refused and edge.refused not in error.message
    ][:_MOST_TOLD]
    if tree.nameless:
        more.append(f"{counted(tree.nameless, 'transform')} came with an empty child_frame_id.")
    if error.reason == "two trees" and (pair := alike(tree, names[1], names[0])):
        concerned = [edge for edge in tree.edges.values() if {edge.child, *edge.parents} & set(pair)]
        who = [(edge, tellers.by_whom(edge, edge.parents[-1])) for edge in concerned if edge.parents]
        told = [f"{edge_in_words(edge)}{by}" for edge, by in who if by]
        more += [f"Published: {', '.join(told[:_MOST_TOLD])}."] if told else []
    if unknown := next((name for name in names if name not in tree.frames), ""):
        more += filter(None, [await described_frame(source, unknown)])
    return NoTransform(error.reason, " ".join([error.message, *more]), error.hint)


def _who_tells(tree: FrameTree, names: Sequence[str], tellers: Tellers, reason: str) -> list[str]:
    """Return the publishers of the edges behind an error; for a frame with two parents, of both edges."""
    steps = {edge.child: edge for name in names if name in tree.frames for edge in tree.way_up(name)}
    roots = [tree.edges.get(tree.root_of(name)) for name in names if name in tree.frames]
    steps |= {edge.child: edge for edge in roots if edge and edge.refused}
    told: list[str] = []
    for edge in steps.values():
        if reason == "two parents" and not edge.two_parents:
            continue
        for parent in edge.parents if edge.two_parents else edge.parents[-1:] or [edge.refused_parent]:
            if who := tellers.by_whom(edge, parent):
                told.append(f"{named(parent)} → {named(edge.child)}{who}")
    return [f"Published: {', '.join(told[:_MOST_TOLD])}."] if told else []


def _not_simulated(tree: FrameTree, names: Sequence[str], tellers: Tellers, reason: str) -> list[str]:
    """Report publishers that stamp by the robot's clock while the others use simulated time."""
    if reason != "two clocks" or not tree.has_clock:
        return []
    edges = {edge.child: edge for name in names for edge in tree.way_up(name) if edge.moving}.values()
    wall = [edge for edge in edges if abs(edge.lag_ns) < OTHER_CLOCK_NS]
    found: list[str] = []
    for edge in wall if len(wall) < len(edges) else ():
        who = tellers.of(edge) or f"whoever publishes {edge_in_words(edge)}"
        found.append(f"/clock is published, but {who} does not use it: use_sim_time is not set there.")
    return found


def _wall_ns(source: Source, time: str) -> int:
    """Parse the caller's time; relative times count from now, or from the recording's beginning or end."""
    covers = source.covers_ns
    if covers is None:
        listener = source.transforms
        return parsed_ns("time", time, None, listener.now_ns() if listener else 0)
    return parsed_ns("time", time, source.began_ns if source.began_ns is not None else covers[0], covers[1] - 1)


# ── over a duration ──────────────────────────────────────────────────────────────────────────────────────────────────


async def _over(
    source: Source, target: str, frame: str, request: LookupRequest, report: Report
) -> tuple[FrameTree, Located, Spread]:
    """Return the mean transform over a duration: live from now on; in a recording up to the requested time, or its
    end.
    """
    assert request.duration_s is not None
    length_ns = round(request.duration_s * 1e9)
    tree, first = await _at(source, target, frame, request.time, None, report)
    if first.stamp_ns is None:
        return tree, first, _spread([first.pose])
    if source.is_live:
        if request.time:
            raise BadInput("Give either time or duration_s, not both.", "On a live robot, a duration starts now.")
        poses = await _listened(source, tree, first, request.duration_s, report)
    else:
        poses = _poses(tree, first, first.stamp_ns - length_ns, first.stamp_ns)
    located = replace(tree.find(target, frame) or first, pose=mean_of(list(poses.values())))
    return tree, located if source.is_live else replace(first, pose=located.pose), _spread(list(poses.values()))


async def _listened(
    source: Source, tree: FrameTree, first: Located, duration_s: float, report: Report
) -> Mapping[int, Pose]:
    assert first.stamp_ns is not None and source.transforms
    poses = {first.stamp_ns: first.pose}
    deadline = monotonic() + duration_s
    async with reporting(report, duration_s, lambda: f"{len(poses)} poses"):
        while (left_s := deadline - monotonic()) > 0:
            await anyio.sleep(min(left_s, _LOOK_S))
            tree = await source.transforms.listening()
            common_ns = tree.common_ns(first.target, first.frame)
            if common_ns is None:
                raise why_none(tree, first.target, first.frame, None)
            poses |= _poses(tree, first, max(poses) + 1, common_ns)
    return poses


def _poses(tree: FrameTree, located: Located, from_ns: int, until_ns: int) -> dict[int, Pose]:
    """Return the pose at each stamp of the chain's edges between two times; if there are too many, at every n-th."""
    stamps = sorted({stamp for edge in located.edges for stamp in edge.stamps if from_ns <= stamp <= until_ns})
    found: dict[int, Pose] = {}
    for stamp in stamps[:: len(stamps) // _MOST_POSES + 1]:
        if there := tree.find(located.target, located.frame, stamp):
            found[stamp] = there.pose
    return found


def _spread(poses: Sequence[Pose]) -> Spread:
    mean = mean_of(poses)
    away = [[a - b for a, b in zip(pose.translation, mean.translation, strict=True)] for pose in poses]
    angles = [math.degrees(angle_between_rad(mean.rotation, pose.rotation)) for pose in poses]

    def deviation(parts: Sequence[float]) -> float:
        return math.sqrt(sum(part * part for part in parts) / len(parts))

    return Spread(
        count=len(poses),
        std_x_m=deviation([one[0] for one in away]),
        std_y_m=deviation([one[1] for one in away]),
        std_z_m=deviation([one[2] for one in away]),
        std_deg=deviation(angles),
        max_deviation_m=max(math.hypot(*one) for one in away),
        max_deviation_deg=max(angles),
        moved_m=math.dist(poses[0].translation, poses[-1].translation),
        turned_deg=math.degrees(angle_between_rad(poses[0].rotation, poses[-1].rotation)),
    )


# ── the answer ───────────────────────────────────────────────────────────────────────────────────────────────────────


async def _answer(
    source: Source,
    request: LookupRequest,
    tree: FrameTree,
    located: Located,
    spread: Spread | None,
    transformed: Sequence[Sequence[float]] | None,
    notes: list[str],
) -> Lookup:
    stamp_ns, clock_ns = located.stamp_ns, tree.clock_ns
    listener = source.transforms
    covers = source.covers_ns
    if listener:
        reference_ns = listener.now_ns()
    elif request.time or covers is None:
        reference_ns = (stamp_ns or 0) + clock_ns
    else:
        reference_ns = covers[1]
    tellers = await tellers_of(source, tree)
    moves = any(edge.moving for edge in located.edges)
    stands = await standing_time(source, tree, reference_ns) if moves else ""
    is_within = not source.is_live and bool(request.time)
    rows = [
        edge_row(tree, edge, reference_ns, tellers, time_stands=bool(stands), is_within=is_within)
        for edge in located.edges
    ]
    notes += [stands] if stands else []
    notes += [in_words(row) for row in rows if row.problem]
    began_ns = None if clock_ns else source.began_ns
    notes += [*_gaps(located, began_ns), *followed_in_words(source, tree)]
    notes += [undecodable(tree.damaged, tree.trouble)] if tree.damaged else []
    notes += await other_clock(source, tree)
    # For a requested time in a recording the pose is that of this time, and so has no age.
    age_ns = None if stamp_ns is None or is_within else reference_ns - stamp_ns - clock_ns
    unstamped = [edge.last_received_ns for edge in located.edges if edge.unstamped and not edge.moving]
    if stamp_ns is None and unstamped:
        age_ns = max(reference_ns - min(unstamped), 0)
    roll, pitch, yaw = map(math.degrees, located.pose.roll_pitch_yaw_rad)
    return Lookup(
        target=located.target,
        source=located.frame,
        translation=Xyz(*located.pose.translation),
        rotation=Xyzw(*located.pose.rotation),
        roll_deg=roll,
        pitch_deg=pitch,
        yaw_deg=yaw,
        distance_m=located.pose.distance_m,
        stamp=None if stamp_ns is None else stamp_in_words(stamp_ns, began_ns),
        stamp_ns=None if stamp_ns is None else str(stamp_ns),
        age_s=None if age_ns is None else microseconds(age_ns / 1e9),
        is_static=stamp_ns is None and not unstamped,
        chain=located.chain,
        edges=rows,
        spread=spread,
        transformed=transformed,
        read_from="live" if source.is_live else source.words,
        note=" ".join(notes),
    )


def _gaps(located: Located, began_ns: int | None) -> list[str]:
    """Report edges with a gap at that time, across which the pose is interpolated."""
    found: list[str] = []
    for edge in located.edges if located.stamp_ns is not None else ():
        at_ns = located.stamp_ns or 0
        before_ns, after_ns = edge.around(at_ns) or (at_ns, at_ns)
        if after_ns - before_ns > _LONG_GAP_NS:
            found.append(
                f"{edge_in_words(edge)} was not published for {seconds_in_words(after_ns - before_ns)} around that "
                f"time, from {stamp_in_words(before_ns, began_ns)} to {stamp_in_words(after_ns, began_ns)}: "
                f"the nearest transforms are {seconds_in_words(at_ns - before_ns)} before and "
                f"{seconds_in_words(after_ns - at_ns)} after it, and this pose is interpolated between them."
            )
    return found
