"""The robot's body from its description (URDF), for pictures from above."""

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
    """The footprint about the base, in m, and the links that joints move."""

    outline: Sequence[Point]
    limbs: Sequence[Limb]


@lru_cache(maxsize=2)  # the view asks several times a second
def silhouette_of(description: str, base: str) -> Silhouette:
    """Return the silhouette of a URDF about its base; an empty `base` means the first usual base link of the
    description.

    Raises:
        BadData: if the text is no valid URDF.
    """
    urdf = parse(description)
    base = base or next((one for one in BASES if one in urdf.links), "")
    return Silhouette(outline(urdf, base), limbs_of(urdf, base))
