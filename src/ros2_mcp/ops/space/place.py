"""The robot's pose in words, from TF, localisation, odometry or URDF, and the problems with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.pictures import RobotPlace
from ros2_mcp.model.poses import Pose, from_roll_pitch_yaw
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.frames import WORLDS
from ros2_mcp.world.transforms import FrameTree
from ros2_mcp.world.urdf import Mount, Urdf
from ros2_mcp_common.finite import not_finite

_OLD_S = 2.0
"""A pose older than this is not the current pose."""


@dataclass(frozen=True, slots=True)
class Odometer:
    """An odometry topic and its message. `topic` is empty if there is no such topic, `message` None if none was
    received. `age` is set if the message was sent before the subscription began.
    """

    topic: str = ""
    message: Any = None
    age: str = ""


def place_in_words(
    source: Source,
    tree: FrameTree,
    base: str,
    odometer: Odometer,
    urdf: Urdf | None,
    *,
    in_map: RobotPlace | None = None,
    is_unread: bool,
) -> tuple[str, list[str]]:
    """Return the robot's pose in a sentence, and the problems with it.

    If the pose in one frame is old, the pose in the next frame is given too.

    Args:
        in_map: The pose published by a localisation node, for a robot without a transform from the map.
        is_unread: The pose may be published, but was not received in time.
    """
    told, old = list[str](), list[str]()
    for world in WORLDS:
        match = next((name for name in tree.frames if name.rpartition("/")[2] == world), "")
        if match and base and match != base and (found := tree.newest(match, base)):
            age_s = _age_s(source, tree, found.stamp_ns)
            how = "TF, localised" if world == "map" else "TF, by dead reckoning" if world == "odom" else "TF"
            how = "TF, static" if found.stamp_ns is None else how
            told.append(_pose_in_words(match, found.pose.translation, found.pose.yaw_rad, how, age_s))
            if age_s is None or age_s < _OLD_S:
                break
            old.append(f"Its pose in {named(match)} is {age_s:.0f} s old.")
        elif world == "map" and in_map:
            age_s = _age_s(source, tree, in_map.stamp_ns)
            at = (in_map.x_m, in_map.y_m, in_map.z_m)
            told.append(_pose_in_words("map", at, in_map.yaw_rad, "localisation", age_s))
            if age_s is None or age_s < _OLD_S:
                break
    if told:
        return " ".join(told), old
    if odometer.message is not None:
        from ros2_mcp.world.transforms import pose_of

        told_by = named(odometer.topic)
        if why := not_finite(odometer.message, "pose.pose"):
            return f"The robot's pose is unknown: in {told_by}, {why}.", [f"{told_by}: {why}."]
        with suppress(ValueError):  # the squares of very large numbers overflow
            pose = pose_of(odometer.message.pose.pose)
            how = ", ".join(filter(None, (f"odometry, {told_by}", odometer.age)))
            return _pose_in_words(odometer.message.header.frame_id, pose.translation, pose.yaw_rad, how, None), []
    if urdf and (fixed := _fixed_in_world(urdf, base)):
        pose = Pose(fixed.xyz, from_roll_pitch_yaw(*fixed.rpy))
        return _pose_in_words(urdf.root, pose.translation, pose.yaw_rad, "URDF, static", None), []
    if is_unread:
        return "The robot's pose was not read in time.", []
    if not tree.frames:
        return "The robot's pose is unknown: no transforms, no odometry.", []
    base = named(base or "its base")
    return f"The robot's pose is unknown: no transform leads from {base} to a map, odom or world.", []


def _fixed_in_world(urdf: Urdf, base: str) -> Mount | None:
    """Return the pose of the base in the URDF's root link, if that is a world frame and the base is fixed in it; else
    None.
    """
    is_fixed = urdf.root.lower() in WORLDS and base != urdf.root and urdf.fixed_to(base) == urdf.root
    return urdf.mount(base) if is_fixed else None


def _pose_in_words(frame: str, at: Sequence[float], yaw_rad: float, how: str, age_s: float | None) -> str:
    yaw_deg = round(math.degrees(yaw_rad))  # an int has no negative zero
    x, y, z = (round(part, 2) + 0.0 for part in at)  # adding 0.0 turns -0.0 into 0.0
    height = f" z {z:.2f}" if abs(z) >= 0.05 else ""
    age = "" if age_s is None else f", {age_s:.1f} s old" if age_s < _OLD_S else f" {age_s:.0f} s ago"
    return f"In {named(frame)} at x {x:.2f} y {y:.2f}{height} m, yaw {yaw_deg}° ({how}{age})."


def _age_s(source: Source, tree: FrameTree, stamp_ns: int | None) -> float | None:
    if stamp_ns is None:
        return None
    now_ns = now_ns_of(source)
    return None if not now_ns else max((now_ns - stamp_ns - tree.clock_ns) / 1e9, 0.0)


def now_ns_of(source: Source) -> int:
    """Return the time of the robot's clock, or the end of a recording, in ns; 0 if it is not known."""
    return source.transforms.now_ns() if source.transforms else source.covers_ns[1] if source.covers_ns else 0
