"""Gemini CLI, as far as it takes a configuration."""

from __future__ import annotations

import json
from pathlib import Path

from support.clients.client import Workplace
from support.clients.installed import installed

VERSION = "0.61.0"


class Gemini:
    """A `Configured`."""

    name = "gemini"

    def __init__(self) -> None:
        self.program = installed("@google/gemini-cli", VERSION, ".bin/gemini")

    def environment(self, _: Path) -> dict[str, str]:
        return {"GEMINI_API_KEY": "none", "GEMINI_CLI_TRUST_WORKSPACE": "true"}

    def configure(self, place: Workplace, printed: str, _: str) -> None:
        folder = place.home / ".gemini"
        folder.mkdir()
        quiet = {"privacy": {"usageStatisticsEnabled": False}, "general": {"enableAutoUpdate": False}}
        (folder / "settings.json").write_text(json.dumps({**json.loads(printed), **quiet}))

    def servers(self, place: Workplace) -> str:
        return place.run(self.program, "mcp", "list")
