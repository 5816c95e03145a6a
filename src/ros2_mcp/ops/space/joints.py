"""The robot's joints in words: where each is now, how far and how fast it may move."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from ros2_mcp.ops.space.style import Style, same_or_each
from ros2_mcp.world.robot_kind import arms_of, is_passive, rotors_of, wheels_of
from ros2_mcp.world.urdf import Joint, Urdf

_FAR = 1e6
"""Of a limit in rad or m: more means that there is none."""
_DECIMALS = 3
"""As exact as anybody looks at a joint."""
_LEAST_EQUAL = 3
"""Lines with one speed: then it is told once."""
_SIDE = r"left|right|front|rear|back|hind|middle|[FRHL][LR]|[LR][FHRB]|[LRlrFfHhBb]"
_NUMBER_OR_SIDE = re.compile(rf"\d+|(?<![A-Za-z0-9])(?:{_SIDE})(?:_?(?:left|right))?(?=[_.A-Z]|$)")
"""In the name of a joint: in what those of an arm, of two sides or of four corners differ."""


@dataclass(frozen=True, slots=True)
class JointNow:
    """A joint where it is now, and how far and how fast it may move; None, or 0, where that is not known. `unit` is rad
    or m, and empty of one that the description does not have, as is its `kind`; `mimics` is the joint that it follows.
    """

    name: str
    kind: str = "revolute"
    at: float | None = None
    span: tuple[float, float] | None = None
    speed: float = 0.0
    unit: str = ""
    mimics: str = ""

    @property
    def row(self) -> tuple[str, ...]:
        """What those have in common that can stand together: all that turn without end, such as wheels, can."""
        pattern = "" if self.kind == "continuous" else _NUMBER_OR_SIDE.sub("#", self.name, count=1)
        return pattern, self.kind, self.unit, "limited" if self.span else "", "slow" if self.speed else ""


def joints_now(urdf: Urdf | None, positions: Mapping[str, float], reports: str = "") -> list[JointNow]:
    """Those of the description whose positions count, then others that somebody tells; first of all those of which
    `reports` speak.
    """
    joints: Sequence[Joint] = placed(urdf, positions) if urdf else ()
    joints = sorted(joints, key=lambda joint: joint.name not in reports)
    joints += [joint for joint in urdf.joints.values() if joint.mimic and joint.name in positions] if urdf else []
    others = [name for name in positions if urdf is None or name not in urdf.joints]
    known = {name: at for name, at in positions.items() if math.isfinite(at)}  # drivers send NaN for what they lack
    return [
        *(_joint(joint, known.get(joint.name)) for joint in joints),
        *(JointNow(name, kind="", at=known.get(name)) for name in others),
    ]


def without_last_speeds(joints: Sequence[JointNow]) -> tuple[list[JointNow], int]:
    """The same without the speeds of the last row that has any, and how many those are."""
    last = next((joint.row for joint in reversed(joints) if joint.speed), None)
    found = [replace(joint, speed=0.0) if joint.row == last else joint for joint in joints]
    return found, sum(joint.row == last for joint in joints)


def joints_in_words(joints: Sequence[JointNow], style: Style) -> list[str]:
    """A line each, or for those together that differ in a number or side alone: `{L,R}Hip 0.1, 0.2 of -1..1`. In brief
    a speed that all have is told once.
    """
    speeds = {_at_most(one.speed, style.decimals) for one in joints if one.speed}
    groups = style.groups(joints, key=lambda one: one.row)
    if not style.is_brief or len(speeds) != 1 or sum(bool(group[0].speed) for group in groups) < _LEAST_EQUAL:
        return [_together(group, style) for group in groups]
    alone = [_together([replace(one, speed=0.0) for one in group], style) for group in groups if group[0].speed]
    others = [_together(group, style) for group in groups if not group[0].speed]
    return [*alone, f"all these {speeds.pop()}/s", *others]


def _together(joints: Sequence[JointNow], style: Style) -> str:
    first = joints[0]
    is_clear = first.kind == "revolute" or (style.is_brief and first.kind == "prismatic")  # it is told in m
    kind = "" if is_clear or not first.kind else f" {first.kind}"
    decimals = style.decimals if first.unit == "rad" else _DECIMALS
    unknown = "position unknown" if len(joints) == 1 else "unknown"
    places = [unknown if one.at is None else f"{round(one.at, decimals) + 0.0:g}" for one in joints]
    span = f" of {_spans_in_words([one.span for one in joints if one.span], style.decimals)}" if first.span else ""
    is_told = first.unit and not (style.is_brief and first.unit == "rad")
    unit = f" {first.unit}" if is_told else ""
    speeds = [_at_most(one.speed, style.decimals) for one in joints if one.speed]
    speed = f", {'' if style.is_brief else '≤ '}{same_or_each(speeds)}{unit}/s" if speeds else ""
    more = "" if first.kind else " (no unit)"
    more += f", mimics {style.name(first.mimics)}" if first.mimics and not style.is_brief else ""
    return f"{style.names(one.name for one in joints)}{kind} {same_or_each(places)}{span}{unit}{speed}{more}"


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


def _joint(joint: Joint, at: float | None) -> JointNow:
    limits = joint.limits
    span = (limits.lower, limits.upper) if limits.lower is not None and limits.upper is not None else None
    mimics = joint.mimic.joint if joint.mimic else ""
    return JointNow(joint.name, joint.kind, at, span, limits.velocity or 0.0, joint.unit, mimics)


def _spans_in_words(spans: Sequence[tuple[float, float]], decimals: int) -> str:
    said = [_span_in_words(*span, decimals) for span in spans]
    if len(spans) == 2 and said[0] != said[1] == _span_in_words(-spans[0][1], -spans[0][0], decimals):
        return f"{said[0]}, mirrored"  # as of the two sides of a body
    return same_or_each(said)


def _span_in_words(lower: float, upper: float, decimals: int) -> str:
    """Rounded inwards: who goes there stays within."""
    least, most = _inwards(lower, math.ceil, decimals), _inwards(upper, math.floor, decimals)
    return f"±{most}" if least == f"-{most}" else f"{least}..{most}"


def _inwards(limit: float, rounded: Callable[[float], int], decimals: int) -> str:
    """To so many decimals; one that is beyond anything that moves as it is."""
    return f"{rounded(limit * 10**decimals) / 10**decimals:g}" if abs(limit) < _FAR else f"{limit:.3g}"


def _at_most(speed: float, digits: int) -> str:
    """So many digits of it, rounded down: who moves so fast is within the limit."""
    if not 0 < speed < _FAR:
        return f"{speed:.3g}"
    unit = 10.0 ** (digits - 1 - math.floor(math.log10(speed)))
    return f"{math.floor(speed * unit) / unit:g}"
