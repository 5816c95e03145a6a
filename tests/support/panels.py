"""What the panels of a page share, for a panel alone."""

from __future__ import annotations

from pathlib import Path

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.look import Chunks, PageContext


def page_of(source: Source, acting: Acting | None = None) -> PageContext:
    """A page that shows this source, where nobody acts unless `acting` says so."""
    return PageContext("a robot", source, acting or Acting(StateFolder(Path("no-state-folder"))), Chunks())
