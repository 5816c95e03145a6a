"""Say which ROS 2 is used and why, and how to mend what is wrong."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator, Mapping

from ros2_mcp.link.diagnosis import Finding, diagnose, probe
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import visible
from ros2_mcp.settings import OPTIONS, Settings

_MARKS = {True: "ok  ", False: "BAD ", None: "note"}


def doctor(settings: Settings) -> int:
    """Prints every finding, starts the bridge once for real, and returns 1 if something is wrong."""
    findings = [*diagnose(settings, os.environ), *what_is_set(settings, os.environ)]
    for finding in findings:
        _print(finding)
    started = asyncio.run(probe(settings))
    _print(started)
    return 0 if started.ok and all(finding.ok is not False for finding in findings) else 1


def what_is_set(settings: Settings, env: Mapping[str, str]) -> Iterator[Finding]:
    """Every setting that is not left to its default, with what set it; and variables that were meant to set one."""
    for name, origin in settings.origins.items():
        value = OPTIONS[name].kind.written(getattr(settings, name))
        yield Finding(None, f"Setting {origin}", f"{value or 'all'} ({OPTIONS[name].help})")
    if not settings.origins:
        yield Finding(None, "Settings", "none is set: all have their defaults (ros2-mcp --help)")
    ours = [option.variable for option in OPTIONS.values()]
    for variable in env:
        if variable.startswith("ROS2_MCP_") and variable not in ours:
            # Nobody else would say so: a misspelt ROS2_MCP_READONLY leaves a server that can move the robot.
            fix = did_you_mean(variable, ours, "Unset it; ros2-mcp --help lists the options.")
            yield Finding(None, variable, "is set, but is none of this server's variables", fix)


def _print(finding: Finding) -> None:
    print(visible(f"[{_MARKS[finding.ok]}] {finding.title}: {finding.detail}"))
    if finding.fix:
        print(visible(f"       fix: {finding.fix}"))
