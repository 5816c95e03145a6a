"""The table of what the model reads of each call, in each client."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import pytest

from support.clients.calls import REFUSED


@dataclass(frozen=True)
class Column:
    """What one client showed: bytes of our text and of what was read, and pictures, by the name of the call."""

    tools_after_s: float
    """From the start of the server's process to its list of tools."""

    sent: Mapping[str, int]
    read: Mapping[str, int]
    pictures: Mapping[str, int]


COLUMNS = pytest.StashKey[dict[str, Column]]()
"""By the name of the client, in the stash of the configuration."""


def table(columns: Mapping[str, Column]) -> Iterator[str]:
    """As Markdown. The text of a call differs a little between two runs: the robot moves."""
    yield "| bytes of | " + " | ".join(f"our text | in {name}" for name in columns) + " |"
    yield "| --- |" + " ---: | ---: |" * len(columns)
    names = next(iter(columns.values())).sent
    for name in names:
        cells = [(column.sent[name], _read(column, name)) for column in columns.values()]
        yield f"| {name} | " + " | ".join(f"{sent} | {read}" for sent, read in cells) + " |"
    good = [name for name in names if name not in REFUSED]
    sums = [sum(sizes[name] for name in good) for column in columns.values() for sizes in (column.sent, column.read)]
    yield f"| **sum of {len(good)}** | " + " | ".join(f"**{size}**" for size in sums) + " |"
    times = [f"{column.tools_after_s:.1f} s" for column in columns.values()]
    yield "| list of tools after | " + " | ".join(f"{time} |" for time in times) + " |"


def _read(column: Column, name: str) -> str:
    pictures = column.pictures[name]
    return f"{column.read[name]}" + (f" + {pictures} picture" if pictures else "")
