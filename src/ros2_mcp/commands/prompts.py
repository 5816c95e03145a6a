"""Check a folder of prompts, for their authors."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

from pathlib import Path

from ros2_mcp.prompts.folder import PromptFolder
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.tools import TOOLS


def check_prompts(folder: Path) -> int:
    """Print the prompts of the folder, and their mistakes as `file:line: text`. Return 1 if there are mistakes."""
    mistakes: list[Mistake] = []
    for prompt in PromptFolder(folder, mistakes.append, tools=frozenset(tool.name for tool in TOOLS)).prompts():
        arguments = ", ".join(argument.name for argument in prompt.arguments) or "no arguments"
        print(f"{prompt.name} ({arguments})")
    for mistake in mistakes:
        print(mistake)
    return 1 if mistakes else 0
