"""The speed limit of a motion from its sensors: the robot keeps its distance to obstacles, and stops for what
approaches.

Needs no ROS. Points are in the base's frame (x ahead, y to the left, z up, m; REP 103). A direction without a valid
range counts as not free (REP 117). A scan is used whole; of a cloud, only points between the ground and the top of the
robot (`points.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from ros2_mcp_bridge.motion.points import places
from ros2_mcp_common.language.scans import limits_of, no_bearings

# Delay from a scan to a command at the driver: the scanner's turn, the network, our polling. An estimate with room.
REACTION_S = 0.15
# Deceleration that every robot reaches, m/s² and rad/s²: half of that of small robots.
BRAKE_MPS2, BRAKE_RADPS2 = 0.5, 1.0
# Assumed maximum speed of moving obstacles, m/s; a faster one may hit the robot.
OTHERS_MPS = 0.3
# Minimum distance between body and obstacle, m: the noise of scans.
MARGIN_M = 0.03
# Below these speeds (m/s, rad/s) the robot counts as stopped by the guard.
LEAST_MPS, LEAST_RADPS = 0.02, 0.05
# Number of sectors of the circle (10° each); those around the course must be covered by a sensor.
SECTORS = 36
# Number of sectors to each side of the course that must be covered.
SEEN_SECTORS = 2
# For a cloud, the nearest point in each direction of this width is kept: the resolution of a common scanner.
DIRECTION_RAD = math.radians(1.0)
# Bisection steps to find the speed: to 1/64 of the fastest.
HALVINGS = 6


class Body(NamedTuple):
    """The extent of a robot around the origin of its base, in m: ahead, back, to each side, and as a radius."""

    front: float
    rear: float
    side: float
    radius: float

    def has_inside(self, x: float, y: float) -> bool:
        """Return whether a point lies on the robot itself."""
        return -self.rear <= x <= self.front and abs(y) <= self.side and math.hypot(x, y) <= self.radius


class Mount(NamedTuple):
    """The pose of a sensor in the base's frame, as an offset (m) and a rotation matrix: a point (a, b, c) of the sensor
    is at x = x0 + xx·a + xy·b + xz·c; y and z likewise. For a scan, c is 0.
    """

    x0: float
    y0: float
    z0: float
    xx: float
    xy: float
    xz: float
    yx: float
    yy: float
    yz: float
    zx: float
    zy: float
    zz: float

    @classmethod
    def of(cls, at: Sequence[float], rotation: Sequence[float]) -> Mount:
        """Return the pose for a translation (x, y, z) and a quaternion (x, y, z, w), which may also be upside down."""
        x, y, z, w = rotation
        x0, y0, z0 = (float(each) for each in at)
        xx, xy, xz = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        yx, yy, yz = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        zx, zy, zz = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
        return cls(x0, y0, z0, xx, xy, xz, yx, yy, yz, zx, zy, zz)


class Near(NamedTuple):
    """A point beside or ahead of a moving body: the distance to drive until the body is level with it, the point's
    distance from the side of the body (both m), and its bearing from the base (rad).
    """

    ahead: float
    aside: float
    bearing: float


class Allowed(NamedTuple):
    """The speed limit (m/s, or rad/s for a turn in place), and the `gap` to the nearest point (m) with its bearing
    (rad).
    """

    speed: float
    gap: float
    bearing: float


NOTHING_NEAR = math.inf


class Clearance:
    """The newest message of one sensor, and the speed limit that follows from it. `guard_m` is kept free ahead of the
    body; of a cloud, points between `heights` (m above the base's origin) are obstacles.
    """

    def __init__(
        self, guard_m: float, body: Body, mount: Mount, heights: tuple[float, float] = (-math.inf, math.inf)
    ) -> None:
        self.guard_m = guard_m
        self.body = body
        self.mount = mount
        self.heights = heights
        self.heard_at = -math.inf
        self.heard_along = 0.0
        self._points: list[tuple[float, float]] = []
        self._seen: set[int] = set()
        self._table: tuple[tuple[float, float, int], list[tuple[float, float]]] = ((0.0, 0.0, 0), [])
        self._near: dict[tuple[float, int], list[Near]] = {}

    @classmethod
    def of(cls, asked: Mapping[str, Any], sensor: Mapping[str, Any]) -> Clearance:
        """Return the object for the server's JSON: `guard_m` and `body`, and for the sensor its `mount` (`translation`
        and `rotation`) and its `heights`.
        """
        body, mount = asked["body"], sensor["mount"]
        low_m, high_m = sensor.get("heights") or (-math.inf, math.inf)
        return cls(
            float(asked["guard_m"]),
            Body(*(float(body[name]) for name in Body._fields)),
            Mount.of(mount["translation"], mount["rotation"]),
            (float(low_m), float(high_m)),
        )

    def hear(self, message: Any, now: float, along: float = 0.0) -> None:
        """Take in a sensor_msgs/msg/LaserScan or PointCloud2, received when the robot was `along` m into its course.

        Raises:
            ValueError: if it has no usable points, with the reason: the message must not count as received.
        """
        points, seen = self._of_scan(message) if hasattr(message, "ranges") else self._of_cloud(message)
        self._points, self._seen, self.heard_at, self.heard_along = points, seen, now, along
        self._near.clear()

    def _of_scan(self, scan: Any) -> tuple[list[tuple[float, float]], set[int]]:
        if why := no_bearings(scan):
            raise ValueError(why)
        points: list[tuple[float, float]] = []
        seen: set[int] = set()
        mount, body = self.mount, self.body
        least, most = limits_of(scan)
        for (cosine, sine), distance in zip(self._directions(scan), scan.ranges, strict=True):
            along_x, along_y = mount.xx * cosine + mount.xy * sine, mount.yx * cosine + mount.yy * sine
            is_too_near = distance == -math.inf
            if not (is_too_near or distance >= least > 0.0 or distance > 0.0 == least):
                continue  # NaN, or less than it can tell: nothing is known of that direction
            seen.add(_sector(math.atan2(along_y, along_x)))
            if distance > most or distance == math.inf:
                continue
            reach = least if is_too_near else distance
            x, y = mount.x0 + reach * along_x, mount.y0 + reach * along_y
            if not body.has_inside(x, y):
                points.append((x, y))
        return points, seen

    def _of_cloud(self, cloud: Any) -> tuple[list[tuple[float, float]], set[int]]:
        """Return obstacles and covered sectors as for a scan: the nearest point of each direction is an obstacle;
        points on the ground also show that a sector is covered.
        """
        nearest: dict[int, tuple[float, float, float]] = {}
        seen: set[int] = set()
        mount, body, (low_m, high_m) = self.mount, self.body, self.heights
        for a, b, c in places(cloud):
            x = mount.x0 + mount.xx * a + mount.xy * b + mount.xz * c
            y = mount.y0 + mount.yx * a + mount.yy * b + mount.yz * c
            if body.has_inside(x, y):
                continue
            bearing = math.atan2(y, x)
            seen.add(_sector(bearing))
            if not low_m <= mount.z0 + mount.zx * a + mount.zy * b + mount.zz * c <= high_m:
                continue
            far, direction = x * x + y * y, math.floor(bearing / DIRECTION_RAD)
            if direction not in nearest or far < nearest[direction][0]:
                nearest[direction] = far, x, y
        return [(x, y) for _, x, y in nearest.values()], seen

    def shows(self, sector: int) -> bool:
        """Return whether the sensor covers that sector of the circle (one of `SECTORS`)."""
        return sector in self._seen

    def allowed(self, fastest: float, curvature: float, direction: int, along: float, now: float) -> Allowed:
        """Return the speed limit (m/s) for driving ahead (`direction` 1) or back (-1) on a circle of that curvature
        (1/m, left is positive), `along` m into the course.
        """
        gone_m = abs(along - self.heard_along)
        key = (curvature, direction)
        if key not in self._near:
            self._near[key] = self._along(curvature, direction)
        near = self._near[key]
        late_s = REACTION_S + max(0.0, now - self.heard_at)
        in_way = min((each for each in near if each.aside <= MARGIN_M), default=None)

        def is_safe(speed: float) -> bool:
            stops_s = late_s + speed / BRAKE_MPS2
            stops_m = gone_m + speed * late_s + speed * speed / (2 * BRAKE_MPS2)
            if in_way is not None and in_way.ahead - stops_m < self.guard_m:
                return False
            apart = MARGIN_M + OTHERS_MPS * stops_s
            return all(math.hypot(max(0.0, each.ahead - stops_m), max(0.0, each.aside)) >= apart for each in near)

        speed = _fastest(fastest, is_safe)
        closest = min(near, key=_away, default=None)
        if in_way is not None and speed < LEAST_MPS and in_way.ahead - gone_m > self.guard_m + MARGIN_M:
            in_way = None  # what holds it is beside it
        nearest = in_way or closest
        if nearest is None:
            return Allowed(speed, NOTHING_NEAR, 0.0)
        gap = nearest.ahead - gone_m if in_way else math.hypot(max(0.0, nearest.ahead), max(0.0, nearest.aside))
        return Allowed(speed, gap, nearest.bearing)

    def allowed_turn(self, fastest: float, now: float) -> Allowed:
        """Return the speed limit (rad/s) for a turn in place: no obstacle may come into the circle that the body
        sweeps.
        """
        late_s = REACTION_S + max(0.0, now - self.heard_at)
        gap, bearing = min(
            ((math.hypot(x, y) - self.body.radius, math.atan2(y, x)) for x, y in self._points),
            default=(NOTHING_NEAR, 0.0),
        )

        def is_safe(turn: float) -> bool:
            return gap >= MARGIN_M + OTHERS_MPS * (late_s + turn / BRAKE_RADPS2)

        return Allowed(_fastest(fastest, is_safe), gap, bearing)

    def _directions(self, scan: Any) -> list[tuple[float, float]]:
        """Return cosine and sine of each beam, computed once per scanner."""
        key = (scan.angle_min, scan.angle_increment, len(scan.ranges))
        if self._table[0] != key:
            angles = [scan.angle_min + number * scan.angle_increment for number in range(len(scan.ranges))]
            self._table = key, [(math.cos(angle), math.sin(angle)) for angle in angles]
        return self._table[1]

    def _along(self, curvature: float, direction: int) -> list[Near]:
        """Return the points that a body on this course can reach; points behind it are not included."""
        return [near for x, y in self._points if (near := self._place(x, y, curvature, direction)) is not None]

    def _place(self, x: float, y: float, curvature: float, direction: int) -> Near | None:
        body, bearing = self.body, math.atan2(y, x)
        if abs(curvature) * body.radius < 1e-3:
            front, rear = (body.front, body.rear) if direction > 0 else (body.rear, body.front)
            ahead = direction * x
            return None if ahead < -rear else Near(ahead - front, abs(y) - body.side, bearing)
        # On a circle the body counts as round; the centre is at its left for a positive curvature.
        radius = 1.0 / curvature
        from_centre_x, from_centre_y = x, y - radius
        angle = math.atan2(from_centre_x, -math.copysign(from_centre_y, from_centre_y * radius))
        ahead = direction * angle * abs(radius)
        aside = abs(math.hypot(from_centre_x, from_centre_y) - abs(radius)) - body.radius
        return None if ahead < -body.radius else Near(ahead - body.radius, aside, bearing)


class Guard:
    """All sensors of one drive, by role: the speed limit is the lowest that any of them allows."""

    def __init__(self, clearances: Mapping[str, Clearance]) -> None:
        self._clearances = clearances

    def hear(self, role: str, message: Any, now: float, along: float) -> None:
        """Take in a message, as `Clearance.hear`."""
        self._clearances[role].hear(message, now, along)

    def sees(self, bearing: float) -> bool:
        """Return whether the sensors cover that direction (rad) and the directions around it."""
        middle = _sector(bearing)
        around = [(middle + step) % SECTORS for step in range(-SEEN_SECTORS, SEEN_SECTORS + 1)]
        return all(any(one.shows(sector) for one in self._clearances.values()) for sector in around)

    def allowed(self, fastest: float, curvature: float, direction: int, along: float, now: float) -> Allowed:
        """Return the lowest `Clearance.allowed` of all sensors."""
        return min(one.allowed(fastest, curvature, direction, along, now) for one in self._clearances.values())

    def allowed_turn(self, fastest: float, now: float) -> Allowed:
        """Return the lowest `Clearance.allowed_turn` of all sensors."""
        return min(one.allowed_turn(fastest, now) for one in self._clearances.values())


def _away(near: Near) -> float:
    """Return the distance from the body, in m."""
    return math.hypot(max(0.0, near.ahead), max(0.0, near.aside))


def _fastest(fastest: float, is_safe: Callable[[float], bool]) -> float:
    """Return the highest safe speed up to `fastest`, found by bisection; 0 if none is safe."""
    if is_safe(fastest):
        return fastest
    low, high = 0.0, fastest
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if is_safe(middle) else (low, middle)
    return low


def _sector(bearing: float) -> int:
    return math.floor((bearing / (2 * math.pi) + 0.5) * SECTORS) % SECTORS
