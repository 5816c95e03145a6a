"""The one yaw of this package, in server and bridge: of a quaternion of any length. Needs no ROS."""

from __future__ import annotations

import math


def yaw_rad(x: float, y: float, z: float, w: float) -> float:
    """The heading of a quaternion, seen from above: the angle of its x axis, from x towards y, -π to π.

    Its length does not matter: drivers send quaternions that rounding, or a filter, has left shorter or longer than 1.
    0 where all four are zeros, as in a message that nobody has filled in; NaN where one is not finite.
    """
    size = max(abs(x), abs(y), abs(z), abs(w))
    if not all(map(math.isfinite, (x, y, z, w))):
        return math.nan
    if not size:
        return 0.0
    x, y, z, w = x / size, y / size, z / size, w / size  # so that no square overflows, or vanishes
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
