"""The judge of whole curves against another one, which samples them densely (as Bézier curves).

Points, speeds, accelerations, stamps, names and their order are random. What the judge lets through is followed as a
real controller follows it, with every start that is possible: never may it be over a limit by more than 0.1 %. What the
judge refuses has to be over one, too, or be of a shape that is always refused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, pi
from typing import Any

import numpy as np
import pytest

from ros2_mcp_common.policy import stamps
from ros2_mcp_common.policy.curves import State
from ros2_mcp_common.policy.trajectory_limits import AT_ONCE, CurveLimits, JointBounds, Joints, problem

BATCH = 1000
SAMPLES = 160
OVER, UNDER = 1.001, 0.98
SCALE = 3.0
"""Of positions: 0.1 % of so many rad."""
NOW_NS = 1_800_000_000_000_000_000
NAMES = ("shoulder", "elbow", "wrist", "slide")
STANDS, LATE_S, HALF_WAY, NOISE = 0.02, 0.1, 0.02, 0.001
"""A speed that is noise, how long a trajectory takes, half a turn, and noise as a share of the range: decision 61."""


Carried = tuple[float, float | None, float | None]
Judge = Callable[[dict[str, Any], CurveLimits, Joints], str]


@dataclass
class Trial:
    value: dict[str, Any]
    limits: CurveLimits
    joints: Joints
    is_odd: str  # why it is refused whatever its curve; empty if it is judged by that


# ── making ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def made(random: np.random.Generator) -> Trial:
    turns = random.random() < 0.2  # the joint stands about a turn away, and has the time to come
    names = list(random.permutation(NAMES)[: 1 if turns else random.integers(1, 4)])
    count, speed = int(random.integers(1, 2 if turns else 5)), float(random.uniform(0.1, 2.0))
    gaps = random.uniform(0.2, 6.0, count)
    if turns:
        gaps[0] = random.uniform(8.0, 40.0)
    elif random.random() < 0.2:
        gaps[0] = 0.0
    times = np.cumsum(np.round(gaps, 6))
    hurry = random.choice([0.4, 0.6, 0.9, 1.2])
    steps = random.uniform(-1, 1, (count, len(names))) * hurry * speed * gaps[:, None]
    start = random.uniform(-1.2, 1.2, len(names))
    places = start + np.cumsum(steps, axis=0)
    if turns:
        start += random.choice([-1, 1], len(names)) * random.uniform(0.3, 1.1, len(names)) * 2 * pi
        places[0] += random.choice([0.0, pi]) * random.choice([-1, 1], len(names))
    if gaps[0] == 0:
        places += random.uniform(-0.5, 1.05) * AT_ONCE * random.choice([0, 1, 1])
    carried = random.choice(["", "v", "va", "mixed", "a"], p=[0.2, 0.35, 0.3, 0.14, 0.01])
    bends = random.choice([None, 1.0, 4.0])
    points = [point(random, carried, *each, speed * hurry, count) for each in zip(times, places, strict=True)]
    if turns or random.random() < 0.7:  # as a real controller wants it
        points[-1].update(
            {name: [0.0] * len(names) for name in ("velocities", "accelerations") if points[-1].get(name)}
        )
    joints = {
        name: JointBounds(*sorted(random.uniform(-4, 4, 2)), speed=float(random.uniform(0.5, 1.2) * speed))
        for name in NAMES
        if random.random() < 0.5
    }
    wide = random.uniform(1.5, 2.5) if turns else 4.0
    limits = CurveLimits(
        speed=speed,
        acceleration=bends and float(bends * speed),
        step=random.choice([None, float(1.3 * speed)]),
        position=(-wide, wide) if random.random() < 0.5 else None,
        joints=joints if random.random() < 0.2 else {},
        described=bool(random.random() < 0.7),
    )
    described = {name: bounds_of(random, 0.95 * speed) for name in NAMES if random.random() < 0.95}
    knows_speed, hurried = random.random() < 0.6, 0.3
    if turns and random.random() < 0.7:  # it comes already
        hurried = -0.6 * np.sign(start[0])
    measured = {
        name: State(float(at), float(random.uniform(0 if turns else -1, 1) * hurried * speed) if knows_speed else None)
        for name, at in zip(names, start, strict=True)
    }
    value = {"header": {"stamp": stamp(random), "frame_id": ""}, "joint_names": names, "points": points}
    return Trial(value, limits, Joints(measured, described), spoilt(random, value))


def bounds_of(random: np.random.Generator, speed: float) -> JointBounds:
    """Of a joint that turns without end, or of one that does not."""
    low, high, wraps = (None, None, True) if random.random() < 0.3 else (-3.0, 3.0, False)
    return JointBounds(low, high, float(speed), wraps=wraps)


def point(random: np.random.Generator, carried: str, time: float, places: Any, speed: float, count: int) -> dict:
    nanoseconds = round(float(time) * 1e9)
    found: dict[str, Any] = {
        "positions": [float(each) for each in places],
        "velocities": [],
        "accelerations": [],
        "time_from_start": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
    }
    if carried == "mixed":
        carried = random.choice(["", "v", "va"])
    if "v" in carried:
        found["velocities"] = [float(each) for each in random.uniform(-0.7, 0.7, len(places)) * speed]
    if "a" in carried:
        found["accelerations"] = [float(each) for each in random.uniform(-0.5, 0.5, len(places)) * speed]
    return found


def stamp(random: np.random.Generator) -> dict[str, int]:
    """Mostly zero; else of now, of before, or of later."""
    if random.random() < 0.7:
        return {"sec": 0, "nanosec": 0}
    at = NOW_NS + int(random.choice([0, 0.9e9, -0.9e9, 3e9, -20e9, -1.1e9]))
    return {"sec": at // 10**9, "nanosec": at % 10**9}


def spoilt(random: np.random.Generator, value: dict[str, Any]) -> str:
    """Now and then it has a shape that is always refused."""
    points, names = value["points"], value["joint_names"]
    if any(each["accelerations"] and not each["velocities"] for each in points):
        return "accelerations alone"
    if random.random() > 0.03:
        return ""
    match random.integers(0, 4):
        case 0:
            names.append(names[0])
            for each in points:
                each["positions"].append(each["positions"][0])
                for name in ("velocities", "accelerations"):
                    each[name] += each[name][:1]
            return "twice"
        case 1:
            points[-1]["positions"] = points[-1]["positions"][:-1]
            return "a position is missing"
        case 2:
            points.append(points[-1])
            return "no later"
        case _:
            points[0]["positions"][0] = float(random.choice([np.nan, inf]))
            return "not finite"


# ── the other judge ────────────────────────────────────────────────────────────────────────────────────────────────


def bernstein(degree: int) -> np.ndarray:
    at = np.linspace(0, 1, SAMPLES)[None, :]
    choose = [1.0]
    for place in range(degree):
        choose.append(choose[-1] * (degree - place) / (place + 1))
    rows = np.arange(degree + 1)[:, None]
    return np.array(choose)[:, None] * at**rows * (1 - at) ** (degree - rows)


BASES = {degree: bernstein(degree) for degree in (3, 4, 5)}


def controls(one: Carried, other: Carried, time: float) -> list[float]:
    """Bézier's control points of what both ends carry: position, speed, acceleration; None where they do not."""
    (p, v, a), (q, w, b) = one, other
    if v is None or w is None:
        return [p, q]
    if a is None or b is None:
        return [p, p + v * time / 3, q - w * time / 3, q]
    bent, back = a * time**2 / 20, b * time**2 / 20
    return [p, p + v * time / 5, p + 2 * v * time / 5 + bent, q - 2 * w * time / 5 + back, q - w * time / 5, q]


