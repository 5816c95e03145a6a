"""What joints move on a robot, seen from above: an arm, a gripper, a head; by description and transforms."""

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
    """A link that a joint moves: `parent` is the link that holds it; `corners` of its shapes, in m of its own frame,
    are empty where only meshes tell its shape. `is_jointed` is false of what is fixed to its parent."""

    link: str
    parent: str
    corners: Sequence[Vector]
    is_jointed: bool


@dataclass(frozen=True, slots=True)
class LimbSeen:
    """A limb from above: the `outline` of its shapes (empty where they have no size), and the line `bone` from the
    origin of the link that holds it to its own (None where that link's place is not known), in m."""

    outline: Sequence[Point]
    bone: tuple[Point, Point] | None
    is_jointed: bool
    top_m: float


def limbs_of(urdf: Urdf, base: str) -> Sequence[Limb]:
    """The links that joints move and that the outline of the body has not: no wheels and no legs."""
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
    """The limbs of which `place` knows where they are in the picture's frame, the lowest first."""
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
