"""The declaration of a check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from ros2_mcp.ops.measure.evidence import Evidence, Need
from ros2_mcp.ops.measure.findings import Finding

FIRST, USUAL, LAST = 0, 10, 20
"""Values of `place`: the absence of the robot or of a node is reported before its consequences."""


@dataclass(frozen=True, slots=True)
class Check:
    """A kind of fault: the evidence needed, and the function that finds it.

    Among findings of the same severity, those of checks with a smaller `place` come first.
    """

    needs: Sequence[Need]
    find: Callable[[Evidence], Iterable[Finding]]
    place: int = USUAL