def raised(found: list[float]) -> list[float]:
    """The same curve with six control points."""
    while len(found) < 6:
        degree = len(found)
        inner = [place / degree * found[place - 1] + (1 - place / degree) * found[place] for place in range(1, degree)]
        found = [found[0], *inner, found[-1]]
    return found


def zeros(one: Carried, other: Carried) -> Carried:
    """With zeros where only the other one carries something."""
    found = [0.0 if x is None and y is not None else x for x, y in zip(one[1:], other[1:], strict=True)]
    return one[0], found[0], found[1]


def room(low: float, high: float, start: float, noise: float) -> tuple[float, float]:
    """The range of a joint that starts there: up to where it is, if that is beyond; its noise at a limit is none."""
    noise = min(0.002, max(0.0, noise))
    least = min(low - noise, start) if start < low + noise else low
    return least, max(high + noise, start) if start > high - noise else high


class Dense:
    """By which factor trials lead over some limit: 1 is exactly at it, infinite what may not be done at all."""

    def __init__(self) -> None:
        self.worst: list[float] = []
        self._curves: list[list[float]] = []
        self._bounds: list[tuple[float, ...]] = []

    def add(self, trial: Trial) -> None:
        self.worst.append(0.0)
        limits = trial.limits
        for place, name in enumerate(trial.value["joint_names"]):
            if limits.joints and name not in limits.joints:
                self._over(inf)
                return
            told = trial.joints.described.get(name)
            own = [limits.joints[name]] if limits.joints else []
            own += [told] if limits.described and told else []
            fast = min([limits.speed or inf, *(each.speed or inf for each in own)])
            low = max([(limits.position or (-inf, inf))[0], *(-inf if each.low is None else each.low for each in own)])
            high = min(
                [(limits.position or (-inf, inf))[1], *(inf if each.high is None else each.high for each in own)]
            )
            wraps = told is None or told.wraps
            self._joint(trial, place, (low, high, fast, limits.acceleration or inf), wraps=wraps)

    def _over(self, factor: float) -> None:
        self.worst[-1] = max(self.worst[-1], factor)

    def _joint(self, trial: Trial, place: int, bounds: tuple[float, float, float, float], *, wraps: bool) -> None:
        points, measured = trial.value["points"], trial.joints.measured[trial.value["joint_names"][place]]
        rows: list[Any] = [
            tuple(each[key][place] if each[key] else None for key in ("positions", "velocities", "accelerations"))
            for each in points
        ]
        times = [each["time_from_start"]["sec"] + each["time_from_start"]["nanosec"] / 1e9 for each in points]
        low, high, fast, bent = bounds
        first, moves = rows[0], measured.speed or 0.0
        starts = [measured.position]
        if abs(moves) > STANDS:  # by the time that the controller looks, it has moved on
            starts.append(measured.position + moves * LATE_S)
        speeds: set[float] = {moves if abs(moves) > STANDS else 0.0}
        if times[0] > 0:
            if wraps:
                turns = [start + 2 * pi * turn for start in starts for turn in range(-4, 5)]
                starts += [start for start in turns if abs(start - first[0]) < pi + HALF_WAY]
            ends: set[float] = set()
            for start in starts:
                box = room(low, high, start, NOISE * (high - low) if high - low < inf else 0.0)
                for carried in self._carried(measured.speed, first):
                    way = self._way((start, *carried), first, times[0], (*box, max(fast, abs(moves)), bent))
                    if carried[0] is None:
                        self._steps(trial, speeds, {way[0]})
                    ends.add(way[1])
            speeds = ends
        else:
            self._over(inf if max(abs(first[0] - each) for each in starts) > AT_ONCE else 0.0)
            least, most = room(low, high, measured.position, NOISE * (high - low) if high - low < inf else 0.0)
            self._over(1 + max(first[0] - most, least - first[0]) / SCALE)
        for (before, began), (row, end) in pairwise(zip(rows, times, strict=True)):
            pairs = {(before, row), (zeros(before, row), zeros(row, before))}
            box = room(low, high, before[0], 0.0)
            found = [self._way(*pair, end - began, (*box, fast, bent)) for pair in pairs]
            self._steps(trial, speeds, {each[0] for each in found})
            speeds = {each[1] for each in found}
        if len(times) > 1 or times[0] > 0:
            self._steps(trial, speeds, {0.0})

    @staticmethod
    def _carried(speed: float | None, first: Any) -> set[tuple[float | None, float | None]]:
        """The speeds and accelerations with which controllers begin, by their state interfaces: none, positions and
        velocities, or all three; one that has no velocities in its joint states may lack them itself.
        """
        if first[1] is None:
            return {(None, None)}
        found: set[tuple[float | None, float | None]] = {(0.0, None), (0.0, 0.0)}
        found |= {(None, None)} if speed is None else {(speed, None), (speed, 0.0)}
        return found if first[2] is not None else {each for each in found if each[1] is None}

    def _way(self, one: Any, other: Any, time: float, bounds: tuple[float, ...]) -> tuple[float, float]:
        """Notes a curve to be sampled; its speeds at both ends."""
        found = controls(one, other, time)
        is_line = len(found) == 2
        self._curves.append(raised(found))
        self._bounds.append((*bounds[:3], inf if is_line else bounds[3], time, len(self.worst) - 1))
        steep = (len(found) - 1) / time
        return steep * (found[1] - found[0]), steep * (found[-1] - found[-2])

    def _steps(self, trial: Trial, arriving: set[float], leaving: set[float]) -> None:
        most = trial.limits.step or (1e-6 if trial.limits.acceleration else inf)
        self._over(max(abs(after - before) for after in leaving for before in arriving) / most)

    def settle(self) -> np.ndarray:
        """The factors of all trials that were added, after sampling their curves."""
        curves, bounds = np.array(self._curves), np.array(self._bounds)
        low, high, fast, bent, time, owner = bounds.T
        first = 5 * np.diff(curves, axis=1) / time[:, None]
        second = 4 * np.diff(first, axis=1) / time[:, None]
        places = curves @ BASES[5]
        factors = np.maximum.reduce(
            [
                1 + (places.max(axis=1) - high) / SCALE,
                1 + (low - places.min(axis=1)) / SCALE,
                np.abs(first @ BASES[4]).max(axis=1) / fast,
                np.abs(second @ BASES[3]).max(axis=1) / bent,
            ]
        )
        worst = np.array(self.worst)
        np.maximum.at(worst, owner.astype(int), factors)
        return worst


