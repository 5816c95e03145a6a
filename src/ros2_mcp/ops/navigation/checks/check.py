"""What a check of navigation is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding, Need

CLOCKS, SENSORS, LOCALISER, FRAMES, SERVERS, CHAIN, MAP, GOAL, TUNING = range(9)
"""Places in the chain of causes: what comes first is named first, and what follows from it after it, or not at all."""


@dataclass(frozen=True, slots=True)
class NavCheck:
    """One kind of cause: what has to be read to see it, and the function that sees it."""

    needs: Sequence[Need]
    find: Callable[[NavEvidence], Iterable[NavFinding]]
    place: int
