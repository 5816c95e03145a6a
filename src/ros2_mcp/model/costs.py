"""The costs of a costmap, as Nav2 publishes it in nav_msgs/msg/OccupancyGrid.

Cost 0 is free; 1 to 98 increase towards obstacles; 99 is inscribed (a robot with its centre there touches an obstacle);
100 is occupied; -1 is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

UNKNOWN, TOUCHING, OCCUPIED = -1, 99, 100


@dataclass(frozen=True, slots=True)
class Reach:
    """Whether a goal is reachable, and the reachable point nearest to it, at the distance `short_m`."""

    is_reached: bool
    x_m: float
    y_m: float
    short_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Narrowest:
    """The narrowest spot of a path.

    `clearance_m` is the least distance of the path (the robot's centre) from an occupied cell, at the point
    `clearance_at`; `gap_m` is the width of the narrowest gap on it, with the centre `gap_at` (None: no gap below 3 m).
    """

    clearance_m: float
    clearance_at: tuple[float, float]
    gap_m: float | None
    gap_at: tuple[float, float] | None

    def __str__(self) -> str:
        x, y = self.clearance_at
        near = f"{self.clearance_m:.2f} m from its centre line to the nearest occupied cell, at ({x:.2f}, {y:.2f})"
        if self.gap_m is None or self.gap_at is None:
            return f"nearest: {near}"
        return (
            f"narrowest: a gap of {self.gap_m:.2f} m at ({self.gap_at[0]:.2f}, {self.gap_at[1]:.2f}); nearest: {near}"
        )


def cost_in_words(cost: int | None) -> str:
    """Describe a cost, such as `free` or `occupied (cost 100)`; None is outside of the costmap."""
    if cost is None:
        return "outside the costmap"
    if cost < 0:
        return "unknown"
    if cost == 0:
        return "free"
    if cost >= OCCUPIED:
        return f"occupied (cost {cost})"
    return f"so near to an obstacle that the robot touches it (cost {cost})" if cost == TOUCHING else f"free ({cost})"
