"""Run the measurements and print the table: `python -m bench [--json FILE] [--only WORD] [--full]`."""

from __future__ import annotations

import argparse
import asyncio
import os
import platform
import sys
from collections.abc import Awaitable, Callable
from datetime import datetime, timezone
from pathlib import Path

from . import bags, graphs, limits, measure, reaction, sights, small, stopping
from .report import Row, save, table

MEASUREMENTS: dict[str, Callable[[bool], Awaitable[list[Row]]]] = {
    "start": lambda full: measure.start_to_tools_list(20 if full else 8),
    "list": lambda full: measure.topic_list(2000 if full else 500),
    "large": lambda full: graphs.large(500 if full else 100),
    "first": lambda full: measure.first_listing(20 if full else 5),
    "read": lambda full: measure.read_one(300 if full else 100),
    "subscribed": lambda full: measure.while_subscribed(4 if full else 1),
    "flood": lambda _: measure.flooded(10_000, 10),
    "publish": lambda full: measure.acknowledged_publish(300 if full else 100),
    "idle": lambda full: measure.idle(60 if full else 10),
    "service": lambda full: measure.service_calls(1000 if full else 300),
    "frames": lambda full: measure.look_up(1000 if full else 300),
    "sandbox": lambda full: measure.sandbox(50 if full else 10),
    "recording": lambda full: sights.recording(20, 2 if full else 1),
    "picture": lambda full: sights.picture_read(50 if full else 20),
    "bags": bags.large,
    "limits": limits.cost,
    "stop": stopping.stop_to_zero,
    "programs": reaction.of_programs,
    "small": small.rows,
    "many": lambda full: measure.many_calls(10_000 if full else 500),
}


async def run(names: list[str], full: bool) -> list[Row]:
    rows: list[Row] = []
    for name in names:
        print(f"{name} …", file=sys.stderr, flush=True)
        found = await MEASUREMENTS[name](full)
        print(table(found), file=sys.stderr, flush=True)
        rows += found
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers there")
    parser.add_argument("--only", nargs="+", choices=MEASUREMENTS, default=list(MEASUREMENTS), help="only these")
    parser.add_argument("--full", action="store_true", help="more rounds: about ten minutes instead of two")
    arguments = parser.parse_args()
    rows = asyncio.run(run(arguments.only, arguments.full))
    load = f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}, Python {platform.python_version()}"
    print(f"\n{table(rows)}\n\n{load}")
    if arguments.json:
        when = datetime.now(timezone.utc).isoformat(timespec="seconds")
        save(rows, arguments.json, {"when": when, "machine": load, "full": arguments.full})
    sys.exit(any(row.verdict == "MISSED" for row in rows))


if __name__ == "__main__":
    main()
