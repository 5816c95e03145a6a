"""A small motion as odometry, gyro and laser saw it, against its command: a lidar that is turned against its transform,
odometry with a wrong sign or scale, exchanged wheels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import SENSORS, NavCheck
from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding, Probe, Rank

_LEAST_M, _LEAST_RAD = 0.06, math.radians(8)
"""A motion by less has no direction: a scanner's noise is a centimetre or two."""
_STANDS = 0.25
"""Share of the commanded motion below which a witness says that the robot stood."""
_LOW, _HIGH = 0.7, 1.43
"""Odometry in use is right within a few percent; wheels that slip on a carpet cost up to a fifth."""
_TURNED_RAD = math.radians(20)
"""A larger angle is no inaccurate mounting, and no curve of the robot."""
_BACK_RAD = math.radians(120)
_MOST_NAMES = 3


@dataclass(frozen=True, slots=True)
class _Seen:
    """A motion as measured by one kind of sensor: the topics, and the mean of their values."""

    topics: Sequence[str]
    value: float

    @property
    def sign(self) -> int:
        return 0 if self.value == 0 else 1 if self.value > 0 else -1


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    probes = evidence.probes or ()
    against = any(one.is_turn and _turns_against(one) for one in probes)
    misled = any(one.is_turn and _is_misled(one) for one in probes)
    found = [
        finding
        for one in probes
        for finding in (_turn(one) if one.is_turn else _drive(one, against=against, misled=misled))
    ]
    yield from sorted(found, key=lambda finding: finding.rank != "stops everything")


def _mean(values: Mapping[str, float]) -> _Seen | None:
    """Return the mean of what sensors of one kind measured; None if there is none, or if their signs contradict each
    other.
    """
    if not values or min(values.values()) < 0 < max(values.values()):
        return None
    return _Seen(sorted(values), sum(values.values()) / len(values))


# ── turning ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _seen_turning(probe: Probe) -> tuple[_Seen | None, _Seen | None, _Seen | None]:
    """Return the rotation that odometry, gyro and laser measured, in this order."""
    return (
        _mean({topic: one.turned_rad for topic, one in probe.odometry.items()}),
        _mean(dict(probe.gyro)),
        _mean({topic: one.turned_rad for topic, one in probe.laser.items()}),
    )


def _truth(probe: Probe) -> float | None:
    """Return the angle turned by gyro and laser, which do not depend on the wheels; None if it is not known."""
    odometry, gyro, laser = _seen_turning(probe)
    if gyro and laser and gyro.sign != laser.sign and odometry:  # one of both is mounted wrongly
        return (gyro if gyro.sign == odometry.sign else laser).value
    witnesses = [one.value for one in (gyro, laser) if one]
    return sum(witnesses) / len(witnesses) if witnesses else None


def _turns_against(probe: Probe) -> bool:
    truth = _truth(probe)
    return truth is not None and abs(truth) >= _LEAST_RAD and truth * probe.commanded < 0


def _odometry_turning(probe: Probe, truth: float) -> _Seen | None:
    """Return the angle by odometry; if several contradict each other, by those that contradict the truth."""
    values = {topic: one.turned_rad for topic, one in probe.odometry.items()}
    return _mean(values) or _mean({topic: value for topic, value in values.items() if value * truth < 0})


def _is_misled(probe: Probe) -> bool:
    """Whether an odometry turns the wrong way: the direction of what it says the robot drove is wrong, too."""
    truth = _truth(probe)
    odometry = None if truth is None else _odometry_turning(probe, truth)
    return bool(truth and odometry and abs(truth) >= _LEAST_RAD and odometry.value * truth < 0)


def _turn(probe: Probe) -> Iterator[NavFinding]:
    _, gyro, laser = _seen_turning(probe)
    truth, proof = _truth(probe), in_words(probe)
    odometry = None if truth is None else _odometry_turning(probe, truth)
    if truth is None or odometry is None:
        return
    yield from _mounted(probe, odometry, gyro, laser)
    if stood := _stood(probe, odometry, truth, _LEAST_RAD):
        yield stood
        return
    if abs(truth) < _LEAST_RAD:
        return
    is_against = _turns_against(probe)
    is_wrong = odometry.value * truth < 0
    if is_against:
        unseen = ", and odometry does not see it" if is_wrong else ""
        yield _finding(
            "stops everything",
            odometry,
            f"The robot turns against its commands{unseen}: the wheels, or the signs of their motors, are exchanged.",
            proof,
            "Exchange left_wheel_names and right_wheel_names (or the motors' signs) in the base's driver.",
        )
    elif is_wrong:
        yield _finding(
            "stops everything",
            odometry,
            f"Odometry turns the wrong way: {listed(odometry.topics, _MOST_NAMES)}.",
            proof,
            "Exchange the wheels' encoders, or their signs, in the base's driver; the commands are right.",
        )
    else:
        turned = {topic: one.turned_rad for topic, one in probe.odometry.items()}
        yield from _scale(turned, truth, proof, is_turn=True)


def _mounted(probe: Probe, odometry: _Seen, gyro: _Seen | None, laser: _Seen | None) -> Iterator[NavFinding]:
    """Find a gyro or a laser that contradicts odometry and the other sensor."""
    if not (gyro and laser) or gyro.sign == laser.sign or min(abs(gyro.value), abs(laser.value)) < _LEAST_RAD:
        return
    wrong = laser if gyro.sign == odometry.sign else gyro
    what = "The scan" if wrong is laser else "The gyro"
    yield _finding(
        "stops everything",
        wrong,
        f"{what} turns the wrong way ({listed(wrong.topics, _MOST_NAMES)}): it is mounted upside down, and its "
        "transform does not say so.",
        in_words(probe),
        "Give its joint in the URDF (or its static transform) a roll of 180°.",
    )


