"""One frame and its parent over time: the transforms received, and their faults by the rules of tf2."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, pairwise
from typing import TypeVar

from ros2_mcp.model.poses import Pose, angle_between_rad, between

KEPT_NS = 30_000_000_000
"""Duration for which a live tree keeps transforms. tf2 keeps 10 s; an agent asks some seconds after an event."""
_JUMP_NS = 2_000_000_000
"""A stamp that goes back by more is not just late: localisations stamp up to 1 s ahead, and networks delay less."""
_FASTEST = 10.0
"""Simulated time runs at most this many times as fast as wall time; a stamp that advances faster has jumped."""
_MOST_JUMPS = 50
_LOOKED_BACK = 60
"""Recent transforms of an edge that are checked for two parents or two publishers: some seconds."""
_PAUSES, _LEAST_PAUSE_NS, _ONCE_NS = 3, 1_000_000_000, 5_000_000_000
"""A publisher has ended if it was silent for three times its longest pause, and for at least a second; a publisher of a
single message (of unknown rate) after 5 s.
"""
_RATED = 100
"""Messages from which the rate is computed."""
_PAUSE_NS, _PAUSE_STEPS = 500_000_000, 4
"""The least pause between two bursts, and the least ratio of such a pause to the step of the stamps over it: transforms
that are rarely sent have steps as long as their pauses."""
_AT_ONCE, _LEAST_BURST, _LEAST_SPAN_NS = 20, 5, 1_000_000_000
"""A single burst: messages arrive at least this many times as fast as their stamps advance (twice the fastest simulated
time); the least number of messages; and their least span."""
_MOST_PAUSES = 50
_LEAP_M, _LEAP_M_S, _LEAP_DEG, _LEAP_DEG_S = 0.25, 10.0, 30.0, 720.0
"""A step of at least this distance and speed is no motion of a robot, if the steps before and after it are slow."""
_LEAP_TIMES = 5
"""A leap is at least this many times as fast as its neighbouring steps: all steps of a car or a fast wheel are
large."""
_MOST_LEAPS = 100
_MOST_FOLLOWED = 64
"""Publishers that are tracked per edge."""
_Value = TypeVar("_Value", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Told:
    """One received transform of a frame: its parent, and its pose in the parent. Times are Unix times in ns.

    `writer` distinguishes the publishers of one topic (`writers.py`); 0 if not known.
    """

    parent: str
    pose: Pose
    stamp_ns: int
    received_ns: int
    writer: int = 0


@dataclass(frozen=True, slots=True)
class Jump:
    """A jump of the stamps of a frame's transforms, back or too far ahead. Times in ns."""

    child: str
    from_ns: int
    to_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class Leap:
    """A step between two transforms of one publisher that is too far and too fast for a motion."""

    far_m: float
    turned_deg: float
    within_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class Bursts:
    """Messages that arrive in bursts: `pause_ns` is the pause between two bursts, `count` about how many messages are
    in a burst.
    """

    pause_ns: int
    count: int


@dataclass(slots=True)
class _Steps:
    """A publisher's last transform, the speed (m/s, degrees/s) of the step to it, and a possible leap."""

    told: Told
    speed: tuple[float, float] | None = None
    before: tuple[float, float] = (0.0, 0.0)
    leap: Leap | None = None


