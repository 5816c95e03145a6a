"""Where the robot is, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ros2_mcp.model.text import named
from ros2_mcp.ops.space.frames import WORLDS
from ros2_mcp.world.urdf import Mount, Urdf

OLD_S = 2.0
"""A place that is older is not that of now."""


def pose_in_words(frame: str, at: Sequence[float], yaw_rad: float, how: str, age_s: float | None) -> str:
    """A sentence with the place in m, the heading in degrees, and how and when that became known."""
    yaw_deg = round(math.degrees(yaw_rad))  # an int has no -0
    x, y, z = (round(part, 2) + 0.0 for part in at)  # nor has a zero, so
    height = f" z {z:.2f}" if abs(z) >= 0.05 else ""
    age = "" if age_s is None else f", {age_s:.1f} s old" if age_s < OLD_S else f" {age_s:.0f} s ago"
    return f"In {named(frame)} at x {x:.2f} y {y:.2f}{height} m, yaw {yaw_deg}° ({how}{age})."


def fixed_in_world(urdf: Urdf, base: str) -> Mount | None:
    """Where the base is fixed in the link that stands for the world; None where the description tells none."""
    is_fixed = urdf.root.lower() in WORLDS and base != urdf.root and urdf.fixed_to(base) == urdf.root
    return urdf.mount(base) if is_fixed else None
