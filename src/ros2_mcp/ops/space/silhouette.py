"""The robot's body as its description has it, for pictures from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from ros2_mcp.world.footprint import Point, outline
from ros2_mcp.world.limbs import Limb, limbs_of
from ros2_mcp.world.transforms import BASES
from ros2_mcp.world.urdf import parse


@dataclass(frozen=True, slots=True)
class Silhouette:
    """The outline about the base, in m, and what joints move on it."""

    outline: Sequence[Point]
    limbs: Sequence[Limb]


@lru_cache(maxsize=2)  # the page asks several times a second
def silhouette_of(description: str, base: str) -> Silhouette:
    """What is drawn of a description about its base; `base` may be empty, where no transform tells it.

    Raises:
        BadData: if it is no URDF.
    """
    urdf = parse(description)
    base = base or next((one for one in BASES if one in urdf.links), "")
    return Silhouette(outline(urdf, base), limbs_of(urdf, base))
