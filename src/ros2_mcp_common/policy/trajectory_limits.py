"""Check whether the whole curve of a trajectory, from the measured joint positions on, is within
its limits. Needs no ROS.

A trajectory is a trajectory_msgs/msg/JointTrajectory, as a JSON object or a message. `curves.py` computes the curve.

A trajectory that cannot be judged is refused. So is one that controllers execute differently: with points without
positions, with accelerations without velocities (ros2_controllers then commands zeros), or with a joint named twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from ros2_mcp_common.policy.curves import Segment, State, at, extremes, hull, segment, segments
from ros2_mcp_common.policy.field_values import Unfit, fields_of, get, is_list, number_at, number_of

# The largest distance of a joint from a first point that is to be reached at once: the noise of encoders, and the
# difference that a planner's start state may have (MoveIt allows 0.01 rad by default).
AT_ONCE = 0.01
# A tolerance for rounding: of sums of floats, and of times to nanoseconds.
_ROUNDING = 1 + 1e-9
# A tolerance for a step of speed where none is allowed: one polynomial ends and the next begins there, both rounded.
_NO_STEP = 1e-6
# A measured speed below this (rad/s or m/s) is noise of an encoder: the joint is at rest.
_STANDS = 0.02
# The longest time from the measurement of a joint until a controller takes its start state: joint states come at 10 to
# 1,000 Hz, and a trajectory takes some hundredths of a second. A moving joint has moved on by then.
_LATE_S = 0.1
# A joint at rest at a limit is sometimes measured beyond it, because of noise: by up to this share of its range,
# and not more than this distance (rad or m).
_NOISE_SHARE, _MOST_NOISE = 0.001, 0.002
# Within this distance (rad) of half a turn, noise decides which way round is shorter.
_EITHER_WAY = 0.02
# More joints than one controller of any robot has; judging more would take too long.
MAX_JOINTS = 100


@dataclass(frozen=True)
class JointBounds:
    """The bounds of one joint: position in rad (m if prismatic), speed per second, acceleration
    per second²; None: no bound.

    `wraps`: the joint is continuous, so that a controller may add whole turns to its position and take the shorter way.
    """

    low: float | None = None
    high: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    wraps: bool = False


@dataclass(frozen=True)
class CurveLimits:
    """The limits on the curve of a trajectory.

    `speed`, `acceleration` and `position` (least, largest) hold for each joint. `joints` has stricter bounds of some
    joints by name; if it has any, no other joint may be moved. `described`: the limits of the robot's description
    (URDF) hold, too. `step` is how far the speed may jump at a point, as it does between straight lines. Without it,
    and with a bound on acceleration, the speed may not jump at all.
    """

    speed: float | None = None
    acceleration: float | None = None
    step: float | None = None
    position: tuple[float, float] | None = None
    joints: Mapping[str, JointBounds] = field(default_factory=dict[str, JointBounds])
    described: bool = True

    def of(self, name: str, described: Mapping[str, JointBounds]) -> JointBounds:
        """Return the bounds of one joint, the strictest of all that apply.

        Raises:
            Unfit: if the joint may not be moved, or its speed is not bounded.
        """
        if self.joints and name not in self.joints:
            raise Unfit(f"the joint {name!a} may not be moved, only {', '.join(self.joints)}")
        low, high = self.position or (None, None)
        all_bounds = [JointBounds(low, high, self.speed, self.acceleration), self.joints.get(name, JointBounds())]
        all_bounds += [described.get(name, JointBounds())] if self.described else []

        def least(bounds: Iterable[float | None]) -> float | None:
            return min((each for each in bounds if each is not None), default=None)

        found = JointBounds(
            max((each.low for each in all_bounds if each.low is not None), default=None),
            least(each.high for each in all_bounds),
            least(each.speed for each in all_bounds),
            least(each.acceleration for each in all_bounds),
        )
        if found.speed is None:
            why = "neither the policy nor the robot's description bounds its speed"
            raise Unfit(f"the joint {name!a} cannot be judged: {why}")
        return found


@dataclass(frozen=True)
class Joints:
    """The current joint states by name (`speed` is None if it is not reported), and the limits
    in the robot's description.
    """

    measured: Mapping[str, State] = field(default_factory=dict[str, State])
    described: Mapping[str, JointBounds] = field(default_factory=dict[str, JointBounds])


LookAtJoints = Callable[[Sequence[str]], Joints]
"""Returns the joint states and described limits for these names.

