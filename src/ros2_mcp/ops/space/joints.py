"""The robot's joints in words: position, limits and greatest speed of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ros2_mcp.model.text import named
from ros2_mcp.world.robot_kind import arms_of, is_passive, rotors_of, wheels_of
from ros2_mcp.world.urdf import Joint, Urdf

_FAR = 1e6
"""A limit in rad or m beyond this means no limit."""
_DECIMALS = 3
"""Decimals of a position, and significant digits of a speed: finer values are of no use to a reader."""


@dataclass(frozen=True, slots=True)
class JointNow:
    """A joint with its position, its limits and its greatest speed; None, or 0 for the speed, if unknown. `unit` is rad
    or m; it and `kind` are empty for a joint that the description lacks. `mimics` is the joint that it follows.
    """

    name: str
    kind: str = "revolute"
    at: float | None = None
    span: tuple[float, float] | None = None
    speed: float = 0.0
    unit: str = ""
    mimics: str = ""

    @property
    def line(self) -> str:
        """The joint in words, such as `elbow 0.1 rad, limits -1 to 1 rad, at most 2 rad/s`."""
        kind = f" {self.kind}" if self.kind not in ("", "revolute") else ""
        unit = f" {self.unit}" if self.unit else ""
        at = "position unknown" if self.at is None else f"{round(self.at, _DECIMALS) + 0.0:g}{unit}"
        span = f", limits {_span_in_words(*self.span)}{unit}" if self.span else ""
        speed = f", at most {_at_most(self.speed)}{unit}/s" if self.speed else ""
        more = "" if self.kind else " (no unit)"
        more += f", mimics {named(self.mimics)}" if self.mimics else ""
        return f"{named(self.name)}{kind} {at}{span}{speed}{more}"


def joints_now(urdf: Urdf | None, positions: Mapping[str, float], reports: str = "") -> list[JointNow]:
    """Return the joints of the description that have positions of their own, then mimic joints and joints that only the
    joint states hold. Joints named in `reports`, such as faults, come first.
    """
    joints: Sequence[Joint] = placed(urdf, positions) if urdf else ()
    joints = sorted(joints, key=lambda joint: joint.name not in reports)
    joints += [joint for joint in urdf.joints.values() if joint.mimic and joint.name in positions] if urdf else []
    others = [name for name in positions if urdf is None or name not in urdf.joints]
    known = {name: at for name, at in positions.items() if math.isfinite(at)}  # drivers send NaN for unknown positions
    return [
        *(_joint(joint, known.get(joint.name)) for joint in joints),
        *(JointNow(name, kind="", at=known.get(name)) for name in others),
    ]


def placed(urdf: Urdf, positions: Mapping[str, float]) -> Sequence[Joint]:
    """Return the moving joints, without rotors and passive casters whose positions are not published. Those of arms
    come first and wheels last, as the end of the list may be cut; within each group, those with a published position
    first.
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
    span = span if limits.known else None
    mimics = joint.mimic.joint if joint.mimic else ""
    return JointNow(joint.name, joint.kind, at, span, limits.velocity or 0.0, joint.unit, mimics)


def _span_in_words(lower: float, upper: float) -> str:
    """Return the limits, rounded inwards so that a command to a shown limit is valid."""
    return f"{_inwards(lower, math.ceil)} to {_inwards(upper, math.floor)}"


def _inwards(limit: float, rounded: Callable[[float], int]) -> str:
    """Round a limit to 3 decimals in the given direction; a practically infinite limit is not rounded."""
    return f"{rounded(limit * 10**_DECIMALS) / 10**_DECIMALS:g}" if abs(limit) < _FAR else f"{limit:.3g}"


def _at_most(speed: float) -> str:
    """Return the speed rounded down, so that a command of the shown speed is valid."""
    if not 0 < speed < _FAR:
        return f"{speed:.3g}"
    unit = 10.0 ** (_DECIMALS - 1 - math.floor(math.log10(speed)))
    return f"{math.floor(speed * unit) / unit:g}"
