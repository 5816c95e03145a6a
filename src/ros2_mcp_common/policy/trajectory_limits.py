"""Whether the whole curve of a trajectory keeps to its limits, from where the joints are measured to be. Needs no ROS.

A trajectory is a trajectory_msgs/msg/JointTrajectory, as a JSON object or as a message. `curves.py` has the curve.

A trajectory that cannot be judged is refused. So is one that no two controllers follow alike: points without positions,
accelerations without velocities (ros2_controllers then commands zeros), a joint that is named twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from ros2_mcp_common.policy.curves import Segment, State, at, extremes, hull, segment, segments
from ros2_mcp_common.policy.field_values import Unfit, fields_of, get, is_list, number_at, number_of

# A first point that is to be reached at once is where the joints are, but for the noise of encoders and the rest that a
# planner's start state leaves (MoveIt allows 0.01 rad by default).
AT_ONCE = 0.01
# Limits hold but for rounding: of sums of floats, and of times to nanoseconds.
_ROUNDING = 1 + 1e-9
# Of a step of speed where none is allowed: the end of one polynomial and the beginning of the next, both rounded.
_NO_STEP = 1e-6
# A measured speed below this is the noise of an encoder: the joint stands. In rad/s, or m/s.
_STANDS = 0.02
# Between the measurement of a joint and the moment at which a controller takes its start: joint states come at 10 to
# 1,000 Hz, and a trajectory needs some hundredths of a second. A joint that moves has moved on by then.
_LATE_S = 0.1
# A joint that stands at a limit is measured beyond it now and then: by this share of its range, and no more than that
# in rad or m (encoders' noise).
_NOISE_SHARE, _MOST_NOISE = 0.001, 0.002
# Joints half a turn away: noise decides which way round is the shorter one.
_EITHER_WAY = 0.02
# More joints than any robot of one controller has; more would take too long to be judged.
MAX_JOINTS = 100


@dataclass(frozen=True)
class JointBounds:
    """What one joint may do; None: no bound. `wraps`: it turns without end (a continuous joint), so that a controller
    may add whole turns to where it is, and take the shorter way round.
    """

    low: float | None = None
    high: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    wraps: bool = False


@dataclass(frozen=True)
class CurveLimits:
    """What the curve of a trajectory may do.

    `speed`, `acceleration` and `position` (least, largest) hold for each joint. `joints` has stricter bounds of some by
    name; where it has any, no other joint may be moved. `described`: the limits of the robot's description (URDF) hold,
    too. `step` is how far the speed may jump at a point, as it does between straight lines; without it, and with a
    bound of acceleration, it may not jump at all.
    """

    speed: float | None = None
    acceleration: float | None = None
    step: float | None = None
    position: tuple[float, float] | None = None
    joints: Mapping[str, JointBounds] = field(default_factory=dict[str, JointBounds])
    described: bool = True

    def of(self, name: str, described: Mapping[str, JointBounds]) -> JointBounds:
        """All bounds of one joint, the stricter ones; raises `Unfit` where it may not be moved."""
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
    """What is known of joints now, by name: how they move (`speed` is None where nobody tells it), and their limits in
    the robot's description.
    """

    measured: Mapping[str, State] = field(default_factory=dict[str, State])
    described: Mapping[str, JointBounds] = field(default_factory=dict[str, JointBounds])


LookAtJoints = Callable[[Sequence[str]], Joints]
"""Gives what is known of the joints of these names; raises `ValueError`, in words, where they are not measured."""


def nobody_measures(_names: Sequence[str]) -> Joints:
    """Where nothing can be asked."""
    raise ValueError("it is not known where the joints are")


# ── reading ────────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True)
class Path:
    """The points of a trajectory: `times` in s from its arrival, and `states[point][joint]` in the order of `names`."""

    names: Sequence[str]
    times: Sequence[float]
    states: Sequence[Sequence[State]]


def read(trajectory: Any) -> Path:
    """The points of a trajectory that begins when it arrives; raises `Unfit`, in words, for one that is not judged."""
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
    """The `time_from_start` of a point, in s."""
    since = get(point, "time_from_start")
    return number_at(since, "sec", shown) + number_at(since, "nanosec", shown) / 1e9


def states_at(point: Any, count: int, shown: str) -> Sequence[State]:
    """What a point carries of each of so many joints; raises `Unfit`."""
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
    """One way to a point (its place in the trajectory) that a controller may take. `is_first`: from where it was."""

    to: int
    segment: Segment
    is_first: bool = False


def ways(path: Path, joint: int, measured: State, *, wraps: bool) -> Iterator[Sequence[Way]]:
    """For each point, all ways of one joint to it; none to a first point that is to be reached at once.

    Raises `Unfit` where that is not where the joint is.
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
    """Where a controller may take a joint to be that moves to a position: where it was measured to be, where it is by
    now, and, if it wraps, the same with whole turns added, so that the way is the shorter one.
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
    """The states from which a controller may begin, by what it measures besides positions: ros2_controllers takes the
    speed where there is a state interface for it, and the acceleration where there is one for that, too. The first
    segment is a line, a cubic or a quintic accordingly, whatever the first point carries.
    """
    speeds: list[float | None] = [None]
    if first.speed is not None:
        speeds = [measured.speed, 0.0]  # None, where nobody tells it: a line
    for start in starts:
        for speed in dict.fromkeys(speeds):
            yield State(start, speed)
            if speed is not None and first.acceleration is not None:
                yield State(start, speed, 0.0)


@dataclass(frozen=True)
class Extremes:
    """What one joint does at most on its way."""

    low: float
    high: float
    speed: float
    acceleration: float


def extremes_of(path: Path, joints: Joints) -> Mapping[str, Extremes]:
    """The true extremes of each joint, by name; raises `Unfit`."""
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
    """Whether its controller may add whole turns, also where the description does not tell."""
    return joints.described[name].wraps if name in joints.described else True


def positions_at(path: Path, joints: Joints, time_s: float) -> Mapping[str, float]:
    """Where each joint is at a time from the arrival on, as ros2_controllers leads it; raises `Unfit`."""
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
    """What of the whole curve is beyond its limits, in words; empty if nothing is."""
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
    """The same, of one joint, which may go these ways to its points."""
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
        # A curve begins with the speed that is measured, or that the controller takes for it: no step of its own.
        leaving = [_speed_at(way, 0.0) for way in choices if not way.is_first or way.segment.is_straight]
        if found := _step(arriving, leaving, most_step):
            return f"{name} {found} before points[{to}]"
        arriving = [_speed_at(way, 1.0) for way in choices]
    if len(path.times) == 1 and path.times[0] == 0:
        return ""  # it is held where it is
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
    """What of one way is beyond its bounds. Where the joint is out of them already, it may go no farther."""
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
    """Between which positions a joint may be that begins here, in its range or beyond it. Each way begins where the one
    before ended, so that a joint that is out of its range comes back, and goes no farther.
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
    """The extreme of a polynomial, in units, that is beyond these bounds, and what is allowed; None if it is within."""
    room = _ROUNDING - 1
    least = -math.inf if low is None else (low - room * max(1.0, abs(low))) * unit
    most = math.inf if high is None else (high + room * max(1.0, abs(high))) * unit
    smallest, largest = -math.inf, math.inf
    if math.isfinite(sum(map(abs, polynomial))):
        for bounds in (hull, extremes):  # the first one is quick, and says too much
            smallest, largest = bounds(polynomial)
            if least <= smallest and largest <= most:
                return None
    allowed = f"{'any' if low is None else f'{low:g}'} to {'any' if high is None else f'{high:g}'}"
    return (smallest if not least <= smallest else largest) / unit, allowed
