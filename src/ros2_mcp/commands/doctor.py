"""Report which ROS 2 is used and why, and how to fix what is wrong."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version

from ros2_mcp.compose.entries import entries_of
from ros2_mcp.compose.robot import guard_for
from ros2_mcp.link.diagnosis import Finding, diagnose, probe
from ros2_mcp.link.provenance import own_provenance
from ros2_mcp.link.refusals import by_doctor, by_hand
from ros2_mcp.link.remote import ssh_words
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import counted, listed, visible
from ros2_mcp.ops.graph.status import NO_POLICY
from ros2_mcp.programs import sandbox
from ros2_mcp.robot.graph import Graph
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp.settings import OPTIONS, Settings

_MAX_NODES = 8
"""The most nodes of the robot in one line: enough to recognise the robot."""
_ROBOT = "Robot"
_POLICY = "Policy"
_MARKS = {True: "ok  ", False: "BAD ", None: "note"}


def doctor(settings: Settings) -> int:
    """Print every finding about each robot, start its bridge once, and return 1 if something is wrong.

    A missing robot is not wrong: it may be switched off.
    """
    set_here = [*what_is_set(settings, os.environ), programs_here()]
    entries = entries_of(settings)
    results: list[int] = []
    for entry in entries:
        if entry.name:
            print(f"\n{visible(entry.name)}:")
        results.append(_examine(entry.settings, set_here))
        set_here = []  # printed only once
    return max(results)


def _examine(settings: Settings, set_here: Sequence[Finding]) -> int:
    """Print the findings about one robot, and return 1 if something is wrong."""
    findings = [*diagnose(settings, os.environ), *set_here, policy_in_force(settings)]
    for finding in findings:
        _print(finding)
    started = asyncio.run(probe(settings, lambda bridge: _robot(Graph(bridge))))
    if any(finding.needs_a_person for finding in started) and _lets_in(settings):
        started = asyncio.run(probe(settings, lambda bridge: _robot(Graph(bridge))))
    for finding in started:
        _print(finding if sys.stdin.isatty() else _without_terminal(finding, settings))
    print(f"\n{_verdict([*findings, *started])}")
    return 0 if all(finding.ok is not False for finding in (*findings, *started)) else 1


def _lets_in(settings: Settings) -> bool:
    """Let a person at the terminal answer ssh: accept a host key, or unlock a key. Return whether ssh then
    succeeded.
    """
    if settings.robot.kind != "ssh" or not sys.stdin.isatty():
        return False
    words = [*ssh_words(settings.robot, settings.ssh_options, may_ask=True), "exit"]
    print(f"ssh asks what only you can answer. Compare a host key before you accept it.\n$ {shlex.join(words)}")
    return subprocess.run(words, check=False).returncode == 0


def _without_terminal(finding: Finding, settings: Settings) -> Finding:
    """Return a finding whose fix names the ssh command, for a user without a terminal: there, this command could not
    ask.
    """
    itself = by_doctor(settings.robot, settings.ssh_options)
    if not finding.needs_a_person or itself not in finding.fix:
        return finding
    return replace(finding, fix=finding.fix.replace(itself, by_hand(settings.robot, settings.ssh_options)))


def _verdict(findings: Sequence[Finding]) -> str:
    """Return the overall result in one line."""
    if wrong := [finding.title for finding in findings if finding.ok is False]:
        return f"Not in order: {', '.join(wrong)}. See the lines marked BAD."
    robot = next((finding for finding in findings if finding.title == _ROBOT), None)
    if robot and robot.ok is None:  # it may be switched off
        return f"ROS 2 is found and the bridge starts. {robot.detail.partition('. ')[0].rstrip('.')}."
    return "ROS 2 is found, the bridge starts, and a robot is seen."


async def _robot(graph: Graph) -> Finding:
    """Return whether a robot is seen, after discovery has settled."""
    if absence := await graph.absence():
        return Finding(None, _ROBOT, absence)
    nodes = sorted({row.name for row in await graph.nodes() if is_of_robot(row.name)})
    return Finding(
        True, _ROBOT, f"{counted(len(nodes), 'node')} in domain {graph.domain_id}: {listed(nodes, _MAX_NODES)}"
    )


def what_is_set(settings: Settings, env: Mapping[str, str]) -> Iterator[Finding]:
    """Yield every setting that differs from its default, with its origin, and unknown variables that look like
    settings.
    """
    for name, origin in settings.origins.items():
        value = OPTIONS[name].kind.written(getattr(settings, name))
        yield Finding(None, f"Setting {origin}", f"{value or 'all'} ({OPTIONS[name].help})")
    if not settings.origins:
        yield Finding(None, "Settings", "none is set: all have their defaults (ros2-mcp --help)")
    ours = [option.variable for option in OPTIONS.values()]
    for variable in env:
        if variable.startswith("ROS2_MCP_") and variable not in ours:
            # A misspelt ROS2_MCP_READONLY leaves a server that can move the robot, and nothing else reports it.
            fix = did_you_mean(variable, ours, "Unset it; ros2-mcp --help lists the options.")
            yield Finding(None, variable, "is set, but is none of this server's variables", fix)


def programs_here() -> Finding:
    """Return whether programs can run here: their sandbox is an extra."""
    if sandbox.is_installed():
        return Finding(True, "Programs", f"run in the sandbox pydantic-monty {version('pydantic-monty')}")
    extra = f"For the extra that has one, run: {own_provenance().installing('programs')}"
    return Finding(None, "Programs", "have no sandbox here: ros2_program_run is not offered", extra)


def policy_in_force(settings: Settings) -> Finding:
    """Return which policy a server with these settings has, and its strength."""
    try:
        guard = guard_for(settings)
    except BadInput as error:
        return Finding(False, _POLICY, error.message, error.hint)
    if not guard.policy.in_force:
        return Finding(None, _POLICY, f"{NO_POLICY} (ros2-mcp policy init drafts one from the robot)")
    names = " and ".join(f"{document.name} ({document.origin})" for document in guard.policy.documents)
    told = f"{names}, mode {guard.policy.mode}, {guard.strength}, sha256 {guard.policy.digest}"
    return Finding(True, _POLICY, told)


def _print(finding: Finding) -> None:
    print(visible(f"[{_MARKS[finding.ok]}] {finding.title}: {finding.detail}"))
    if finding.fix:
        print(visible(f"       fix: {finding.fix}"))
