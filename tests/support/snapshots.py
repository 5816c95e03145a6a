"""Whole texts that tests compare: one file for each room, which one command rewrites.

`ROS2_MCP_REWRITE=1 pytest tests/unit/test_texts.py` writes them anew; look at the difference, and commit it. Other
tests compare codes, numbers and names, so that a better sentence costs nothing but this.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "unit" / "snapshots"
_COMMAND = "ROS2_MCP_REWRITE=1 pytest tests/unit/test_texts.py"
_REWRITES = bool(os.environ.get("ROS2_MCP_REWRITE"))


def assert_as_snapshot(room: str, texts: Mapping[str, str]) -> None:
    """That the texts, each under its name, are those in the file of the room."""
    path = FOLDER / f"{room}.txt"
    whole = "\n".join(f"=== {name}\n{text}\n" for name, text in texts.items())
    if _REWRITES:
        FOLDER.mkdir(exist_ok=True)
        path.write_text(whole, encoding="utf-8")
    assert path.read_text(encoding="utf-8") == whole, f"if this is meant: {_COMMAND}"
