"""Say which ROS 2 is used and why, and how to mend what is wrong."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os

from ros2_mcp.link.diagnosis import Finding, diagnose, probe
from ros2_mcp.settings import Settings

_MARKS = {True: "ok  ", False: "BAD ", None: "note"}


def doctor(settings: Settings) -> int:
    """Prints every finding, starts the bridge once for real, and returns 1 if something is wrong."""
    findings = diagnose(settings, os.environ)
    for finding in findings:
        _print(finding)
    started = asyncio.run(probe(settings))
    _print(started)
    return 0 if started.ok and all(finding.ok is not False for finding in findings) else 1


def _print(finding: Finding) -> None:
    print(f"[{_MARKS[finding.ok]}] {finding.title}: {finding.detail}")
    if finding.fix:
        print(f"       fix: {finding.fix}")
