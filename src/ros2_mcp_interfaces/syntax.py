"""Checks definition files line by line, so that a mistake is reported with its line number."""

# pyright: basic, reportMissingImports=false

from __future__ import annotations

import contextlib
import io
import keyword

from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.package import Package, read_text

_SECTIONS = {".msg": ("message",), ".srv": ("request", "response"), ".action": ("goal", "result", "feedback")}
_HINT = (
    "A line is a field, 'float64 speed 0.5' with an optional default value, or a constant, 'uint8 IDLE=0'; "
    "fields are lower_case, constants UPPER_CASE, types written like uint8 or geometry_msgs/Point."
)


def check_syntax(package: Package) -> None:
    """Raise `BuildError` with file and line for the first line that is not a valid definition."""
    for file in package.files:
        lines, sections = read_text(file).splitlines(), _SECTIONS[file.suffix]
        if lines.count("---") != len(sections) - 1:
            raise BuildError(
                f"{file} has {lines.count('---')} lines '---' where there must be {len(sections) - 1}",
                f"The parts of a {file.suffix} file: {', '.join(sections)}. Nothing else may stand on the line.",
            )
        first_lines: dict[str, int] = {}
        for number, line in enumerate(lines, start=1):
            if line == "---":
                first_lines.clear()
                continue
            place = f"{file} line {number}"
            for name in _names_defined(package.name, place, line):
                if name in first_lines:
                    raise BuildError(f'{place}: "{name}" is defined already in line {first_lines[name]}')
                if keyword.iskeyword(name):
                    raise BuildError(
                        f'{place}: "{name}" is a word of the Python language',
                        "The generated Python code could not be imported. Choose another field name.",
                    )
                first_lines[name] = number


def _names_defined(package: str, place: str, line: str) -> list[str]:
    """Return the fields and constants of one line. ROS's own parser reads whole files without reporting lines, so it is
    given one line at a time.
    """
    from rosidl_adapter import parser  # Imported here: without the ROS installation, this package must still start

    refusals = (parser.InvalidSpecification, parser.InvalidValue, TypeError, NameError, ValueError)
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            message = parser.parse_message_string(package, "Line", line)
        except (*refusals, NotImplementedError, IndexError, AssertionError) as error:
            raise BuildError(f'{place}: "{line.strip()}" is not understood: {error}', _HINT) from error
    return [entry.name for entry in (*message.fields, *message.constants)]
