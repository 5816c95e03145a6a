"""Findings about a program before it runs: errors of types and names, with hints."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.programs.sandbox import MODULE, Finding

_SURE = frozenset(
    {
        "invalid-argument-type",
        "invalid-key",
        "invalid-syntax",
        "missing-argument",
        "missing-typed-dict-key",
        "parameter-already-assigned",
        "too-many-positional-arguments",
        "unknown-argument",
        "unresolved-attribute",
        "unresolved-import",
        "unresolved-reference",
    }
)
"""Rules of the type checker whose findings are also errors at run time. Others, such as a value that may be None, may
be false alarms.
"""
_MAY_BE_NONE = re.compile(r"[Ff]ound `(?=[^`]*\|)[^`]*\bNone\b[^`]*`")
"""Matches a finding about an argument whose type includes None, as before a loop that sets it: it may be a
false alarm.
"""
_NO_MEMBER = re.compile(r"Module `(\w+)` has no member `(\w+)`")
_IMPORTS = "It can import robot, math, time, json, re, datetime, asyncio, and no others."
_ARRAYS = (
    "There is no NumPy: robot.points, robot.grid and robot.unpack make numbers of clouds, maps and bytes, and "
    "robot.mean, percentile, slope … compute. help(robot.points) says how."
)
_OFFERED = frozenset({"math", "time", "json", "re", "datetime", "asyncio"})
_MOST_TOLD = 5
_HINTS = (
    ("`open` used when not defined", "A program has no files: it reads with robot.latest and robot.messages."),
    ("Cannot resolve imported module `numpy", _ARRAYS),
    ("Cannot resolve imported module `struct", "robot.unpack(format, data, offset=0) reads bytes by the same formats."),
    ("Cannot resolve imported module", _IMPORTS),
    ("`dict[str, Any]` has no attribute", 'A message is a dict: message["pose"]["position"]["x"].'),
)


def require_sound(findings: Sequence[Finding], text: str, functions: Sequence[str], done: str = "run") -> None:
    """Raise `BadInput` with each line that is certainly wrong, and a hint. `done` is what was not done with the
    program, such as "run".
    """
    lines = text.splitlines()
    told: list[str] = []
    for finding in findings:
        if finding.rule in _SURE and finding.line > 0 and not _MAY_BE_NONE.search(finding.message):
            source = lines[finding.line - 1].strip() if finding.line <= len(lines) else ""
            hint = _hint(finding.message, functions)
            told.append(f"line {finding.line} ({source[:80]}): {finding.message}. {hint}".rstrip())
    if told:
        more = f" And {len(told) - _MOST_TOLD} more." if len(told) > _MOST_TOLD else ""
        raise BadInput(f"The program was not {done}. {' '.join(told[:_MOST_TOLD])}{more}")


def _hint(message: str, functions: Sequence[str]) -> str:
    if missing := _NO_MEMBER.search(message):
        module, member = missing.groups()
        if module == MODULE:
            return did_you_mean(member, functions, f"It has: {', '.join(functions)}.")
        return "" if module in _OFFERED else f"A program has no files, no network and no system. {_IMPORTS}"
    return next((hint for part, hint in _HINTS if part in message), "")
