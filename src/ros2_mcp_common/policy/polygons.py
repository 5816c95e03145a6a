"""Polygons in the plane, in metres: lists of their corners, in either direction. Needs no ROS."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

Point = tuple[float, float]
Polygon = tuple[Point, ...]

# The most corners of a polygon, so that judging a path does not hold up the bridge.
MOST_CORNERS = 100
# Farther away is no place of a robot, and squares of the coordinates would lose the millimetres.
FARTHEST_M = 1e6


def what_is_wrong(polygon: Sequence[Point]) -> str:
    """Return why these corners are no polygon that encloses an area once; "" if they are."""
    if len(polygon) < 3:
        return "a polygon needs three points or more"
    if len(polygon) > MOST_CORNERS:
        return f"a polygon may have {MOST_CORNERS} points, this one has {len(polygon)}"
    if not all(math.isfinite(part) and abs(part) < FARTHEST_M for point in polygon for part in point):
        return "a point is not finite, or farther than 1,000 km away"
    sides = list(edges(polygon))
    if twice := next((one for one, other in sides if one == other), None):
        return f"the point {_shown(twice)} comes twice in succession"
    for place, side in enumerate(sides):
        for far in range(place + 1, len(sides)):
            is_next = far == place + 1 or (place == 0 and far == len(sides) - 1)
            if _folds_back(side, sides[far]) if is_next else _cross(side, sides[far]):
                return f"the edges {_edge(side)} and {_edge(sides[far])} {'overlap' if is_next else 'cross'}"
    if abs(_area(polygon)) < 1e-6:
        return "it encloses no area"
    return ""


def is_inside(x: float, y: float, polygon: Sequence[Point]) -> bool:
    """Return whether a point lies inside a polygon; on its edge, either."""
    inside = False
    x1, y1 = polygon[-1]
    for x2, y2 in polygon:
        if (y1 > y) != (y2 > y) and x < (x2 - x1) * (y - y1) / (y2 - y1) + x1:
            inside = not inside
        x1, y1 = x2, y2
    return inside


def distance(x: float, y: float, polygon: Sequence[Point]) -> float:
    """Return the distance of a point from the nearest edge of a polygon, in m."""
    nearest = math.inf  # squared; one loop without calls, because the watchdog asks this often
    x1, y1 = polygon[-1]
    for x2, y2 in polygon:
        dx, dy = x2 - x1, y2 - y1
        length = dx * dx + dy * dy
        part = ((x - x1) * dx + (y - y1) * dy) / length if length else 0.0
        part = 0.0 if part < 0.0 else 1.0 if part > 1.0 else part
        to_x, to_y = x - x1 - part * dx, y - y1 - part * dy
        away = to_x * to_x + to_y * to_y
        nearest = min(nearest, away)
        x1, y1 = x2, y2
    return math.sqrt(nearest)


def between(one: Polygon, other: Polygon) -> float:
    """Return the distance between two polygons, in m; 0 if they overlap."""
    if is_inside(*one[0], other) or is_inside(*other[0], one):
        return 0.0
    nearest = min([distance(x, y, other) for x, y in one])
    # Where an edge crosses another polygon, one of its ends is within half its length of that polygon.
    half = max([math.dist(start, end) for start, end in edges(one)]) / 2
    if nearest <= half and any(_cross(edge, beside) for edge in edges(one) for beside in edges(other)):
        return 0.0
    return min(nearest, *[distance(x, y, one) for x, y in other])


def moved(polygon: Polygon, x: float, y: float, yaw: float) -> Polygon:
    """Return a polygon of a body in the frame in which the body is at (x, y), turned by `yaw` (rad)."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return tuple((x + cos * to_x - sin * to_y, y + sin * to_x + cos * to_y) for to_x, to_y in polygon)


def edges(polygon: Sequence[Point]) -> Iterator[tuple[Point, Point]]:
    """Yield the edges of a polygon, each as its two ends."""
    return ((polygon[place - 1], polygon[place]) for place in range(len(polygon)))


def _cross(edge: tuple[Point, Point], other: tuple[Point, Point]) -> bool:
    """Return whether two line segments meet, be it only in a point."""
    (a, b), (c, d) = edge, other
    if max(a[0], b[0]) < min(c[0], d[0]) or max(c[0], d[0]) < min(a[0], b[0]):
        return False
    if max(a[1], b[1]) < min(c[1], d[1]) or max(c[1], d[1]) < min(a[1], b[1]):
        return False
    sides = [_side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b)]
    if sides[0] * sides[1] < 0 and sides[2] * sides[3] < 0:
        return True
    ends = ((sides[0], c, a, b), (sides[1], d, a, b), (sides[2], a, c, d), (sides[3], b, c, d))
    return any(not side and _is_between(point, one, two) for side, point, one, two in ends)


def _side(one: Point, other: Point, point: Point) -> float:
    """Return a number above 0 if the point lies left of the line from `one` to `other`, below 0 if right."""
    return (other[0] - one[0]) * (point[1] - one[1]) - (other[1] - one[1]) * (point[0] - one[0])


def _is_between(point: Point, one: Point, other: Point) -> bool:
    """Return whether a point of the line through both lies between them."""
    return all(min(low, high) <= part <= max(low, high) for part, low, high in zip(point, one, other, strict=True))


def _folds_back(edge: tuple[Point, Point], after: tuple[Point, Point]) -> bool:
    """Return whether an edge runs back over its neighbour, with which it shares a corner."""
    shared = next(point for point in edge if point in after)
    ends = [next((point for point in each if point != shared), shared) for each in (edge, after)]
    if _side(shared, *ends):
        return False
    (dx, dy), (ex, ey) = ((end[0] - shared[0], end[1] - shared[1]) for end in ends)
    return dx * ex + dy * ey > 0


def _area(polygon: Sequence[Point]) -> float:
    return sum(x1 * y2 - x2 * y1 for (x1, y1), (x2, y2) in edges(polygon)) / 2


def _shown(point: Point) -> str:
    return f"[{point[0]:g}, {point[1]:g}]"


def _edge(edge: tuple[Point, Point]) -> str:
    return f"{_shown(edge[0])}–{_shown(edge[1])}"