# ── both ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def judged(value: dict[str, Any], limits: CurveLimits, joints: Joints) -> str:
    return problem(value, limits, lambda _: joints)


def compared(random: np.random.Generator, rounds: int, judge: Judge = judged) -> Counter[str]:
    """Judges so many trials by both, and counts what the first one says."""
    counts: Counter[str] = Counter()
    dense, told = Dense(), list[tuple[Trial, str]]()
    for _ in range(rounds):
        trial = made(random)
        at = stamps.time_ns(trial.value["header"]["stamp"])
        late = stamps.problem(trial.value, NOW_NS)
        assert bool(late) == bool(at and abs(at - NOW_NS) > 1e9), late
        if late:
            counts["another time"] += 1
            continue
        stamps.zero(trial.value)
        assert trial.value["header"]["stamp"] == {"sec": 0, "nanosec": 0}
        said = (judged if trial.is_odd else judge)(trial.value, trial.limits, trial.joints)
        if trial.is_odd:
            assert said, trial
            counts["never judged"] += 1
            continue
        dense.add(trial)
        told.append((trial, said))
    for factor, (trial, said) in zip(dense.settle(), told, strict=True):
        assert factor > UNDER if said else factor < OVER, (factor, said, trial)
        counts["refused" if said else "let through"] += 1
    return counts


