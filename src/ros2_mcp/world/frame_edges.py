"""One frame and its parent over time: what was told of it, and what is wrong with that, as tf2 would take it."""

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
"""How far a live tree reaches back. tf2 keeps 10 s; an agent asks some seconds after it saw something."""
_JUMP_NS = 2_000_000_000
"""A stamp that goes back so far is no late message: localisations stamp up to 1 s ahead, and networks delay less."""
_FASTEST = 10.0
"""Simulated time runs at most so many times as fast; a stamp that goes forward faster than that has jumped."""
_MOST_JUMPS = 50
_LOOKED_BACK = 60
"""Transforms of an edge that are looked at for two parents or two publishers: some seconds."""
_PAUSES, _LEAST_PAUSE_NS, _ONCE_NS = 3, 1_000_000_000, 5_000_000_000
"""A publisher of several has ended after three times its longest pause, and a second at least; one that was heard once
only, whose rate nobody knows, after 5 s."""
_RATED = 100
"""Messages of which the rate is told."""
_PAUSE_NS, _PAUSE_STEPS = 500_000_000, 4
"""A pause between two bursts is so long at least, and so many times as long as the step of the stamps over it: what is
sent seldom has steps as long as its pauses."""
_AT_ONCE, _LEAST_BURST, _LEAST_SPAN_NS = 20, 5, 1_000_000_000
"""One burst: so many times as fast as its stamps go, twice what simulated time runs at; messages; and their span."""
_MOST_PAUSES = 50
_LEAP_M, _LEAP_M_S, _LEAP_DEG, _LEAP_DEG_S = 0.25, 10.0, 30.0, 720.0
"""A step so far and so fast is no motion of a robot, if those before and after it are slow."""
_LEAP_TIMES = 5
"""As fast as the steps beside it, at least: a car, or a wheel that turns fast, makes all of its steps so."""
_MOST_LEAPS = 100
_MOST_FOLLOWED = 64
"""Publishers of one edge."""
_Value = TypeVar("_Value", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Told:
    """One transform of a frame, as a message told it: its parent, and where it is in it. Times in ns of Unix time.

    `writer` tells publishers of one topic apart (`writers.py`); 0 where that is not known.
    """

    parent: str
    pose: Pose
    stamp_ns: int
    received_ns: int
    writer: int = 0


@dataclass(frozen=True, slots=True)
class Jump:
    """The stamps of a frame's transforms went from one time to another that does not follow it. Times in ns."""

    child: str
    from_ns: int
    to_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class Leap:
    """What one publisher told went so far from one message to the next, as nothing moves."""

    far_m: float
    turned_deg: float
    within_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class Bursts:
    """Messages that come many at once: `pause_ns` between two bursts, and about how many are in each."""

    pause_ns: int
    count: int


@dataclass(slots=True)
class _Steps:
    """A publisher's last message, how fast (m/s, degrees/s) the step to it was, and a leap that it may have been."""

    told: Told
    speed: tuple[float, float] | None = None
    before: tuple[float, float] = (0.0, 0.0)
    leap: Leap | None = None


class Edge:
    """All that was told of one frame and its parent: `moving` by stamps, and `static` by parents.

    `received` counts the moving ones, `repeated` those of them with a stamp that was there already, which tf2
    ignores, too, and `unstamped` those whose stamp is 0: nobody has set it, and the last of them holds for all
    times, as of a static one. `last_received_ns` is the time of receipt of the newest message. `refused` says in
    words why the last transform of it was not taken, `refused_parent` and `refused_writer` of which parent, and by
    whom, `refused_ns` when the last such came. `jumps` are those of its stamps. `is_left`: it is static, and
    whoever tells it is gone, so that nodes that start from now on do not get it. `on_static` is whether the last
    came on /tf_static. `slashed` is how it was told, where that was with a leading slash; `frozen` how many of the
    last messages in a row had a stamp that did not change.
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
        """Whether it holds for all times."""
        return not self.moving and not self.unstamped and bool(self.static)

    @property
    def newest(self) -> Told | None:
        """What it was last."""
        if self.moving:
            return self.moving[-1]
        return next(reversed(self.static.values())) if self.static else None

    @property
    def parents(self) -> list[str]:
        """Every parent that was told of it and is still kept, the newest last."""
        moving = dict.fromkeys(_still_told((told.parent, told.received_ns) for told in self.moving[-_LOOKED_BACK:]))
        return list({**dict.fromkeys(self.static), **moving})

    @property
    def two_parents(self) -> bool:
        """Whether two are told at the same time; a frame that was once given another parent has one."""
        if len(self.static) > 1 or (self.static and {told.parent for told in self.moving} - set(self.static)):
            return True
        return _turns(_still_told([(told.parent, told.received_ns) for told in self.moving[-_LOOKED_BACK:]])) > 1

    @property
    def writers(self) -> list[int]:
        """The publishers that tell it at the same time, where they can be told apart."""
        recent = _still_told(self._told_by)
        if _turns(recent) > 1:
            return sorted(set(recent))
        return recent[-1:] or sorted({told.writer for told in self.static.values()}) or [self.refused_writer]

    @property
    def on_both(self) -> bool:
        """Whether it is told as static and as moving alike, with one parent."""
        return bool(self.moving) and self.moving[-1].parent in self.static and not self.two_parents

    def static_writers_of(self, parent: str) -> list[int]:
        """The publishers of /tf_static that tell it with that parent."""
        return sorted(writer for writer, told in self._static_by.items() if told.parent == parent)

    def static_parent_by(self, writer: int) -> str:
        """The parent with which a publisher of /tf_static told it last."""
        told = self._static_by.get(writer)
        return told.parent if told else self.refused_parent

    def writers_of(self, parent: str) -> list[int]:
        """The publishers that tell it with that parent, of the last messages."""
        told = [one for one in self.moving[-_LOOKED_BACK:] if one.parent == parent]
        found = {one.writer for one in told or self.static.values() if one.parent == parent}
        return sorted(found) or [self.refused_writer]

    def parent_by(self, writer: int) -> str:
        """The parent with which a publisher told it last; where nothing is kept of that publisher, the newest."""
        if steps := self._steps.get(writer):
            return steps.told.parent
        if fixed := self._static_by.get(writer):
            return fixed.parent
        return self.newest.parent if self.newest else self.refused_parent

    @property
    def apart(self) -> tuple[float, float] | None:
        """How far what several publishers tell of it, with one parent and for one time, is apart: m and degrees."""
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
        """How often it is, by its stamps where they go on, else by the times of receipt; None for what is static, or
        was told once. Messages may come many at once, or late: the stamps say how often it was measured.
        """
        stamps = self.stamps[-_RATED:]
        # Right after a jump there are too few to tell a rate by.
        if len(stamps) > (2 if self.jumps else 1) and stamps[-1] > stamps[0]:
            return (len(stamps) - 1) / (stamps[-1] - stamps[0]) * 1e9
        return self.received_hz

    @property
    def received_hz(self) -> float | None:
        """How often it comes, by the times of receipt; None for what is static, or was told once."""
        if not self.moving and self.on_static:
            return None
        if len(self._times) < 2:
            return None
        span_ns = max(self._times[-1], self._times[-2]) - self._times[0]
        return (len(self._times) - 1) / span_ns * 1e9 if span_ns > 0 else None

    @property
    def leaps(self) -> list[Leap]:
        """Where it went suddenly from one place to another one, within what is kept; the newest last."""
        return [leap for leap in self._leaps if leap.received_ns >= self.last_received_ns - KEPT_NS]

    @property
    def bursts(self) -> Bursts | None:
        """That messages come many at once, with pauses between, though their stamps have none; None if they do not.

        Two pauses tell it, if they are most of the time; or so many messages at once that none was sent when it was
        measured, which is known from the first burst on.
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
        if len(self.writers) > 1:  # one stamps later than the other: that tells nothing of when they came
            return None
        count = len(self.moving) // (len(pauses) + 1)
        if pauses:
            return Bursts(pauses[len(pauses) // 2], count) if count >= _LEAST_BURST else None
        return Bursts(span_ns + span_ns // (len(self.stamps) - 1), count)

    def age_ns(self, at_ns: int) -> int:
        """How long before that time, by the stamps, the last was that there was then; below 0 where all are later."""
        place = bisect_right(self.stamps, at_ns)
        return at_ns - self.stamps[max(place - 1, 0)]

    def around(self, at_ns: int) -> tuple[int, int] | None:
        """The stamps between which that time lies; None where it is that of one, or outside."""
        after = bisect_left(self.stamps, at_ns)
        if after in (0, len(self.stamps)) or self.stamps[after] == at_ns:
            return None
        return self.stamps[after - 1], self.stamps[after]

    def longest_gap(self) -> tuple[int, int] | None:
        """The stamps with the longest pause between them; None of fewer than two."""
        return max(pairwise(self.stamps), key=lambda pair: pair[1] - pair[0], default=None)

    @property
    def lag_ns(self) -> int:
        """How far its newest stamp was behind its receipt, when that stamp first came."""
        return self.moving[-1].received_ns - self.stamps[-1]

    def at(self, at_ns: int) -> Told | None:
        """What it is at that time; None where that is before the first or after the last that was told."""
        if not self.moving:
            return self.newest
        after = bisect_left(self.stamps, at_ns)
        if after < len(self.stamps) and self.stamps[after] == at_ns:
            return self.moving[after]
        if after in (0, len(self.stamps)):
            return None
        first, second = self.moving[after - 1], self.moving[after]
        if first.parent != second.parent:  # as tf2 does: until it has the other parent
            return Told(first.parent, first.pose, at_ns, first.received_ns, first.writer)
        share = (at_ns - first.stamp_ns) / (second.stamp_ns - first.stamp_ns)
        pose = between(first.pose, second.pose, share)
        return Told(first.parent, pose, at_ns, second.received_ns, second.writer)

    def add_static(self, told: Told) -> None:
        """Takes in what holds for all times; another one with the same publisher replaces its last."""
        for parent, former in list(self.static.items()):
            if parent != told.parent and told.writer and former.writer == told.writer:
                del self.static[parent]
        self.static.pop(told.parent, None)
        self.static[told.parent] = told
        if told.writer:
            self._static_by[told.writer] = told
        self.last_received_ns = max(self.last_received_ns, told.received_ns)

    def add_moving(self, told: Told) -> Jump | None:
        """Takes in one with a stamp; after a jump of the stamps what was told before does not count any more."""
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
            first, later = self.jumps[:1], self.jumps[1:]  # the first is told, too
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
        """Follows each publisher by itself, and notes a step that is far faster than those before and after it."""
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
        """Gives up the oldest, or where there is a time that counts, those that are farthest from it."""
        if around_ns is None:
            gone = max(len(self.moving) - keep, bisect_left(self.stamps, self.stamps[-1] - kept_ns), 0)
            del self.moving[:gone], self.stamps[:gone]
            return
        while len(self.moving) > keep:
            gone = 0 if around_ns - self.stamps[0] > self.stamps[-1] - around_ns else len(self.moving) - 1
            del self.moving[gone], self.stamps[gone]


def _still_told(values: Iterable[tuple[_Value, int]]) -> list[_Value]:
    """Those without what has ended: it was not told for longer than it ever paused, while others were."""
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
    """Whether a step beside it was slow enough for it to be one."""
    speed_m_s, speed_deg_s = leap.far_m / leap.within_ns * 1e9, leap.turned_deg / leap.within_ns * 1e9
    is_far = leap.far_m >= _LEAP_M and speed_m_s >= max(_LEAP_M_S, _LEAP_TIMES * beside[0])
    return is_far or (leap.turned_deg >= _LEAP_DEG and speed_deg_s >= max(_LEAP_DEG_S, _LEAP_TIMES * beside[1]))


def _turns(values: Sequence[object]) -> int:
    """How often one is followed by another."""
    return sum(one != other for one, other in zip(values, islice(values, 1, None), strict=False))


def _at_one_time(one: Sequence[Told], other: Sequence[Told]) -> list[tuple[Told, Told]]:
    """What two publishers told for one time: of each message of the one between two of the other's, that in between."""
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