# ── driving ahead ──────────────────────────────────────────────────────────────────────────────────────────────────


def _drive(probe: Probe, *, against: bool, misled: bool) -> Iterator[NavFinding]:
    """Judge a drive; `against`: the robot turns against its commands, and so may drive against them, too; `misled`:
    odometry turns the wrong way, and so drives in a wrong direction, too."""
    odometry = _mean({topic: one.ahead_m for topic, one in probe.odometry.items()})
    if odometry is None:
        return
    proof = in_words(probe)
    for topic, seen in probe.laser.items():
        away_m, way = math.hypot(seen.ahead_m, seen.left_m), math.atan2(seen.left_m, seen.ahead_m)
        if stood := _stood(probe, odometry, away_m, _LEAST_M):
            yield stood
        elif away_m >= _LEAST_M:
            yield from _driven(probe, odometry, topic, away_m, way, proof, against=against, misled=misled)
        return


def _driven(
    probe: Probe, odometry: _Seen, topic: str, away_m: float, way: float, proof: str, *, against: bool, misled: bool
) -> Iterator[NavFinding]:
    is_back = abs(way) > _BACK_RAD
    is_wrong = not misled and odometry.value * probe.commanded < 0
    if is_back and (against or is_wrong):
        unseen = "" if is_wrong else ", and odometry does not see it"
        yield _finding(
            "stops everything",
            odometry,
            f"The robot drives against its commands{unseen}: the signs of its motors are wrong.",
            proof,
            "Reverse the motors' signs (or the wheels' axes) in the base's driver.",
        )
    elif is_wrong:
        yield _finding(
            "stops everything",
            odometry,
            f"Odometry counts backwards: {listed(odometry.topics, _MOST_NAMES)}.",
            proof,
            "Reverse the signs of the wheels' encoders in the base's driver; the commands are right.",
        )
    elif abs(way) > _TURNED_RAD:
        off_deg = math.degrees(way)
        yield NavFinding(
            rank="stops everything",
            subject=topic,
            cause=f"The lidar is turned against its transform by {abs(off_deg):.0f}°: as the robot drove ahead, what "
            f"came nearer on {named(topic)} was at {off_deg:.0f}° (left is positive).",
            proof=proof,
            remedy=f"Add {-off_deg:.0f}° to the yaw of its joint in the URDF (or of its static transform).",
        )
    elif not misled:
        ahead = {topic: one.ahead_m for topic, one in probe.odometry.items()}
        yield from _scale(ahead, math.copysign(away_m, probe.commanded), proof, is_turn=False)


# ── both ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def _stood(probe: Probe, odometry: _Seen, truth: float, least: float) -> NavFinding | None:
    """Find odometry that reports a motion although the robot stands, or none although the robot moves."""
    told = abs(odometry.value) >= least
    moved = abs(truth) >= least
    if told == moved or abs(probe.commanded) < least:
        return None
    if told and abs(truth) > _STANDS * abs(odometry.value):
        return None
    if moved and abs(odometry.value) > _STANDS * abs(truth):
        return None
    cause = (
        "Odometry reports a motion that nothing else sees: wheels slip or are lifted, or it only adds up the commands."
        if told
        else "Odometry reports no motion while the robot moves: the encoders count nothing."
    )
    remedy = "Check whether the robot stands on its wheels." if told else "Check the encoders and the base's driver."
    return _finding("stops everything", odometry, cause, in_words(probe), remedy)


def _scale(values: Mapping[str, float], truth: float, proof: str, *, is_turn: bool) -> Iterator[NavFinding]:
    """Find odometries, by topic, that count more or less than was moved."""
    off = _mean({topic: value for topic, value in values.items() if not _LOW <= value / truth <= _HIGH})
    if off is None:
        return
    share = off.value / truth
    # A larger wheel radius counts more metres; a larger distance between the wheels counts smaller angles.
    setting = f"wheel_separation by {share:.2f}" if is_turn else f"wheel_radius by {1 / share:.2f}"
    yield _finding(
        "stops some goals",
        off,
        f"Odometry counts {share:.2f} of what the robot {'turns' if is_turn else 'drives'}: "
        f"{listed(off.topics, _MOST_NAMES)}.",
        proof,
        f"Multiply {setting} in the driver of the base; until then odom → base and the map drift apart.",
    )


def _finding(rank: Rank, seen: _Seen, cause: str, proof: str, remedy: str) -> NavFinding:
    return NavFinding(rank=rank, subject=seen.topics[0], cause=cause, proof=proof, remedy=remedy)


def in_words(probe: Probe) -> str:
    """Say what was commanded, and what each witness measured."""
    if probe.is_turn:
        said = [f"{named(topic)} {math.degrees(one.turned_rad):+.0f}°" for topic, one in probe.odometry.items()]
        said += [f"gyro {named(topic)} {math.degrees(value):+.0f}°" for topic, value in probe.gyro.items()]
        said += [f"scan {named(topic)} {math.degrees(one.turned_rad):+.0f}°" for topic, one in probe.laser.items()]
        return f"Turn, commanded {math.degrees(probe.commanded):+.0f}°: {', '.join(said)}."
    said = [f"{named(topic)} {one.ahead_m:+.2f} m" for topic, one in probe.odometry.items()]
    for topic, one in probe.laser.items():
        way = math.degrees(math.atan2(one.left_m, one.ahead_m))
        said.append(f"scan {named(topic)} {math.hypot(one.ahead_m, one.left_m):.2f} m towards {way:+.0f}°")
    return f"Drive, commanded {probe.commanded:+.2f} m: {', '.join(said)}."


CHECK = NavCheck(("probes",), _find, SENSORS)
