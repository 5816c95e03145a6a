"""opencode, as far as it takes a configuration."""

from __future__ import annotations

from pathlib import Path

from support.clients.client import Workplace
from support.clients.installed import installed

VERSION = "1.18.33"


class OpenCode:
    """A `Configured`."""

    name = "opencode"

    def __init__(self) -> None:
        # The one for older processors runs on all.
        self.program = installed("opencode-ai", VERSION, "opencode-*-baseline/bin/opencode")

    def environment(self, _: Path) -> dict[str, str]:
        off = ("AUTOUPDATE", "MODELS_FETCH", "LSP_DOWNLOAD", "DEFAULT_PLUGINS")
        return {f"OPENCODE_DISABLE_{name}": "1" for name in off}

    def configure(self, place: Workplace, printed: str, _: str) -> None:
        folder = place.home / ".config" / "opencode"
        folder.mkdir(parents=True)
        (folder / "opencode.json").write_text(printed)

    def servers(self, place: Workplace) -> str:
        return place.run(self.program, "mcp", "list")
