"""The footprint of a robot (its outline from above), from its description."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ros2_mcp.model.poses import Vector
from ros2_mcp.world.robot_kind import above_of, legs_of, rotors_of, wheels_of
from ros2_mcp.world.urdf import Geometry, Mount, Urdf

_CORNERS = 24
"""Corners of a circle: the footprint of a round robot is then at most 1 % of its radius too small."""
_LARGEST_M = 20.0
"""A larger shape is a mistake of units, or a floor that was put into the description."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Reach:
    """Extent of a footprint from the base's origin in metres: along +x, -x, +y, -y, and the largest distance."""

    front_m: float
    rear_m: float
    left_m: float
    right_m: float
    radius_m: float


def outline(urdf: Urdf, base: str) -> Sequence[Point]:
    """Return the convex hull of the links fixed to the base and its wheels, counter-clockwise, in metres of `base`.

    Links that steer a wheel are included, and the legs of a legged robot, with every joint at 0: a body narrower than
    its feet is no footprint. Collision shapes are used, or visual shapes for links without them. Meshes have no size in
    a description. Empty if the description has no such link, or no shape with a size.
    """
    return hull([(x, y) for x, y, _ in _points(urdf, base)])


def heights(urdf: Urdf, base: str) -> tuple[float, float] | None:
    """Return the least and the greatest z of the links of `outline`, in metres of `base`; None if they have no size."""
    z = [at[2] for at in _points(urdf, base)]
    return (min(z), max(z)) if z else None


def beyond(points: Sequence[Point], x: float, y: float) -> float:
    """Return the distance of a point from a footprint (a convex hull, counter-clockwise), in m; 0 inside."""
    if all(_turn(one, two, (x, y)) >= 0 for one, two in zip(points, (*points[1:], points[0]), strict=True)):
        return 0.0
    return min(_from_line(one, two, x, y) for one, two in zip(points, (*points[1:], points[0]), strict=True))


def _from_line(one: Point, two: Point, x: float, y: float) -> float:
    along_x, along_y = two[0] - one[0], two[1] - one[1]
    length = along_x * along_x + along_y * along_y
    share = ((x - one[0]) * along_x + (y - one[1]) * along_y) / length if length else 0.0
    share = min(1.0, max(0.0, share))
    return math.hypot(x - one[0] - share * along_x, y - one[1] - share * along_y)


def _points(urdf: Urdf, base: str) -> Sequence[Vector]:
    """Return the corners of all shapes of the footprint, in the frame `base`."""
    if base not in urdf.links:
        return ()
    body = urdf.fixed_to(base)
    base_in_body = urdf.mount(base, body)
    if base_in_body is None:
        return ()
    points: list[Vector] = []
    rotors = {joint.child: joint for joint in rotors_of(urdf)}
    for name in parts_of(urdf, body):
        link, mount = urdf.links[name], urdf.mount(name, body)
        if mount is None:
            continue
        for shape in link.collisions or link.visuals:
            own = list(corners(shape, Mount()))
            own = list(_swept(own, rotors[name].axis)) if name in rotors else own
            points += [_in_base(mount.of(Mount(at)).xyz, base_in_body) for at in own]
    return points


def _swept(points: Sequence[Vector], axis: Vector) -> Iterator[Vector]:
    """Return the circle that a rotor sweeps: that of its farthest point about its axis, in the frame of its link."""
    x, y, z = _unit(axis)
    u = _unit((y, -x, 0.0) if math.hypot(x, y) > abs(z) else (0.0, z, -y))  # perpendicular to the axis
    v = (y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0])
    radius = max((_distance(point, (x, y, z)) for point in points), default=0.0)
    for number in range(_CORNERS):
        turn = 2 * math.pi * number / _CORNERS
        along, aside = radius * math.cos(turn), radius * math.sin(turn)
        yield along * u[0] + aside * v[0], along * u[1] + aside * v[1], along * u[2] + aside * v[2]


def _unit(vector: Vector) -> Vector:
    length = math.hypot(*vector) or 1.0
    return vector[0] / length, vector[1] / length, vector[2] / length


def _distance(point: Vector, axis: Vector) -> float:
    """Return the distance of a point from an axis through the origin."""
    along = sum(one * other for one, other in zip(point, axis, strict=True))
    return math.hypot(*(one - along * other for one, other in zip(point, axis, strict=True)))


