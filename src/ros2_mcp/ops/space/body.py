"""The robot's body in words: footprint and sensor mounts, each with its source (URDF, TF or costmap)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ros2_mcp.model.poses import Pose, from_roll_pitch_yaw, rotated
from ros2_mcp.model.text import named
from ros2_mcp.ops.space.frames import WORLDS
from ros2_mcp.world.footprint import outline, reach, unmeasured
from ros2_mcp.world.robot_kind import arms_of, legs_of, rotors_of
from ros2_mcp.world.transforms import FrameTree
from ros2_mcp.world.urdf import Urdf

_STEEP_DEG = 75.0
"""Elevation beyond which a camera is reported as looking straight up or down, without a yaw."""
_UPRIGHT = 0.5
"""Largest z component of a camera's z axis with which its frame is still taken as optical; above it z points up."""
_TILTED_DEG = 2.0
"""Roll and pitch below this are mounting tolerance and not reported."""
_LEAST_ROUND, _ROUND = 8, 0.95
"""A footprint of 8 or more corners whose radii differ by less than 5 % is reported as a circle."""


@dataclass(frozen=True, slots=True)
class MountInWords:
    """The mount of a frame in words: `at` is x y z in m and the rotation, in the base's frame; it is empty if the frame
    is the base's own or the mount is unknown. `note` qualifies it, e.g. names the joint that moves the frame.
    """

    at: str = ""
    note: str = ""


MOVING = " moving with"
NO_MOUNT = MountInWords(note=" (mount unknown)")


def footprint_in_words(
    urdf: Urdf | None, tree: FrameTree, base: str, published: Sequence[tuple[float, float, float]], frame: str
) -> str:
    """Describe the robot's footprint about the origin of `base`. The size comes from the URDF. If the URDF has only
    meshes for a part, or no shape at all, use the footprint `published` by Nav2 in `frame`; without one, report the
    size of the other parts as a least size, or that the footprint is unknown.
    """
    root = urdf.root if urdf and base not in urdf.links else base
    size = reach(outline(urdf, root)) if urdf else None
    meshes = unmeasured(urdf, root) if urdf else ()
    if (size is None or meshes) and (of_costmap := _of_costmap(tree, base, published, frame)):
        return of_costmap
    if size is None:
        return f"unknown: {_first(meshes)} has only a mesh" if meshes else "unknown"
    long_m, wide_m = size.front_m + size.rear_m, size.left_m + size.right_m
    least = f", without the mesh{'es' if len(meshes) > 1 else ''} of {_first(meshes)}" if meshes else ""
    stands = " including wheels or legs" if urdf and _stands_on(urdf, root) else ""
    stands += _made_of(urdf) if urdf else ""
    reaches = _reaches_in_words(size.front_m, size.rear_m, size.left_m, size.right_m)
    return f"{'at least ' if meshes else ''}{long_m:.2f} × {wide_m:.2f} m{reaches}{stands}{least}"


def _made_of(urdf: Urdf) -> str:
    """Return which pose or parts the footprint assumes: straight legs, no arms, or the area swept by rotors; else
    empty.
    """
    if legs_of(urdf):
        return " (legs straight, without arms)" if arms_of(urdf) else " (legs straight)"
    return ", swept by the rotors" if rotors_of(urdf) else ""


def _stands_on(urdf: Urdf, base: str) -> bool:
    """Return whether the base is fixed in the world on something that has a shape, such as a table."""
    is_fixed = urdf.root.lower() in WORLDS and urdf.fixed_to(base) == urdf.root
    held = [joint.parent for joint in urdf.way_up(base)] if is_fixed else []
    return any(urdf.links[name].collisions or urdf.links[name].visuals for name in held if name in urdf.links)


def _first(links: Sequence[str]) -> str:
    return f"{named(links[0])}{f' and {len(links) - 1} more' if len(links) > 1 else ''}"


def _of_costmap(tree: FrameTree, base: str, published: Sequence[tuple[float, float, float]], frame: str) -> str:
    """Describe the footprint published by Nav2, in m in the frame of `base`; empty if none is published, or no
    transform from `frame` is known.
    """
    found = tree.newest(base, frame) if base and frame != base else None
    if len(published) < 3 or (found is None and frame != base):
        return ""
    points = [(found.pose.applied(at) if found else at)[:2] for at in published]
    far = [math.hypot(x, y) for x, y in points]
    if min(far) > _ROUND * max(far) and len(points) >= _LEAST_ROUND:
        return f"radius {max(far):.2f} m (costmap)"
    x, y = [at[0] for at in points], [at[1] for at in points]
    reaches = _reaches_in_words(max(x), -min(x), max(y), -min(y))
    return f"{max(x) - min(x):.2f} × {max(y) - min(y):.2f} m{reaches} (costmap)"