class Edge:
    """All received transforms of one frame: `moving` transforms by stamp, and `static` transforms by parent.

    `received` counts the moving ones; `repeated` those among them whose stamp was received before, which tf2 ignores,
    too; and `unstamped` those with stamp 0, of which the last is valid for all times, like a static one.
    `last_received_ns` is the time of receipt of the newest message. `refused` is the reason why the last transform was
    rejected, `refused_parent` its parent, `refused_writer` its publisher, and `refused_ns` its time of receipt. `jumps`
    are those of the stamps. `is_left`: the edge is static and its publisher has ended, so that nodes that start later
    do not receive it. `on_static` is whether the last transform came on /tf_static. `slashed` are the names as
    published, if they have a leading slash; `frozen` counts the last messages in a row that repeated an earlier stamp.
    """

    def __init__(self, child: str) -> None:
        self.child = child
        self.static: dict[str, Told] = {}
        self.moving: list[Told] = []
        self.stamps: list[int] = []
        self.received = 0
        self.repeated = 0
        self.unstamped = 0
        self.last_received_ns = 0
        self.refused = ""
        self.refused_parent = ""
        self.refused_writer = 0
        self.refused_ns = 0
        self.jumps: list[Jump] = []
        self.on_static = False
        self.slashed = ""
        self.frozen = 0
        self.is_left = False
        self._pauses: deque[tuple[int, int]] = deque(maxlen=_MOST_PAUSES)
        self._last_stamp_ns: int | None = None
        self._told_by: deque[tuple[int, int]] = deque(maxlen=_LOOKED_BACK)
        self._static_by: dict[int, Told] = {}
        self._same_time: tuple[Told, Told] | None = None
        self._times: deque[int] = deque(maxlen=_RATED)
        self._steps: dict[int, _Steps] = {}
        self._leaps: deque[Leap] = deque(maxlen=_MOST_LEAPS)

    @property
    def is_static(self) -> bool:
        """Whether the transform is valid for all times."""
        return not self.moving and not self.unstamped and bool(self.static)

    @property
    def newest(self) -> Told | None:
        """The newest transform."""
        if self.moving:
            return self.moving[-1]
        return next(reversed(self.static.values())) if self.static else None

    @property
    def parents(self) -> list[str]:
        """Every parent in the transforms that are kept, except parents whose publisher has ended; the newest last."""
        moving = dict.fromkeys(_still_told((told.parent, told.received_ns) for told in self.moving[-_LOOKED_BACK:]))
        return list({**dict.fromkeys(self.static), **moving})

    @property
    def two_parents(self) -> bool:
        """Whether two parents are published at the same time; a frame that was reparented once has one parent."""
        if len(self.static) > 1 or (self.static and {told.parent for told in self.moving} - set(self.static)):
            return True
        return _turns(_still_told([(told.parent, told.received_ns) for told in self.moving[-_LOOKED_BACK:]])) > 1

    @property
    def writers(self) -> list[int]:
        """The publishers that publish it at the same time, if they can be distinguished."""
        recent = _still_told(self._told_by)
        if _turns(recent) > 1:
            return sorted(set(recent))
        return recent[-1:] or sorted({told.writer for told in self.static.values()}) or [self.refused_writer]

    @property
    def on_both(self) -> bool:
        """Whether it is published both as static and as moving, with one parent."""
        return bool(self.moving) and self.moving[-1].parent in self.static and not self.two_parents

    def static_writers_of(self, parent: str) -> list[int]:
        """Return the publishers on /tf_static that publish it with that parent."""
        return sorted(writer for writer, told in self._static_by.items() if told.parent == parent)

    def static_parent_by(self, writer: int) -> str:
        """Return the parent in the last transform from a publisher on /tf_static."""
        told = self._static_by.get(writer)
        return told.parent if told else self.refused_parent

    def writers_of(self, parent: str) -> list[int]:
        """Return the publishers that published it with that parent, among the last messages."""
        told = [one for one in self.moving[-_LOOKED_BACK:] if one.parent == parent]
        found = {one.writer for one in told or self.static.values() if one.parent == parent}
        return sorted(found) or [self.refused_writer]

    def parent_by(self, writer: int) -> str:
        """Return the parent in a publisher's last transform; the newest parent if none of that publisher is kept."""
        if steps := self._steps.get(writer):
            return steps.told.parent
        if fixed := self._static_by.get(writer):
            return fixed.parent
        return self.newest.parent if self.newest else self.refused_parent

    @property
    def apart(self) -> tuple[float, float] | None:
        """The largest difference, in m and degrees, between the poses from several publishers.

        Poses for the same parent and time are compared. None if there are none.
        """
        by_writer: dict[int, list[Told]] = {}
        for told in self.moving[-_LOOKED_BACK:] if len(self.writers) > 1 else ():
            by_writer.setdefault(told.writer, []).append(told)
        pairs: list[tuple[Told, Told]] = [self._same_time] if self._same_time else []
        for one, other in combinations(by_writer.values(), 2):
            pairs += _at_one_time(one, other)[-1:]
        if self.on_static:
            pairs += combinations(self._static_by.values(), 2)
        if self.on_both:
            pairs.append((self.static[self.moving[-1].parent], self.moving[-1]))
        found = [_apart(*pair) for pair in pairs if pair[0].parent == pair[1].parent]
        return max(found, default=None)

    @property
    def rate_hz(self) -> float | None:
        """Rate in Hz, from the stamps if they advance, otherwise from the times of receipt.

        None for a static transform, or a single one. Messages may arrive in bursts or late; the stamps show the rate of
        the measurements.
        """
        stamps = self.stamps[-_RATED:]
        # Right after a jump there are too few stamps for a rate.
        if len(stamps) > (2 if self.jumps else 1) and stamps[-1] > stamps[0]:
            return (len(stamps) - 1) / (stamps[-1] - stamps[0]) * 1e9
        return self.received_hz

    @property
    def received_hz(self) -> float | None:
        """Rate of messages in Hz, by the times of receipt; None for a static or a single transform."""
        if not self.moving and self.on_static:
            return None
        if len(self._times) < 2:
            return None
        span_ns = max(self._times[-1], self._times[-2]) - self._times[0]
        return (len(self._times) - 1) / span_ns * 1e9 if span_ns > 0 else None

    @property
    def leaps(self) -> list[Leap]:
        """Leaps of the pose within the time that is kept; the newest last."""
        return [leap for leap in self._leaps if leap.received_ns >= self.last_received_ns - KEPT_NS]

    @property
    def bursts(self) -> Bursts | None:
        """The bursts in which messages arrive, although their stamps are evenly spaced; None if they arrive evenly.

        Two pauses are evidence if they make up most of the time. So are so many messages at once that they cannot have
        been sent when they were measured, which shows already in the first burst.
        """
        if len(self.moving) < _LEAST_BURST:
            return None
        first_ns, span_ns = self.moving[0].received_ns, self.stamps[-1] - self.stamps[0]
        heard_ns = self.moving[-1].received_ns - first_ns
        pauses = sorted(pause_ns for received_ns, pause_ns in self._pauses if received_ns > first_ns)
        flows_ns = heard_ns - sum(pauses)
        is_at_once = span_ns >= _LEAST_SPAN_NS and flows_ns * _AT_ONCE < span_ns
        if not is_at_once and (len(pauses) < 2 or 2 * sum(pauses) < heard_ns):
            return None
        if len(self.writers) > 1:  # the publishers stamp differently, which says nothing about the times of receipt
            return None
        count = len(self.moving) // (len(pauses) + 1)
        if pauses:
            return Bursts(pauses[len(pauses) // 2], count) if count >= _LEAST_BURST else None
        return Bursts(span_ns + span_ns // (len(self.stamps) - 1), count)

    def age_ns(self, at_ns: int) -> int:
        """Return the time in ns from the last stamp that is not after `at_ns` to `at_ns`; negative if all stamps are
        after it.
        """
        place = bisect_right(self.stamps, at_ns)
        return at_ns - self.stamps[max(place - 1, 0)]

    def around(self, at_ns: int) -> tuple[int, int] | None:
        """Return the stamps before and after a time; None if the time is a stamp, or outside of all stamps."""
        after = bisect_left(self.stamps, at_ns)
        if after in (0, len(self.stamps)) or self.stamps[after] == at_ns:
            return None
        return self.stamps[after - 1], self.stamps[after]

    def longest_gap(self) -> tuple[int, int] | None:
        """Return the two successive stamps that are farthest apart; None if there are fewer than two."""
        return max(pairwise(self.stamps), key=lambda pair: pair[1] - pair[0], default=None)

    @property
    def lag_ns(self) -> int:
        """Time from the newest stamp to the receipt of the first message that carried it."""
        return self.moving[-1].received_ns - self.stamps[-1]

    def at(self, at_ns: int) -> Told | None:
        """Return the transform at a time; None before the first or after the last stamp."""
        if not self.moving:
            return self.newest
        after = bisect_left(self.stamps, at_ns)
        if after < len(self.stamps) and self.stamps[after] == at_ns:
            return self.moving[after]
        if after in (0, len(self.stamps)):
            return None
        first, second = self.moving[after - 1], self.moving[after]
        if first.parent != second.parent:  # as tf2 does: the old parent is valid until the stamp of the new one
            return Told(first.parent, first.pose, at_ns, first.received_ns, first.writer)
        share = (at_ns - first.stamp_ns) / (second.stamp_ns - first.stamp_ns)
        pose = between(first.pose, second.pose, share)
        return Told(first.parent, pose, at_ns, second.received_ns, second.writer)

    def add_static(self, told: Told) -> None:
        """Add a transform that is valid for all times; it replaces the last transform of the same publisher."""
        for parent, former in list(self.static.items()):
            if parent != told.parent and told.writer and former.writer == told.writer:
                del self.static[parent]
        self.static.pop(told.parent, None)
        self.static[told.parent] = told
        if told.writer:
            self._static_by[told.writer] = told
        self.last_received_ns = max(self.last_received_ns, told.received_ns)

    def add_moving(self, told: Told) -> Jump | None:
        """Add a transform with a stamp. After a jump of the stamps, earlier transforms are discarded.

        Return the jump, if there is one.
        """
        if not told.stamp_ns:
            self.unstamped += 1
            self._count(told.received_ns)
            self.add_static(told)
            return None
        jump = self._jump_to(told)
        if jump:
            self.moving.clear()
            self.stamps.clear()
            self._steps.clear()
            self._pauses.clear()
            first, later = self.jumps[:1], self.jumps[1:]  # the first jump is reported, too
            self.jumps = [*first, *[*later, jump][-(_MOST_JUMPS - len(first)) :]]
        self.received += 1
        self._told_by.append((told.writer, told.received_ns))
        self.last_received_ns = max(self.last_received_ns, told.received_ns)
        self._last_stamp_ns = told.stamp_ns
        self._same_time = None if jump else self._same_time
        place = bisect_right(self.stamps, told.stamp_ns)
        if place and self.stamps[place - 1] == told.stamp_ns:
            self.repeated += 1
            there = self.moving[place - 1]
            self.frozen += 1
            if there.writer != told.writer:
                self._same_time = there, told
            if there.parent == told.parent:
                return jump
        else:
            self.frozen = 0
        self._count(told.received_ns)
        if steps := self._steps.get(told.writer):
            pause_ns = told.received_ns - steps.told.received_ns
            if pause_ns >= max(_PAUSE_NS, _PAUSE_STEPS * abs(told.stamp_ns - steps.told.stamp_ns)):
                self._pauses.append((told.received_ns, pause_ns))
        self._step_to(told)
        self.stamps.insert(place, told.stamp_ns)
        self.moving.insert(place, told)
        return jump

    def _count(self, received_ns: int) -> None:
        self._times.append(received_ns)
        while self._times[0] < received_ns - KEPT_NS:
            self._times.popleft()

    def _jump_to(self, told: Told) -> Jump | None:
        last_ns = self._last_stamp_ns
        if last_ns is None:
            return None
        step_ns, waited_ns = told.stamp_ns - last_ns, told.received_ns - self.last_received_ns
        if -_JUMP_NS <= step_ns <= _JUMP_NS + max(waited_ns, 0) * _FASTEST:
            return None
        return Jump(self.child, last_ns, told.stamp_ns, told.received_ns)

    def _step_to(self, told: Told) -> None:
        """Follow each publisher separately; note a step that is far faster than the steps before and after it."""
        steps = self._steps.get(told.writer)
        if steps is None or steps.told.parent != told.parent:
            if len(self._steps) >= _MOST_FOLLOWED:
                self._steps.clear()
            self._steps[told.writer] = _Steps(told)
            return
        within_ns = told.stamp_ns - steps.told.stamp_ns
        if within_ns <= 0:
            return
        far_m, turned_deg = _apart(told, steps.told)
        speed = far_m / within_ns * 1e9, turned_deg / within_ns * 1e9
        if steps.leap and _is_leap(steps.leap, speed) and _is_leap(steps.leap, steps.before):
            self._leaps.append(steps.leap)
        may_be = steps.speed is not None and (
            (far_m >= _LEAP_M and speed[0] >= _LEAP_M_S) or (turned_deg >= _LEAP_DEG and speed[1] >= _LEAP_DEG_S)
        )
        steps.leap = Leap(far_m, turned_deg, within_ns, told.received_ns) if may_be else None
        steps.told, steps.before, steps.speed = told, steps.speed or (0.0, 0.0), speed

    def forget(self, keep: int, around_ns: int | None, kept_ns: int = KEPT_NS) -> None:
        """Drop the oldest transforms beyond `keep` or `kept_ns`; with `around_ns` the transforms farthest from that
        time.
        """
        if around_ns is None:
            gone = max(len(self.moving) - keep, bisect_left(self.stamps, self.stamps[-1] - kept_ns), 0)
            del self.moving[:gone], self.stamps[:gone]
            return
        while len(self.moving) > keep:
            gone = 0 if around_ns - self.stamps[0] > self.stamps[-1] - around_ns else len(self.moving) - 1
            del self.moving[gone], self.stamps[gone]


def _still_told(values: Iterable[tuple[_Value, int]]) -> list[_Value]:
    """Return the values without the values that have ended: not received for longer than they ever paused."""
    told = list(values)
    times: dict[_Value, list[int]] = {}
    for value, received_ns in told:
        times.setdefault(value, []).append(received_ns)
    newest_ns = max((received_ns for _, received_ns in told), default=0)
    ended: set[_Value] = set()
    for value, heard in times.items():
        pauses = [after - before for before, after in pairwise(heard)]
        patience_ns = max(_PAUSES * max(pauses), _LEAST_PAUSE_NS) if pauses else _ONCE_NS
        if newest_ns - heard[-1] > patience_ns:
            ended.add(value)
    return [value for value, _ in told if value not in ended]


def _is_leap(leap: Leap, beside: tuple[float, float]) -> bool:
    """Return whether a neighbouring step was slow enough for this step to be a leap."""
    speed_m_s, speed_deg_s = leap.far_m / leap.within_ns * 1e9, leap.turned_deg / leap.within_ns * 1e9
    is_far = leap.far_m >= _LEAP_M and speed_m_s >= max(_LEAP_M_S, _LEAP_TIMES * beside[0])
    return is_far or (leap.turned_deg >= _LEAP_DEG and speed_deg_s >= max(_LEAP_DEG_S, _LEAP_TIMES * beside[1]))


def _turns(values: Sequence[object]) -> int:
    """Return how often the value changes from one element to the next."""
    return sum(one != other for one, other in zip(values, islice(values, 1, None), strict=False))


def _at_one_time(one: Sequence[Told], other: Sequence[Told]) -> list[tuple[Told, Told]]:
    """Return pairs of transforms of two publishers for one time.

    For each transform of the one between two of the other's, the latter two are interpolated.
    """
    ordered = sorted(other, key=lambda told: told.stamp_ns)
    stamps = [told.stamp_ns for told in ordered]
    found: list[tuple[Told, Told]] = []
    for told in one:
        place = bisect_right(stamps, told.stamp_ns)
        if 0 < place < len(stamps) and ordered[place - 1].parent == ordered[place].parent:
            first, second = ordered[place - 1], ordered[place]
            share = (told.stamp_ns - first.stamp_ns) / (second.stamp_ns - first.stamp_ns)
            there = Told(first.parent, between(first.pose, second.pose, share), told.stamp_ns, second.received_ns)
            found.append((told, there))
    return found


def _apart(one: Told, other: Told) -> tuple[float, float]:
    turned = math.degrees(angle_between_rad(one.pose.rotation, other.pose.rotation))
    return math.dist(one.pose.translation, other.pose.translation), turned
