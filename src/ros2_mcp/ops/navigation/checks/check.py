"""The declaration of a check of navigation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding, Need

CLOCKS, SENSORS, LOCALISER, FRAMES, SERVERS, CHAIN, MAP, GOAL, TUNING = range(9)
"""Places in the chain of causes, from the first cause to the last consequence. Findings are sorted by them."""


@dataclass(frozen=True, slots=True)
class NavCheck:
    """One kind of cause: the evidence it needs, the function that finds it, and its place in the chain of causes."""

    needs: Sequence[Need]
    find: Callable[[NavEvidence], Iterable[NavFinding]]
    place: int
