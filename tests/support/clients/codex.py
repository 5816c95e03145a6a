"""Codex."""

from __future__ import annotations

from pathlib import Path

from support.clients.client import Workplace
from support.clients.installed import installed
from support.clients.script import Call

VERSION = "0.171.0"
SETTINGS = """\
model = "gpt-5"
model_provider = "scripted"
check_for_update_on_startup = false
approval_policy = "never"
sandbox_mode = "workspace-write"

[analytics]
enabled = false

[otel]
exporter = "none"

[model_providers.scripted]
name = "scripted"
base_url = "{model}/v1"
wire_api = "responses"
env_key = "SCRIPTED_KEY"

"""
"""Sandbox and approvals are those of `codex exec` as people use it."""


class Codex:
    """A `Client`."""

    name = "codex"
    allow_all = ("--sandbox", "danger-full-access")

    def __init__(self) -> None:
        self.program = installed("@openai/codex", VERSION, "@openai/codex-*/vendor/*/bin/codex")

    def environment(self, home: Path) -> dict[str, str]:
        return {"CODEX_HOME": str(home / ".codex"), "SCRIPTED_KEY": "none"}

    def configure(self, place: Workplace, printed: str, model: str) -> None:
        folder = place.home / ".codex"
        folder.mkdir()
        (folder / "config.toml").write_text(SETTINGS.format(model=model) + printed)

    def servers(self, place: Workplace) -> str:
        return place.run(self.program, "mcp", "get", "ros2", "--json")

    def command(self, place: Workplace, prompt: str) -> list[str]:
        return [str(self.program), "exec", "--json", "--skip-git-repo-check", "--cd", str(place.project), prompt]

    def waiting(self, _: list[str]) -> Call:
        """It begins without waiting for servers, and offers their tools once they are there."""
        return Call("exec_command", {"cmd": "true"}, own=True)
