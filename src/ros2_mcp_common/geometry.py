"""The yaw of a quaternion of any length: the only such function of this package, for server and bridge.

Needs no ROS.
"""

from __future__ import annotations

import math


def yaw_rad(x: float, y: float, z: float, w: float) -> float:
    """Return the heading of a quaternion in rad, -π to π: the angle of its x axis, seen from above, from x towards y.

    The length does not matter, because rounding or a filter may leave a driver's quaternions shorter or longer than 1.
    Return 0 if all four numbers are zero, as in a message that was not filled in, and NaN if one is not finite.
    """
    size = max(abs(x), abs(y), abs(z), abs(w))
    if not all(map(math.isfinite, (x, y, z, w))):
        return math.nan
    if not size:
        return 0.0
    x, y, z, w = x / size, y / size, z / size, w / size  # so that no square overflows, or vanishes
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
