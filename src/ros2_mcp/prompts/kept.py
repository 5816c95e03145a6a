"""Kept programs as prompts: a user chooses a program in the client's menu, with its inputs as arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ros2_mcp.programs import kept
from ros2_mcp.programs.kept import KeptProgram
from ros2_mcp.prompts.markdown import Parsed
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.prompts.prompt import Message, Prompt, step

RUNS = "ros2_program_run"
"""The tool that these prompts call."""


def parse(where: str, name: str, text: str) -> Parsed:
    """Parse the file of a kept program as a prompt."""
    found = kept.parse(Path(where), name, text)
    if isinstance(found, KeptProgram):
        return Parsed(prompt_of(found), 1, ())
    return Parsed(None, found.line, [Mistake(found.file, found.line, found.text)])


def prompt_of(program: KeptProgram) -> Prompt:
    """Return the prompt that runs a kept program."""

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        inputs = {name: value for name, value in values.items() if value is not None}
        call = step(1, RUNS, program=program.name, inputs=inputs)
        return [
            Message(
                f"Run the kept program {program.name}: {program.description}\n\n{call}\n\n"
                "Then report how it ended, what it printed and its value; if it failed, where and why."
            )
        ]

    return Prompt(f"program.{program.name}", program.name, program.description, program.inputs, write)
