"""Measured values with their floors and targets, as a table and as JSON."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Row:
    """One value. With a `floor`, `target` is the highest allowed ratio to it; without one, the highest allowed
    value."""

    what: str
    value: float
    unit: str
    target: float | None = None
    floor: float | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        return None if self.floor is None else self.value / self.floor

    @property
    def verdict(self) -> str:
        if self.target is None:
            return ""
        measured = self.value if self.ratio is None else self.ratio
        return "ok" if measured <= self.target else "MISSED"

    def cells(self) -> list[str]:
        sign = "" if self.floor is None else " ×"
        return [
            self.what,
            f"{self.value:.4g} {self.unit}",
            "" if self.floor is None else f"{self.floor:.4g} {self.unit}",
            "" if self.ratio is None else f"{self.ratio:.2f} ×",
            "" if self.target is None else f"≤ {self.target:g}{sign or f' {self.unit}'}",
            self.verdict,
            self.note,
        ]


def table(rows: Sequence[Row]) -> str:
    lines = [["what", "ours", "floor", "ratio", "target", "verdict", ""], *(row.cells() for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(7)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def save(rows: Sequence[Row], path: Path, circumstances: dict[str, Any]) -> None:
    entries = [{**asdict(row), "ratio": row.ratio, "verdict": row.verdict} for row in rows]
    path.write_text(json.dumps({**circumstances, "rows": entries}, indent=1, ensure_ascii=False) + "\n")


def p50(seconds: Sequence[float]) -> float:
    """Return the median in milliseconds, of times in s."""
    return statistics.median(seconds) * 1000


def p99(seconds: Sequence[float]) -> float:
    """Return the 99th percentile in milliseconds, of times in s."""
    return sorted(seconds)[min(len(seconds) - 1, int(len(seconds) * 0.99))] * 1000
