"""Checks definition files line by line, so that a mistake is reported with its line number."""

# pyright: basic, reportMissingImports=false

from __future__ import annotations

import contextlib
import io
import keyword
from collections.abc import Iterator
from pathlib import Path

from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.package import Package, read_text

_SECTIONS = {".msg": ("message",), ".srv": ("request", "response"), ".action": ("goal", "result", "feedback")}
_HINT = (
    "A line is a field, 'float64 speed 0.5' with an optional default value, or a constant, 'uint8 IDLE=0'; "
    "fields are lower_case, constants UPPER_CASE, types written like uint8 or geometry_msgs/Point."
)


def check_syntax(package: Package) -> None:
    """Raises `BuildError` with file and line for the first line that is not a definition."""
    for file in package.files:
        lines = read_text(file).splitlines()
        _check_borders(file, lines.count("---"))
        first_lines: dict[str, int] = {}
        for number, line in enumerate(lines, start=1):
            if line == "---":
                first_lines.clear()
                continue
            for name in _names_defined(package.name, file, number, line):
                _check_name(name, f"{file} line {number}", first_lines)
                first_lines[name] = number


def _check_borders(file: Path, found: int) -> None:
    sections = _SECTIONS[file.suffix]
    if found != len(sections) - 1:
        raise BuildError(
            f"{file} has {found} lines '---' where there must be {len(sections) - 1}",
            f"The parts of a {file.suffix} file: {', '.join(sections)}. Nothing else may stand on the line.",
        )


def _check_name(name: str, place: str, first_lines: dict[str, int]) -> None:
    if name in first_lines:
        raise BuildError(f'{place}: "{name}" is defined already in line {first_lines[name]}')
    if keyword.iskeyword(name):
        raise BuildError(
            f'{place}: "{name}" is a word of the Python language',
            "The generated Python code could not be imported. Choose another field name.",
        )


def _names_defined(package: str, file: Path, number: int, line: str) -> Iterator[str]:
    from rosidl_adapter import parser

    refusals = (parser.InvalidSpecification, parser.InvalidValue, TypeError, NameError, ValueError)
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            message = parser.parse_message_string(package, "Line", line)
        except (*refusals, NotImplementedError, IndexError, AssertionError) as error:
            text = f'{file} line {number}: "{line.strip()}" is not understood: {error}'
            raise BuildError(text, _HINT) from error
    return (entry.name for entry in (*message.fields, *message.constants))