Raises `ValueError`, in words, if they are not measured.
"""


def nobody_measures(_names: Sequence[str]) -> Joints:
    """Raise `ValueError`: the `LookAtJoints` for when no joint states are available."""
    raise ValueError("it is not known where the joints are")


# ── reading ────────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True)
class Path:
    """The points of a trajectory: `times` in s after its arrival, and
    `states[point][joint]` in the order of `names`.
    """

    names: Sequence[str]
    times: Sequence[float]
    states: Sequence[Sequence[State]]


def read(trajectory: Any) -> Path:
    """Return the points of a trajectory that begins when it arrives.

    Raise `Unfit`, in words, if it cannot be judged.
    """
    if "header" in fields_of(trajectory):
        stamp = get(get(trajectory, "header"), "stamp")
        if number_at(stamp, "sec", "header.stamp") or number_at(stamp, "nanosec", "header.stamp"):
            raise Unfit("header.stamp is not zero: a trajectory is judged as one that begins when it arrives")
    names = [str(name) for name in get(trajectory, "joint_names")]
    points = get(trajectory, "points")
    if not is_list(points) or not len(points) or not names:
        raise Unfit("there are no points" if names else "there are no joint names")
    if len(names) > MAX_JOINTS or len(set(names)) < len(names):
        twice = next((name for name in names if names.count(name) > 1), "")
        raise Unfit(f"the joint {twice!a} is named twice" if twice else f"there are {len(names)} joints")
    times = [seconds(point, f"points[{place}]") for place, point in enumerate(points)]
    if not (times[0] >= 0 and all(after > before for before, after in pairwise(times))):
        place = next((place + 1 for place, two in enumerate(pairwise(times)) if not two[1] > two[0]), 0)
        raise Unfit(f"points[{place}].time_from_start is not later than that of the point before")
    return Path(names, times, [states_at(point, len(names), f"points[{place}]") for place, point in enumerate(points)])


def seconds(point: Any, shown: str) -> float:
    """Return the `time_from_start` of a point, in s."""
    since = get(point, "time_from_start")
    return number_at(since, "sec", shown) + number_at(since, "nanosec", shown) / 1e9


def states_at(point: Any, count: int, shown: str) -> Sequence[State]:
    """Return the state of each of `count` joints at a point. Raise `Unfit` if the point does not have all of them."""
    if not count:
        raise Unfit(f"{shown} has no positions")
    columns: list[Sequence[float | None]] = []
    for name in ("positions", "velocities", "accelerations"):
        found = get(point, name) if name in fields_of(point) or name == "positions" else ()
        column = [number_of(each, f"{shown}.{name}") for each in found]
        if len(column) not in ((count,) if name == "positions" else (0, count)):
            raise Unfit(f"{shown}.{name} has {len(column)} numbers for {count} joints")
        if not all(map(math.isfinite, column)):
            raise Unfit(f"{shown}.{name} has a number that is not finite")
        columns.append(column or [None] * count)
    if columns[2][0] is not None and columns[1][0] is None:
        raise Unfit(f"{shown} has accelerations but no velocities: a controller would command zeros. Add velocities")
    return [State(position or 0.0, speed, bent) for position, speed, bent in zip(*columns, strict=True)]


# ── the curve ──────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True)
class Way:
    """A segment along which a controller may move a joint to the point with index `to`.

    `is_first`: the segment begins at the measured state.
    """

    to: int
    segment: Segment
    is_first: bool = False


def ways(path: Path, joint: int, measured: State, *, wraps: bool) -> Iterator[Sequence[Way]]:
    """Yield, for each point, all segments along which one joint may move to it; none for a first
    point to be reached at once.

    Raises:
        Unfit: if such a first point is not where the joint is.
    """
    states = [row[joint] for row in path.states]
    first, time_s = states[0], path.times[0]
    if time_s > 0:
        starts = _starts(measured, first.position, wraps=wraps)
        yield [Way(0, segment(start, first, time_s), is_first=True) for start in _carried(starts, measured, first)]
    elif not (gap := max(abs(first.position - start) for start in _starts(measured))) <= AT_ONCE:
        raise Unfit(f"points[0] is to be reached at once, and {path.names[joint]!a} is {gap:.3g} away from it")
    for place, (before, after) in enumerate(pairwise(zip(states, path.times, strict=True)), 1):
        yield [Way(place, each) for each in segments(before[0], after[0], after[1] - before[1])]


def _starts(measured: State, to: float | None = None, *, wraps: bool = False) -> Sequence[float]:
    """Return the positions from which a controller may move a joint to the position `to`.

    These are the measured position, the position by now, and, if the joint wraps, the same with whole turns added, so
    that the way is the shorter one.
    """
    starts = [measured.position]
    if abs(measured.speed or 0.0) > _STANDS:
        starts.append(measured.position + _LATE_S * (measured.speed or 0.0))
    if wraps and to is not None:
        for start in tuple(starts):
            way = math.remainder(to - start, 2 * math.pi)
            starts.append(to - way)
            if math.pi - abs(way) < _EITHER_WAY:
                starts.append(to - way + math.copysign(2 * math.pi, way))
    return list(dict.fromkeys(starts))


def _carried(starts: Sequence[float], measured: State, first: State) -> Iterator[State]:
    """Yield the states from which a controller may begin: these depend on what it measures besides positions.

    ros2_controllers takes the speed if there is a state interface for it, and the acceleration if there is one for
    that, too. The first segment is a line, a cubic or a quintic accordingly, whatever the first point contains.
    """
    speeds: list[float | None] = [None]
    if first.speed is not None:
        speeds = [measured.speed, 0.0]  # None, if it is not measured: a line
    for start in starts:
        for speed in dict.fromkeys(speeds):
            yield State(start, speed)
            if speed is not None and first.acceleration is not None:
                yield State(start, speed, 0.0)


@dataclass(frozen=True)
class Extremes:
    """The extreme positions of one joint on its way, and its largest speed and acceleration."""

    low: float
    high: float
    speed: float
    acceleration: float


def extremes_of(path: Path, joints: Joints) -> Mapping[str, Extremes]:
    """Return the true extremes of each joint along the curve, by name.

    Raise `Unfit` if the trajectory cannot be judged.
    """
    found: dict[str, Extremes] = {}
    for joint, name in enumerate(path.names):
        places, speeds, bends = [path.states[0][joint].position], [0.0], [0.0]
        for choices in ways(path, joint, _measured(joints, name), wraps=_wraps(joints, name)):
            for one in (choice.segment for choice in choices):
                places += extremes(one.position)
                speeds += (abs(each) / one.seconds for each in extremes(one.speed))
                if not one.is_straight:
                    bends += (abs(each) / one.seconds**2 for each in extremes(one.acceleration))
        found[name] = Extremes(min(places), max(places), max(speeds), max(bends))
    return found


def _measured(joints: Joints, name: str) -> State:
    if name not in joints.measured:
        raise Unfit(f"it is not known where the joint {name!a} is")
    return joints.measured[name]


def _wraps(joints: Joints, name: str) -> bool:
    """Return whether the controller may add whole turns; True for a joint that is not described."""
    return joints.described[name].wraps if name in joints.described else True


def positions_at(path: Path, joints: Joints, time_s: float) -> Mapping[str, float]:
    """Return the joint positions `time_s` seconds after the trajectory arrives, interpolated as by ros2_controllers.

    Raises:
        Unfit: if the trajectory cannot be judged.
    """
    found: dict[str, float] = {}
    for joint, name in enumerate(path.names):
        found[name] = path.states[-1][joint].position
        for choices in ways(path, joint, _measured(joints, name), wraps=False):
            if time_s <= path.times[choices[0].to]:
                one = choices[0].segment
                found[name] = at(one.position, max(0.0, time_s - path.times[choices[0].to] + one.seconds) / one.seconds)
                break
    return found


# ── judging ────────────────────────────────────────────────────────────────────────────────────────────────────────


def problem(trajectory: Any, limits: CurveLimits, look: LookAtJoints) -> str:
    """Return in words which limit the whole curve exceeds; "" if it exceeds none."""
    try:
        path = read(trajectory)
        bounded = {name: limits.of(name, {}) for name in path.names} if not limits.described else {}
        joints = look(path.names)
        for joint, name in enumerate(path.names):
            bounds = bounded.get(name) or limits.of(name, joints.described)
            choices = list(ways(path, joint, _measured(joints, name), wraps=_wraps(joints, name)))
            if found := _problem_of(path, joint, _measured(joints, name), choices, bounds, limits.step):
                return found
    except (Unfit, ValueError) as unfit:
        return str(unfit)
    return ""


def _problem_of(
    path: Path,
    joint: int,
    measured: State,
    ways_to: Sequence[Sequence[Way]],
    bounds: JointBounds,
    step: float | None,
) -> str:
    """Return the same as `problem` for one joint that may move along these segments to its points."""
    name = ascii(path.names[joint])[1:-1]
    most_step = step if step is not None else _NO_STEP if bounds.acceleration is not None else math.inf
    speed = measured.speed or 0.0
    arriving = [speed if abs(speed) > _STANDS else 0.0]
    if path.times[0] == 0 and (found := _outside([path.states[0][joint].position], *_reached(bounds, measured), 1.0)):
        return f"{name} would be at {found[0]:.4g}, {found[1]} is allowed, at points[0]"
    for choices in ways_to:
        to = choices[0].to
        for way in choices:
            if found := _beyond(way, bounds, measured):
                return f"{name} {found} on its way to points[{to}]"
        # A curve begins with the speed that is measured, or that the controller assumes: it has no step of its own.
        leaving = [_speed_at(way, 0.0) for way in choices if not way.is_first or way.segment.is_straight]
        if found := _step(arriving, leaving, most_step):
            return f"{name} {found} before points[{to}]"
        arriving = [_speed_at(way, 1.0) for way in choices]
    if len(path.times) == 1 and path.times[0] == 0:
        return ""  # the joint is held where it is
    found = _step(arriving, [0.0], most_step)
    return f"{name} {found} at its last point" if found else ""


def _speed_at(way: Way, s: float) -> float:
    return at(way.segment.speed, s) / way.segment.seconds


def _step(arriving: Sequence[float], leaving: Sequence[float], most: float) -> str:
    step = max((abs(after - before) for before in arriving for after in leaving), default=0.0)
    if step <= most * _ROUNDING:
        return ""
    hint = " (with velocities in every point there is none)" if most == _NO_STEP else ""
    return f"changes its speed at once by {step:.3g}, at most {0.0 if most == _NO_STEP else most:g} is allowed{hint}"


def _beyond(way: Way, bounds: JointBounds, measured: State) -> str:
    """Return how one segment exceeds the bounds; "" if it does not.

    A joint that is out of its range may not go farther out.
    """
    one, fast = way.segment, bounds.speed
    if way.is_first and fast is not None:
        fast = max(fast, abs(measured.speed or 0.0))
    low, high = _reached(bounds, State(one.position[0]), is_measured=way.is_first)
    if found := _outside(one.position, low, high, 1.0):
        return f"would be at {found[0]:.4g}, {found[1]} is allowed,"
    if fast is not None and (found := _outside(one.speed, -fast, fast, one.seconds)):
        return f"would run at {abs(found[0]):.4g} per second, at most {fast:g} is allowed,"
    bent = bounds.acceleration
    if bent is not None and not one.is_straight:
        found = _outside(one.acceleration, -bent, bent, one.seconds**2)
        return f"would accelerate by {abs(found[0]):.4g} per second², at most {bent:g} is allowed," if found else ""
    return ""


def _reached(bounds: JointBounds, start: State, *, is_measured: bool = True) -> tuple[float | None, float | None]:
    """Return the bounds of the positions of a joint that begins at `start`, in its range or beyond it.

    Each segment begins where the one before ended, so a joint that is out of its range may come
    back, but not go farther out.
    """
    low, high, noise = bounds.low, bounds.high, 0.0
    if is_measured and low is not None and high is not None:
        noise = min(_MOST_NOISE, _NOISE_SHARE * max(0.0, high - low))
    if low is not None and start.position < low + noise:
        low = min(low - noise, start.position)
    if high is not None and start.position > high - noise:
        high = max(high + noise, start.position)
    return low, high


def _outside(
    polynomial: Sequence[float], low: float | None, high: float | None, unit: float
) -> tuple[float, str] | None:
    """Return the extreme of a polynomial, divided by `unit`, that is beyond the bounds, and the
    allowed range; None if within.
    """
    room = _ROUNDING - 1
    least = -math.inf if low is None else (low - room * max(1.0, abs(low))) * unit
    most = math.inf if high is None else (high + room * max(1.0, abs(high))) * unit
    smallest, largest = -math.inf, math.inf
    if math.isfinite(sum(map(abs, polynomial))):
        for bounds in (hull, extremes):  # the hull is fast, but may be too wide
            smallest, largest = bounds(polynomial)
            if least <= smallest and largest <= most:
                return None
    allowed = f"{'any' if low is None else f'{low:g}'} to {'any' if high is None else f'{high:g}'}"
    return (smallest if not least <= smallest else largest) / unit, allowed