def _reaches_in_words(front_m: float, rear_m: float, left_m: float, right_m: float) -> str:
    """Return the distances from the base's origin to each side, in m; "centred" if opposite sides are equal."""
    front, rear, left, right = (f"{round(side, 2) + 0.0:.2f}" for side in (front_m, rear_m, left_m, right_m))
    if front == rear and left == right:
        return ", centred"
    sides = f"each side {left}" if left == right else f"left {left}, right {right}"
    return f": front {front}, rear {rear}, {sides}"


def mounted(
    urdf: Urdf | None,
    tree: FrameTree,
    base: str,
    frame: str,
    positions: Mapping[str, float],
    *,
    is_camera: bool = False,
) -> MountInWords:
    """Return the mount of a sensor's frame: from TF, else from the URDF and the joints' `positions`, with a note that
    it is not from TF. For a camera, the viewing direction is given instead of the rotation.
    """
    frame = frame.lstrip("/")
    if frame == base:
        return MountInWords()
    movers = urdf.moved_by(frame, base) if urdf and base in urdf.links else ()
    moving = f"{MOVING} {named(movers[0].name)}" if movers else ""
    if base and (found := tree.newest(base, frame)):
        return MountInWords(_at(found.pose, frame, is_camera=is_camera), moving)
    if urdf is None or base not in urdf.links or (mount := urdf.mount(frame, base, positions)) is None:
        return NO_MOUNT
    unknown = next((joint.name for joint in movers if urdf.position(joint, positions) is None), None)
    if unknown is not None:
        return MountInWords(note=f" (mount unknown: {named(unknown)} moves it)")
    pose = Pose(mount.xyz, from_roll_pitch_yaw(*mount.rpy))
    return MountInWords(_at(pose, frame, is_camera=is_camera), f"{moving} (by URDF, not TF)")


def _at(pose: Pose, frame: str, *, is_camera: bool) -> str:
    """Return the position in m, with the viewing direction of a camera or else the rotation. A camera frame not called
    optical is taken as optical too (z into the picture, as in sensor_msgs/Image), unless its z points up: some
    simulators stamp images with the frame of the camera's body.
    """
    x, y, z = (f"{round(part, 2) + 0.0:g}" for part in pose.translation)
    if "optical" in frame:
        return f"{x} {y} {z}{_looking(pose)}"
    if is_camera and rotated(pose.rotation, (0.0, 0.0, 1.0))[2] < _UPRIGHT:
        return f"{x} {y} {z} z to{_looking(pose) or ' the front'}"
    return f"{x} {y} {z}{_turned(pose)}"


def _turned(pose: Pose) -> str:
    """Return the rotation in whole degrees: roll, pitch and yaw, angles below 0.5° omitted; only yaw if the frame is
    level.
    """
    angles_deg = [math.degrees(angle) for angle in pose.roll_pitch_yaw_rad]
    if max(map(abs, angles_deg[:2])) < _TILTED_DEG:
        angles_deg[:2] = [0.0, 0.0]
    names = zip(("roll", "pitch", "yaw"), angles_deg, strict=True)
    return "".join(f" {name} {_whole(angle)}°" for name, angle in names if abs(angle) >= 0.5)


def _looking(pose: Pose) -> str:
    """Return the viewing direction of a camera, which is +z of its optical frame (REP 103): its yaw in the base's
    frame, and its elevation.
    """
    x, y, z = rotated(pose.rotation, (0.0, 0.0, 1.0))
    up_deg, yaw_deg = math.degrees(math.asin(min(max(z, -1.0), 1.0))), math.degrees(math.atan2(y, x))
    where = "down" if up_deg < 0 else "up"
    if abs(up_deg) > _STEEP_DEG:
        return f" straight {where}"
    turned = f" yaw {_whole(yaw_deg)}°" if abs(yaw_deg) >= 0.5 else ""
    return f"{turned}{f' {abs(up_deg):.0f}° {where}' if abs(up_deg) >= _TILTED_DEG else ''}"


def _whole(angle_deg: float) -> int:
    """Round to whole degrees; -180 becomes 180."""
    return 180 if round(angle_deg) == -180 else round(angle_deg)
