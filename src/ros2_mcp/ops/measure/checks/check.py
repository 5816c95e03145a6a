"""What a check is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from ros2_mcp.ops.measure.evidence import Evidence, Need
from ros2_mcp.ops.measure.findings import Finding

FIRST, USUAL, LAST = 0, 10, 20
"""Places: that no robot is there, or that a node is gone, is named before what follows from it."""


@dataclass(frozen=True, slots=True)
class Check:
    """One kind of fault: what has to be read to see it, and the function that sees it.

    Of findings with the same severity those of the check with the smaller `place` are named first.
    """

    needs: Sequence[Need]
    find: Callable[[Evidence], Iterable[Finding]]
    place: int = USUAL
