"""Claude Code."""

from __future__ import annotations

import shlex
from pathlib import Path

from support.clients.client import Workplace
from support.clients.installed import installed
from support.clients.script import Call

VERSION = "2.1.332"


class ClaudeCode:
    """A `Client`."""

    name = "claude-code"
    allow_all = ("--allowedTools=mcp__ros2",)

    def __init__(self) -> None:
        self.program = installed("@anthropic-ai/claude-code", VERSION, "@anthropic-ai/claude-code-*/claude")

    def environment(self, home: Path) -> dict[str, str]:
        return {
            "CLAUDE_CONFIG_DIR": str(home / ".claude"),
            "ANTHROPIC_API_KEY": "none",
            "CLAUDE_CODE_DISABLE_NONESSENTIAL_TRAFFIC": "1",
            "DISABLE_AUTOUPDATER": "1",
            "DISABLE_TELEMETRY": "1",
            "DISABLE_ERROR_REPORTING": "1",
        }

    def configure(self, place: Workplace, printed: str, model: str) -> None:
        program, *words = shlex.split(printed)
        assert program == "claude", printed
        place.run(self.program, *words)
        (place.home / "model").write_text(model)

    def servers(self, place: Workplace) -> str:
        return place.run(self.program, "mcp", "get", "ros2")

    def command(self, place: Workplace, prompt: str) -> list[str]:
        address = (place.home / "model").read_text()
        output = ("--output-format", "stream-json", "--verbose")
        settings = f'{{"env": {{"ANTHROPIC_BASE_URL": "{address}"}}}}'
        return [str(self.program), "--settings", settings, *output, "-p", prompt]

    def waiting(self, tools: list[str]) -> Call:
        """It offers tools of servers only after its model has searched for them."""
        names = ",".join(f"mcp__ros2__{tool}" for tool in tools)
        return Call("ToolSearch", {"query": f"select:{names}", "max_results": len(tools)}, own=True)
