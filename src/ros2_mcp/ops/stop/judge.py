"""Judge which messages were published after a stop, and whether they show that the robot
moves. Pure: no clock and no ROS.

An acknowledged zero does not prove that the robot is stationary, nor does a message from before the zero. A late
subscriber to a transient_local publisher gets such a message, and a driver that has lost its hardware may publish its
last message again and again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

from ros2_mcp.model.poses import angle_between_rad
from ros2_mcp.model.text import named

State = Literal["moving", "still", "not observed"]

_AHEAD_NS = 100_000_000
"""If a source timestamp is ahead of its receipt by more than this, the publisher's clock is ahead: clocks kept by
chrony or PTP agree better."""
_SAME_CLOCK_NS = 60_000_000_000
"""If a header stamp differs from the time of sending by more than this, it is from another clock:
pipelines lag by seconds at most."""
_OWN_CLOCK_NS = 946_684_800_000_000_000
"""The year 2000. An earlier stamp is from a clock that starts at zero, such as that of a simulation, or of a controller
without a real-time clock."""
JOINT_WINDOW_S, JOINT_STANDS = 0.4, 0.002
"""A joint is stationary if it moves by at most `JOINT_STANDS` (rad or m) within `JOINT_WINDOW_S`: a 12-bit
encoder flickers by 0.0015 rad."""
_POSE_NOISE_M, _POSE_NOISE_RAD = 0.002, 0.005
"""By how much noise may change the pose of a stationary robot, on top of the speed that
counts as stationary. Not measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One message about motion: when it was received, sent and measured, and what it reports.

    `heard_s` is when the judge got the message, by a monotonic clock. The other times are Unix times in ns, 0 if
    unknown: `received_ns` by the receiver's clock, `source_ns` by the publisher's (the source timestamp of DDS),
    `header_ns` by the clock of the node that measured. `velocity` is linear x, y, z in m/s and angular x, y, z in
    rad/s; `position` is in m, `orientation` a quaternion (x, y, z, w); `joints` are positions in rad or m, not finite
    if the message gives none.
    """

    heard_s: float
    received_ns: int
    source_ns: int = 0
    header_ns: int = 0
    velocity: Sequence[float] | None = None
    position: Sequence[float] | None = None
    orientation: Sequence[float] | None = None
    joints: Mapping[str, float] = field(default_factory=dict[str, float])

    def since_s(self, before: Reading) -> float:
        """Return the time since another reading in s: the smaller of the intervals by two clocks. The publisher's clock
        may be set in between, and by the monotonic clock messages that were delayed arrive together.
        """
        sent_ns = (self.source_ns or self.received_ns) - (before.source_ns or before.received_ns)
        return min(sent_ns / 1e9, self.heard_s - before.heard_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Still:
    """The thresholds for a stationary robot: every speed is at most `linear` (m/s) and `angular` (rad/s), and the means
    over `window_s` are at most `mean_linear` and `mean_angular`.
    """

    linear: float = 0.03
    angular: float = 0.05
    mean_linear: float = 0.03
    mean_angular: float = 0.05
    window_s: float = 0.3


HOVERING = Still(linear=0.3, angular=0.2, mean_linear=0.1, mean_angular=0.1, window_s=1.0)
"""Thresholds for a vehicle that hovers. In gusts it sways at several times the drift of the simulated vehicle, but
stays in place over a second. A vehicle that climbs at 0.25 m/s does not."""


class Freshness:
    """Checks whether readings of one topic were published after `began_ns` (Unix time), and measured after it as well.

    `is_latched`: the subscription also receives messages that were published before it.
    """

    def __init__(self, began_ns: int, *, is_latched: bool) -> None:
        self._began_ns = began_ns
        self._is_latched = is_latched
        self._headers: dict[str, int] = {}

    def problem(self, reading: Reading, key: str = "") -> str:
        """Return why a reading shows nothing about the present; empty if it does. Header stamps must advance between
        readings with the same `key`, such as a joint's name, because several publishers may share a topic.
        """
        return self._problem_of_source(reading) or self._problem_of_header(reading, key)

    def _problem_of_source(self, reading: Reading) -> str:
        if not reading.source_ns:
            is_known = bool(reading.header_ns) or not self._is_latched
            return "" if is_known else "its messages do not say when they were published"
        if reading.source_ns < self._began_ns:
            return "every message received was published before the stop, by the publisher's clock"
        if self._is_latched and reading.source_ns > reading.received_ns + _AHEAD_NS:
            return "the clock of its publisher is ahead, so old messages look new"
        return ""

    def _problem_of_header(self, reading: Reading, key: str) -> str:
        stamp = reading.header_ns
        if not stamp:
            return ""
        before = self._headers.get(key)
        if before is not None and stamp <= before:
            return "it repeats the same measurement"
        self._headers[key] = stamp
        if 0 < stamp < _OWN_CLOCK_NS:  # only the second one shows that its clock runs
            return "" if before is not None else "one message alone does not show that its clock runs"
        if abs(stamp - (reading.source_ns or reading.received_ns)) > _SAME_CLOCK_NS:
            return "its headers carry the time of another clock"
        return "" if stamp >= self._began_ns else "every message received was measured before the stop"


class Judge(Protocol):
    """Judges from the readings of one topic whether the robot moves."""

    def hear(self, reading: Reading) -> None:
        """Add the next reading."""
        ...

    @property
    def state(self) -> State:
        """The verdict from the readings so far."""
        ...

    @property
    def why(self) -> str:
        """A phrase: what the readings report, or why they show nothing."""
        ...


NOTHING_CAME = "nothing was published on it since the stop"


class BaseJudge:
    """Judges a topic by its velocities and by its poses, because some odometry never sets a velocity."""

    def __init__(self, freshness: Freshness, still: Still) -> None:
        self._freshness = freshness
        self._still = still
        self._fresh: deque[Reading] = deque()
        self._problem = NOTHING_CAME

    def hear(self, reading: Reading) -> None:
        """Add a reading; a reading without a finite velocity shows nothing."""
        if reading.velocity is None or not all(map(math.isfinite, reading.velocity)):
            self._problem = "it did not report the robot's speed"
            return
        if problem := self._freshness.problem(reading):
            self._problem = problem
            return
        self._fresh.append(reading)
        while len(self._fresh) > 2 and reading.since_s(self._fresh[1]) >= self._still.window_s:
            self._fresh.popleft()

    @property
    def state(self) -> State:
        """`still` only after a whole window without motion; one fast reading is enough for `moving`."""
        if not self._fresh:
            return "not observed"
        linear, angular = self.speeds
        if linear > self._still.linear or angular > self._still.angular:
            return "moving"
        if not self._is_whole:
            return "not observed"
        all_slow = all(self._is_slow(reading) for reading in self._fresh)
        return "still" if all_slow and self._keeps_its_place() else "moving"

    @property
    def why(self) -> str:
        """A phrase: what the topic reports, or why that shows nothing."""
        if not self._fresh:
            return self._problem
        linear, angular = self.speeds
        said = f"reports {linear:.2f} m/s and {angular:.2f} rad/s"
        if self.state == "not observed":
            return f"{said}, but for less than {self._still.window_s:g} s"
        if self.state == "moving" and linear <= self._still.linear and angular <= self._still.angular:
            return f"{said}, but its position changes"
        return said

    @property
    def speeds(self) -> tuple[float, float]:
        """The latest linear and angular speed, in m/s and rad/s."""
        velocity = self._fresh[-1].velocity or (0.0,) * 6
        return math.hypot(*velocity[:3]), math.hypot(*velocity[3:])

    @property
    def _is_whole(self) -> bool:
        return self._fresh[-1].since_s(self._fresh[0]) >= self._still.window_s

    def _is_slow(self, reading: Reading) -> bool:
        velocity = reading.velocity or ()
        return math.hypot(*velocity[:3]) <= self._still.linear and math.hypot(*velocity[3:]) <= self._still.angular

    def _keeps_its_place(self) -> bool:
        """Return whether the mean motion over the window is small, by the velocities and by the distance between the
        first and the last pose.
        """
        first, last = self._fresh[0], self._fresh[-1]
        elapsed_s = last.since_s(first)
        means = [
            math.fsum(reading.velocity[axis] for reading in self._fresh if reading.velocity) / len(self._fresh)
            for axis in range(6)
        ]
        if math.hypot(*means[:3]) > self._still.mean_linear or math.hypot(*means[3:]) > self._still.mean_angular:
            return False
        way_m, turn_rad = distance_m(first.position, last.position), angle_rad(first.orientation, last.orientation)
        return (
            way_m <= self._still.mean_linear * elapsed_s + _POSE_NOISE_M
            and turn_rad <= self._still.mean_angular * elapsed_s + _POSE_NOISE_RAD
        )


class JointJudge:
    """Judges all joints of a topic by their positions over time. The velocities in the messages are ignored: a
    broadcaster may leave them out or fill them with noise.

    `expected` are the joints that the topic reported before: one without new positions does not count as stationary.
    """

    def __init__(self, freshness: Freshness, expected: Sequence[str] = ()) -> None:
        self._freshness = freshness
        self._joints: dict[str, deque[tuple[Reading, float]]] = {name: deque() for name in expected}
        self._problem = NOTHING_CAME

    def hear(self, reading: Reading) -> None:
        """Add a reading, which need not have all joints."""
        for name, position in reading.joints.items():
            told = self._joints.setdefault(name, deque())
            if not math.isfinite(position):
                self._problem = f"it reports no position of {named(name)}"
            elif problem := self._freshness.problem(reading, name):
                self._problem = problem
            else:
                told.append((reading, position))
                while len(told) > 2 and reading.since_s(told[1][0]) >= JOINT_WINDOW_S:
                    told.popleft()

    @property
    def state(self) -> State:
        """`still` if every joint was reported for a whole window and did not move; `moving` once one joint moves."""
        if any(self._way(told) > JOINT_STANDS for told in self._joints.values()):
            return "moving"
        return "still" if self._joints and all(map(self._is_whole, self._joints.values())) else "not observed"

    @property
    def why(self) -> str:
        """A phrase: what the topic reports, or why that shows nothing."""
        if self.state == "moving":
            return f"reports that {named(max(self._joints, key=lambda name: self._way(self._joints[name])))} moves"
        if self.state == "still":
            return "reports that no joint moves"
        silent = [name for name, told in self._joints.items() if not told]
        if silent and len(silent) < len(self._joints):
            return f"it reported nothing new of {named(silent[0])}"
        return self._problem if silent or not self._joints else f"it reported joints for less than {JOINT_WINDOW_S:g} s"

    @property
    def names(self) -> Sequence[str]:
        """All joints that the topic has reported, and the expected joints."""
        return list(self._joints)

    @staticmethod
    def _way(told: deque[tuple[Reading, float]]) -> float:
        positions = [position for _, position in told]
        return max(positions) - min(positions) if positions else 0.0

    @staticmethod
    def _is_whole(told: deque[tuple[Reading, float]]) -> bool:
        return len(told) > 1 and told[-1][0].since_s(told[0][0]) >= JOINT_WINDOW_S


def distance_m(one: Sequence[float] | None, other: Sequence[float] | None) -> float:
    """Return the distance between two positions; 0 if either position is missing or not finite."""
    if one is None or other is None or not all(map(math.isfinite, (*one, *other))):
        return 0.0
    return math.dist(one, other)


def angle_rad(one: Sequence[float] | None, other: Sequence[float] | None) -> float:
    """Return the angle between two quaternions of any length; 0 if either is missing, not finite, or zero."""
    if one is None or other is None or not all(map(math.isfinite, (*one, *other))):
        return 0.0
    (ax, ay, az, aw), (bx, by, bz, bw) = one, other
    return angle_between_rad((ax, ay, az, aw), (bx, by, bz, bw))


# ── all topics together ────────────────────────────────────────────────────────────────────────────────────────────

Observed = Literal["observed still", "observed hovering", "not observed"]
NO_ODOMETRY = "Not observed: no odometry reports whether the robot has stopped."


@dataclass(frozen=True, slots=True)
class Account:
    """The verdict on one topic, with a phrase: what it reports, or why that shows nothing. `is_base`: it reports the
    velocity of the base, not joints.
    """

    topic: str
    state: State
    why: str
    is_base: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """The verdict on the robot, and a sentence with the evidence. `is_moving`: the robot was moving at the end.
    `is_open`: a topic that reports motion, or should, does not show whether the robot is stationary. If neither is set
    and the verdict is *not observed*, no topic reports the motion of the robot, or of a part of it. `has_base`:
    odometry was among the reports.
    """

    verdict: Observed
    sentence: str
    is_moving: bool = False
    is_open: bool = False
    has_base: bool = False

    @property
    def stands(self) -> bool:
        """Return whether the robot was observed to be stationary, or to hover."""
        return self.verdict != "not observed"


def observation(
    accounts: Sequence[Account], *, missing: Sequence[str] = (), unreported: Sequence[str] = (), hovers: bool = False
) -> Observation:
    """Judge whether the robot is stationary: every topic that reports motion must show it.

    `missing` are phrases about topics that should report motion and do not; `unreported`, about parts of the robot
    whose motion no topic reports. Without any account, no topic reports motion.
    """
    said = "; ".join(f"{account.topic} {account.why}" for account in accounts if account.state != "not observed")
    silent = [f"{account.topic}: {account.why}" for account in accounts if account.state == "not observed"]
    if any(account.state == "moving" for account in accounts):
        return Observation(verdict="not observed", sentence=f"NOT observed still: {said}.", is_moving=True)
    if silent or missing:
        reasons = "; ".join([*silent, *missing])
        return Observation(verdict="not observed", sentence=f"Not observed: {reasons}.", is_open=True)
    if not accounts:
        return Observation(verdict="not observed", sentence=NO_ODOMETRY)
    if unreported:
        return Observation(verdict="not observed", sentence=f"Not observed: {'; '.join(unreported)} ({said}).")
    has_base = any(account.is_base for account in accounts)
    if hovers:
        over = f"over {HOVERING.window_s:g} s"
        return Observation(
            verdict="observed hovering", sentence=f"Observed hovering, {over}: {said}.", has_base=has_base
        )
    return Observation(verdict="observed still", sentence=f"Observed still: {said}.", has_base=has_base)


def is_confirmed(doubts: Sequence[str], seen: Observation, unsettled: Sequence[object]) -> bool:
    """Return whether a stop is confirmed: the robot was observed to be stationary after it, and both lists are empty.
    `doubts`, such as: another node commands the robot, a zero did not arrive, a goal continues. `unsettled`: calls and
    messages sent since the robot was last stationary, which started something that this server does not know how to
    stop.
    """
    return seen.stands and not doubts and not unsettled
