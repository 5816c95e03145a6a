"""Mistakes in users' prompts and programs, by file and line, or by the name of what failed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

from ros2_mcp.model.text import visible


@dataclass(frozen=True, slots=True)
class Mistake:
    """One mistake. `line` counts from 1; 0 means the whole of `where`."""

    where: str
    line: int
    text: str

    def __str__(self) -> str:
        place = f"{self.where}:{self.line}" if self.line else self.where
        return f"{place}: {self.text}"


Tell = Callable[[Mistake], None]


def tell_on_stderr(mistake: Mistake) -> None:
    """Write one line to the server's log on stderr."""
    sys.stderr.write(f"ros2-mcp: {visible(str(mistake))}\n")
    sys.stderr.flush()