@pytest.mark.parametrize(
    "rounds", [20_000, pytest.param(1_000_000, marks=[pytest.mark.full, pytest.mark.timeout(1200)])]
)
def test_no_trajectory_that_is_let_through_is_over_a_limit_anywhere_on_its_way(rounds: int) -> None:
    random, counts = np.random.default_rng(rounds), Counter[str]()
    for _ in range(rounds // BATCH):
        counts += compared(random, BATCH)
    print(", ".join(f"{many} {what}" for what, many in counts.items()))
    assert min(counts["let through"], counts["refused"], counts["another time"]) > rounds / 20


# ── judges that are wrong ──────────────────────────────────────────────────────────────────────────────────────────


def without(value: dict[str, Any], *names: str) -> dict[str, Any]:
    """The trajectory as if its points did not carry these."""
    value = deepcopy(value)
    for each in value["points"]:
        each.update({name: [] for name in names})
    return value


def ignores_turns(value: dict[str, Any], limits: CurveLimits, joints: Joints) -> str:
    told = {name: joints.described.get(name, JointBounds()) for name in NAMES}
    return judged(value, limits, replace(joints, described={name: replace(told[name], wraps=False) for name in NAMES}))


def ignores_the_way_to_the_first_point(value: dict[str, Any], limits: CurveLimits, joints: Joints) -> str:
    first = dict(zip(value["joint_names"], value["points"][0]["positions"], strict=True))
    return judged(value, limits, replace(joints, measured={name: State(at) for name, at in first.items()}))


def ignores_measured_speeds(value: dict[str, Any], limits: CurveLimits, joints: Joints) -> str:
    stands = {name: State(state.position, 0.0) for name, state in joints.measured.items()}
    return judged(value, limits, replace(joints, measured=stands))


def ignores_the_order_of_names(value: dict[str, Any], limits: CurveLimits, joints: Joints) -> str:
    return judged({**value, "joint_names": sorted(value["joint_names"])}, limits, joints)


WRONG: dict[str, Judge] = {
    "turns": ignores_turns,
    "the way to the first point": ignores_the_way_to_the_first_point,
    "measured speeds": ignores_measured_speeds,
    "the order of names": ignores_the_order_of_names,
    "velocities": lambda value, limits, joints: judged(without(value, "velocities", "accelerations"), limits, joints),
    "accelerations": lambda value, limits, joints: judged(without(value, "accelerations"), limits, joints),
    "the description": lambda value, limits, joints: judged(value, replace(limits, described=False), joints),
    "jumps of speed": lambda value, limits, joints: judged(value, replace(limits, step=inf), joints),
}


@pytest.mark.parametrize("ignored", WRONG)
def test_the_comparison_finds_a_judge_that_ignores(ignored: str) -> None:
    def let_through_more(value: dict[str, Any], limits: CurveLimits, joints: Joints) -> str:
        said = judged(value, limits, joints)
        return said and WRONG[ignored](value, limits, joints)

    with pytest.raises(AssertionError):
        for seed in range(10):
            compared(np.random.default_rng(seed), BATCH, let_through_more)
