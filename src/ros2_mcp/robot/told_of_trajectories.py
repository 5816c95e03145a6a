"""Sentences about a trajectory for the person who approves it: range of each joint, top speed, duration and reach.

The points alone are not enough: between them a curve may go farther and faster (`ros2_mcp_common.policy.curves`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ros2_mcp.guard.exact import word
from ros2_mcp.model.text import counted
from ros2_mcp.world.urdf import Joint, Urdf
from ros2_mcp_common.policy.field_values import Unfit
from ros2_mcp_common.policy.trajectory_limits import Joints, LookAtJoints, Path, extremes_of, positions_at, read

_LOOKS = 100
"""The number of positions along a trajectory that are checked for the farthest reach: every 0.1 s of 10 s."""

_NO_DESCRIPTION = "No description (URDF) of the robot was found: the limits of its joints are not known."


def told_of(
    trajectories: Sequence[tuple[str, Mapping[str, Any]]], look: LookAtJoints, urdf: Urdf | None
) -> Sequence[str]:
    """Return sentences about trajectories, given with their paths. For a trajectory that cannot be evaluated, one
    sentence says so.
    """
    told = [sentence for path, found in trajectories for sentence in _told(path or "trajectory", found, look, urdf)]
    return [*told, _NO_DESCRIPTION] if told and urdf is None else told


def _told(path: str, trajectory: Mapping[str, Any], look: LookAtJoints, urdf: Urdf | None) -> Sequence[str]:
    if not trajectory["points"]:
        return ()
    try:
        points = read(trajectory)
        joints = look(points.names)
        extremes = extremes_of(points, joints)
    except (Unfit, ValueError):
        return [f"What {word(path)} does between its points is not known."]
    ways = [
        f"{word(name)} from {_short(one.low)} to {_short(one.high)}{_unit(urdf, name)}"
        for name, one in extremes.items()
    ]
    fastest = max(extremes, key=lambda name: extremes[name].speed)
    return [
        f"From where the joints are now, all along: {', '.join(ways)}.",
        f"Top speed {_short(extremes[fastest].speed)}{_unit(urdf, fastest)}/s of {word(fastest)}; "
        f"{counted(len(points.times), 'point')} in {_short(points.times[-1])} s.",
        *_reach(points, joints, urdf),
    ]


def _reach(points: Path, joints: Joints, urdf: Urdf | None) -> Sequence[str]:
    """Return a sentence about how far the last link that the joints move gets from its base, and how low.

    Empty if this is unknown: without a description, or with other joints in the chain that were not measured.
    """
    if urdf is None:
        return ()
    chain = _chain(points.names, urdf)
    if not chain or any(joint.name not in points.names and not joint.mimic for joint in chain):
        return ()
    tool, base = chain[0].child, chain[-1].parent
    tool = next((link for link in urdf.links if link != tool and urdf.fixed_to(link) == tool), tool)
    far, lowest = 0.0, math.inf
    for place in range(_LOOKS + 1):
        positions = positions_at(points, joints, points.times[-1] * place / _LOOKS)
        mount = urdf.mount(tool, base, positions)
        if mount is None:
            return ()
        far, lowest = max(far, math.hypot(*mount.xyz)), min(lowest, mount.xyz[2])
    return [
        f"{word(tool)} comes at most {_short(far)} m away from {word(base)}, and at most down to z {_short(lowest)} m."
    ]


def _chain(names: Sequence[str], urdf: Urdf) -> Sequence[Joint]:
    """Return the joints from the farthest link that the named joints move, back to the first joint that they move."""
    ways = [urdf.moved_by(urdf.joints[name].child) for name in names if name in urdf.joints]
    way = list(max(ways, key=len, default=()))
    while way and way[-1].name not in names:
        way.pop()
    return way


def _unit(urdf: Urdf | None, name: str) -> str:
    joint = urdf.joints.get(name) if urdf else None
    return f" {joint.unit}" if joint else ""


def _short(number: float) -> str:
    """Return a number with four digits: extremes are computed values, and are read quickly."""
    return f"{number + 0.0:.4g}"