def unmeasured(urdf: Urdf, base: str) -> Sequence[str]:
    """Return the links of the footprint whose shapes are only meshes: the real footprint may be larger by them."""
    if base not in urdf.links:
        return ()
    parts = [urdf.links[name] for name in parts_of(urdf, urdf.fixed_to(base))]
    return [
        link.name
        for link in parts
        if (shapes := link.collisions or link.visuals) and all(shape.kind == "mesh" for shape in shapes)
    ]


def reach(points: Sequence[Point]) -> Reach | None:
    """Return the extent of a footprint; None for an empty footprint."""
    if not points:
        return None
    x, y = [point[0] for point in points], [point[1] for point in points]
    return Reach(max(x), -min(x), max(y), -min(y), max(math.hypot(*point) for point in points))


def parts_of(urdf: Urdf, body: str) -> Sequence[str]:
    """Return the links of the footprint: links fixed to the body, its legs, and its wheels with their holders."""
    moved = {joint.child for joint in legs_of(urdf)}
    for wheel in (*wheels_of(urdf), *rotors_of(urdf)):  # a steered engine belongs to the footprint as a wheel does
        holders = [joint.child for joint in above_of(urdf, wheel.child)]
        moved |= set(holders) if urdf.mount(wheel.child, body) else set[str]()
    moved |= {
        joint.child for joint in urdf.moving if joint.kind == "continuous" and urdf.fixed_to(joint.parent) == body
    }
    moved |= {  # a steered wheel without a rolling joint in the description
        joint.child
        for joint in urdf.moving
        if "wheel" in f"{joint.name} {joint.child}".lower() and urdf.fixed_to(joint.parent) == body
    }
    return [name for name in urdf.links if (top := urdf.fixed_to(name)) == body or top in moved]


def _in_base(at: Vector, base: Mount) -> Vector:
    """Transform a point from the frame of the body to that of the base, which is fixed to the body."""
    dx, dy, dz = (one - other for one, other in zip(at, base.xyz, strict=True))
    axes = [Mount(rpy=base.rpy).of(Mount(axis)).xyz for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    x, y, z = (dx * axis[0] + dy * axis[1] + dz * axis[2] for axis in axes)
    return x, y, z


def corners(shape: Geometry, link: Mount) -> Iterator[tuple[float, float, float]]:
    """Yield the corners of a shape in the body's frame; a round shape is approximated by many."""
    size = [abs(one) for one in shape.size]
    if shape.kind == "mesh" or not all(0 < one <= _LARGEST_M for one in size):
        return
    mount = link.of(shape.mount)
    if shape.kind == "sphere":  # a sphere has no orientation
        mount = Mount(mount.xyz)
    for at in _own_corners(shape.kind, size):
        yield mount.of(Mount(at)).xyz


def _own_corners(kind: str, size: Sequence[float]) -> Iterator[tuple[float, float, float]]:
    if kind == "box":
        for number in range(8):
            x, y, z = (size[axis] / 2 * (1 if number >> axis & 1 else -1) for axis in range(3))
            yield x, y, z
        return
    turns = [2 * math.pi * number / _CORNERS for number in range(_CORNERS)]
    if kind == "sphere":
        yield from ((size[0] * math.cos(turn), size[0] * math.sin(turn), 0.0) for turn in turns)
        return
    radius, half = size[0], size[1] / 2 + (size[0] if kind == "capsule" else 0.0)
    for turn in turns:
        for z in (-half, half):
            yield radius * math.cos(turn), radius * math.sin(turn), z


def hull(points: Sequence[Point]) -> Sequence[Point]:
    """Return the convex hull by Andrew's monotone chain: the lower side from left to right, then the upper one back."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ()

    def side(along: Sequence[Point]) -> list[Point]:
        kept: list[Point] = []
        for point in along:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 0:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return [*side(ordered), *side(ordered[::-1])]


def _turn(one: Point, two: Point, three: Point) -> float:
    """Return a number above 0 if the path over the three points turns left, below 0 if it turns right."""
    return (two[0] - one[0]) * (three[1] - one[1]) - (two[1] - one[1]) * (three[0] - one[0])
