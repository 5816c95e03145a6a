"""A short form for every change: `python -m bench.short` fails when the ratio of a row to its floor has grown by half.

The ratios that it compares with stand in `ratios.json`, from a quiet machine. Both sides of a ratio are measured in
turns, so that a busy machine slows both; what still looks grown is measured again, and the best of three counts: noise
adds to a time and takes nothing from it.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

from . import measure
from .report import Row, table

GROWN = 1.5
_ATTEMPTS = 3
_RATIOS = Path(__file__).with_name("ratios.json")
_MEASUREMENTS: tuple[Callable[[], Awaitable[list[Row]]], ...] = (
    lambda: measure.start_to_tools_list(3),
    lambda: measure.topic_list(100),
    lambda: measure.service_calls(100),
    lambda: measure.read_one(30),
    lambda: measure.acknowledged_publish(30),
)


async def _compared(measurement: Callable[[], Awaitable[list[Row]]], recorded: dict[str, float]) -> list[Row]:
    """The rows that have a recorded ratio, each with the best ratio of its attempts; the target is what may not be."""
    best: dict[str, Row] = {}
    for _ in range(_ATTEMPTS):
        for row in await measurement():
            if row.floor is None or row.what not in recorded:
                continue
            limit = round(recorded[row.what] * GROWN, 2)
            compared = Row(row.what, row.value, row.unit, limit, row.floor, f"recorded: {recorded[row.what]:.2f} ×")
            known = best.get(row.what)
            if known is None or (compared.ratio or 0.0) < (known.ratio or 0.0):
                best[row.what] = compared
        if all(row.verdict == "ok" for row in best.values()):
            break
    return list(best.values())


async def _all() -> list[Row]:
    recorded: dict[str, float] = json.loads(_RATIOS.read_text())
    rows = [row for measurement in _MEASUREMENTS for row in await _compared(measurement, recorded)]
    assert {row.what for row in rows} == recorded.keys(), "each recorded ratio is measured"
    return rows


def main() -> None:
    """Prints the table; exits with 1 when a ratio has grown by half."""
    rows = asyncio.run(_all())
    print(table(rows))
    grown = [row.what for row in rows if row.verdict != "ok"]
    if grown:
        sys.exit(
            f"Slower by half than recorded, against the same floor: {', '.join(grown)}. See docs/explanation/speed.md"
        )


if __name__ == "__main__":
    main()
