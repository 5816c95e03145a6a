"""The links of a robot that joints move (arm, gripper, head), seen from above; from description and transforms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ros2_mcp.model.poses import Pose, Vector
from ros2_mcp.world.footprint import Point, corners, hull, parts_of
from ros2_mcp.world.urdf import Mount, Urdf

_MOST = 200
"""Links: a hand with five fingers on an arm has 40, a humanoid 80."""


@dataclass(frozen=True, slots=True)
class Limb:
    """A link of an arm or the like: `parent` is the link that holds it.

    `corners` are those of its shapes in m, in its own frame; empty if its shapes are only meshes. `is_jointed` is false
    if it is fixed to its parent.
    """

    link: str
    parent: str
    corners: Sequence[Vector]
    is_jointed: bool


@dataclass(frozen=True, slots=True)
class LimbSeen:
    """A limb seen from above.

    `outline` is that of its shapes (empty if they have no size), and `bone` the line from the origin of the link that
    holds it to its own origin (None if the pose of that link is not known), in m. `top_m` is the z of its highest
    point.
    """

    outline: Sequence[Point]
    bone: tuple[Point, Point] | None
    is_jointed: bool
    top_m: float


def limbs_of(urdf: Urdf, base: str) -> Sequence[Limb]:
    """Return the links above moving joints that do not belong to the footprint of the body: no wheels and no legs."""
    if base not in urdf.links:
        return ()
    body = urdf.fixed_to(base)
    of_outline = set(parts_of(urdf, body))
    found: list[Limb] = []
    for name, link in urdf.links.items():
        joint = urdf.above(name)
        if name in of_outline or joint is None or urdf.mount(name, body) is None:
            continue
        shapes = link.collisions or link.visuals
        points = [point for shape in shapes for point in corners(shape, Mount())]
        found.append(Limb(name, joint.parent, points, joint.kind != "fixed"))
    return found[:_MOST]


def limbs_seen(limbs: Sequence[Limb], place: Callable[[str], Pose | None]) -> Sequence[LimbSeen]:
    """Return the limbs whose pose in the picture's frame is known to `place`, the lowest first."""
    found: list[LimbSeen] = []
    for limb in limbs:
        pose, held = place(limb.link), place(limb.parent)
        if pose is None:
            continue
        points = [pose.applied(point) for point in limb.corners]
        bone = (held.translation[:2], pose.translation[:2]) if held else None
        top_m = max((point[2] for point in points), default=pose.translation[2])
        found.append(LimbSeen(hull([point[:2] for point in points]), bone, limb.is_jointed, top_m))
    return sorted(found, key=lambda limb: limb.top_m)
