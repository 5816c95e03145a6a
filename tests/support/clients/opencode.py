"""opencode."""

from __future__ import annotations

import json
from pathlib import Path

from support.clients.client import Workplace
from support.clients.installed import installed
from support.clients.script import Call

VERSION = "1.18.33"


class OpenCode:
    """A `Client`. It speaks with its model as the model's maker wants it: here as with Anthropic's."""

    name = "opencode"
    allow_all = ()

    def __init__(self) -> None:
        # The one for older processors runs on all.
        self.program = installed("opencode-ai", VERSION, "opencode-*-baseline/bin/opencode")

    def environment(self, _: Path) -> dict[str, str]:
        off = ("AUTOUPDATE", "MODELS_FETCH", "LSP_DOWNLOAD", "DEFAULT_PLUGINS")
        return {f"OPENCODE_DISABLE_{name}": "1" for name in off}

    def configure(self, place: Workplace, printed: str, model: str) -> None:
        folder = place.home / ".config" / "opencode"
        folder.mkdir(parents=True)
        (folder / "opencode.json").write_text(printed)
        scripted = {
            "npm": "@ai-sdk/anthropic",
            "name": "scripted",
            "options": {"baseURL": f"{model}/v1", "apiKey": "none"},
            "models": {
                "scripted": {
                    "name": "scripted",
                    "tool_call": True,
                    "attachment": True,
                    "modalities": {"input": ["text", "image"], "output": ["text"]},
                    "limit": {"context": 200_000, "output": 8_000},
                }
            },
        }
        own = {
            "autoupdate": False,
            "share": "disabled",
            "model": "scripted/scripted",
            "small_model": "scripted/scripted",
            "provider": {"scripted": scripted},
        }
        (place.project / "opencode.json").write_text(json.dumps(own))

    def servers(self, place: Workplace) -> str:
        return place.run(self.program, "mcp", "list")

    def command(self, place: Workplace, prompt: str) -> list[str]:
        return [str(self.program), "run", "--format", "json", "--dir", str(place.project), prompt]

    def waiting(self, _: list[str]) -> Call:
        """It waits for servers before it begins."""
        return Call("bash", {"command": "true", "description": "nothing"}, own=True)
