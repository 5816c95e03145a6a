"""The robot's joints in words: where each is now, how far and how fast it may move."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence

from ros2_mcp.codec.robot_kind import arms_of, is_passive, rotors_of, wheels_of
from ros2_mcp.codec.urdf import Joint, Urdf
from ros2_mcp.model.text import named

_SPEED = ", ≤ "
_FAR = 1e6
"""Of a limit in rad or m: more means that there is none."""
_SIDES = r"left|right|[FRHL][LR]|[LR][FHRB]|[LRlr]"
_NUMBERED = re.compile(
    rf"(?P<before>\S*?)(?P<number>\d+|(?<![A-Za-z0-9])(?:{_SIDES})(?=[_A-Z ]))(?P<after>[^\d ]*) now (?P<now>\S+) of "
    r"(?P<span>\S+)(?P<unit> m)?"
)
"""A joint as one of several that differ in a number, or in the side or corner of the robot on which they are."""


def joints_in_words(urdf: Urdf | None, positions: Mapping[str, float], reports: str = "") -> list[str]:
    """Those of the description whose positions count, then others that somebody tells; first of all those of which
    `reports` speak.
    """
    joints: Sequence[Joint] = placed(urdf, positions) if urdf else ()
    joints = sorted(joints, key=lambda joint: joint.name not in reports)
    lines = [_joint(joint, positions.get(joint.name)) for joint in joints]
    told = {joint.name for joint in joints}
    others = [name for name in positions if name not in told and (urdf is None or name not in urdf.joints)]
    return [*lines, *(f"{named(name)} now {_tidy(positions[name])}" for name in others)]


def placed(urdf: Urdf, positions: Mapping[str, float]) -> Sequence[Joint]:
    """The joints whose positions count, all that move but rotors and casters of which nobody tells where they are:
    those of the arm first and wheels last, where what does not fit is left out; of each those before others that
    somebody tells.
    """
    rotors = {joint.name for joint in rotors_of(urdf)}
    arm = {joint.name for joints in arms_of(urdf) for joint in joints}
    wheels = {joint.name for joint in wheels_of(urdf)}
    return sorted(
        (
            joint
            for joint in urdf.moving
            if joint.name in positions or not (joint.name in rotors or is_passive(urdf, joint))
        ),
        key=lambda joint: (joint.name in wheels, joint.name not in arm, joint.name not in positions),
    )


def without_speeds(lines: Sequence[str]) -> list[str]:
    """The same, shorter: how fast a joint may move is found elsewhere, too, and rad are what joints turn by."""
    return [line.partition(_SPEED)[0].removesuffix(" rad") for line in lines]


def with_turning_together(lines: Sequence[str]) -> list[str]:
    """The same, shorter: joints that turn without end, such as wheels, in one line at the end."""
    kinds = " continuous now "
    turning = [line.split(kinds) for line in lines if kinds in line]
    if len(turning) < 2:
        return list(lines)
    others = [line for line in lines if kinds not in line]
    return [*others, f"continuous: {', '.join(f'{name} {at}' for name, at in turning)}"]


def with_chains(lines: Sequence[str]) -> list[str]:
    """The same, shorter: joints whose names differ in a number or side alone, as of arms and legs, in one line."""
    chains: dict[tuple[str, ...], list[tuple[str, str, str]]] = {}
    found: list[tuple[tuple[str, ...], str]] = []
    for line in lines:
        match = _NUMBERED.fullmatch(line)
        key = (match["before"], match["after"], match["unit"] or "") if match else (line,)
        found.append((key, line))
        if match:
            chains.setdefault(key, []).append((match["number"], match["now"], match["span"]))
    told: dict[tuple[str, ...], str] = {}
    for key, line in found:
        numbers, nows, spans = zip(*chains[key], strict=True) if len(chains.get(key, ())) > 1 else ((), (), ("",))
        before, after, unit = key if numbers else ("", "", "")
        limits = spans[0] if len(set(spans)) == 1 else ", ".join(spans)
        together = f"{before}{','.join(numbers)}{after} now {', '.join(nows)} of {limits}{unit}"
        told.setdefault(key, together if numbers else line)
    return list(told.values())


def _joint(joint: Joint, at: float | None) -> str:
    limits = joint.limits
    now = "position unknown" if at is None else f"now {_tidy(at)}"
    span = ""
    if limits.lower is not None and limits.upper is not None:  # rounded inwards: who goes there stays within
        span = f" of {_inwards(limits.lower, math.ceil)}..{_inwards(limits.upper, math.floor)}"
    speed = f"{_SPEED}{_at_most(limits.velocity)} {joint.unit}/s" if limits.velocity else ""
    kind = "" if joint.kind == "revolute" else f" {joint.kind}"
    return f"{named(joint.name)}{kind} {now}{span} {joint.unit}{speed}"


def _inwards(limit: float, rounded: Callable[[float], int]) -> str:
    """To a thousandth; one that is beyond anything that moves as it is."""
    return f"{rounded(limit * 1000) / 1000:g}" if abs(limit) < _FAR else f"{limit:.3g}"


def _at_most(speed: float) -> str:
    """Three digits of it, rounded down: who moves so fast is within the limit."""
    digits = 2 - math.floor(math.log10(speed)) if 0 < speed < _FAR else 0
    return f"{math.floor(speed * 10**digits) / 10**digits:g}" if digits else f"{speed:.3g}"


def _tidy(number: float) -> str:
    """To a thousandth, which is as exact as anybody looks at a joint."""
    return f"{round(number, 3) + 0.0:g}"
