"""Call one tool from the command line, without an MCP client."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import base64
import json
import math
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ros2_mcp.commands.assignments import read_assignments
from ros2_mcp.commands.endings import when_told_to_end
from ros2_mcp.commands.serve import launch, show_log
from ros2_mcp.commands.terminal import readable
from ros2_mcp.commands.tool_help import found, of_call
from ros2_mcp.model.errors import ApprovalNeeded, RobotError
from ros2_mcp.model.text import counted, visible
from ros2_mcp.settings import Settings

if TYPE_CHECKING:
    from mcp.types import CallToolResult

    from ros2_mcp.mcp.binding import BoundTool
    from ros2_mcp.robot import Robot
    from ros2_mcp.robot.goals import Goal
    from ros2_mcp.robot.jobs import Job

_PIPED_COLUMNS = 160
"""The width of output that does not go to a terminal: enough for nearly every table, and still readable."""


_FEEDBACK_S = 1.0
"""Time between two lines of a goal's feedback: short enough to show progress, long enough to read."""
_ON_THEIR_WAY = ("ACCEPTED", "EXECUTING", "SUCCEEDED")
"""The states of a goal that has not failed; with any other state the call has failed."""
_ANSWERED_POLL_S = 0.2
"""Time between two checks whether a person has answered: too short to notice."""
_FAILED, _INTERRUPTED = 1, 130
"""Exit codes: the call failed; or Ctrl+C ended it (128 + SIGINT, as in a shell)."""
_STOPS_ITS_OWN = """\
A call from a shell stops only what it has begun itself, and this one began nothing: what other programs, a server or
another call, have set in motion goes on. Ctrl+C ends another call; a server is told by its own client;
ros2_cancel_action_goal cancels goals, whoever sent them."""


def call(settings: Settings, tool: str, assignments: Sequence[str], *, as_json: bool, output: Path | None) -> int:
    """Call the tool and print its answer. Save pictures in `output`, or else in the folder for temporary files.

    A recording, goal or other job that the call has started continues until it ends, or Ctrl+C ends it. Topics that it
    drives get a zero when the call ends, which is reported.

    Returns:
        The exit code: 0; 1 if the call failed (also for a goal that did not succeed); 130 if Ctrl+C ended it early.
    """
    settings = of_call(settings)
    bridge = launch(settings)
    show_log(settings)
    from ros2_mcp.compose.server import assemble

    async def once() -> int:
        # Python 3.10 would cancel the bridge's supervisor together with this task: the bridge would be killed, without
        # stopping the robot.
        interrupt = _Interrupt()
        assembly = assemble(settings, bridge)
        async with assembly.running():
            bound = found(assembly.toolset.by_name, tool)
            arguments = read_assignments(assignments, bound.listed.input_schema, bound.declaration.aliases)
            try:
                code = await _print_answer(settings, bound, arguments, as_json, output)
            except asyncio.CancelledError:
                await _stop(assembly.robot)
                raise
            return code or await _until_over(assembly.robot, interrupt)

    try:
        return asyncio.run(once())
    except asyncio.CancelledError:  # Ctrl-C
        return _INTERRUPTED


class _Interrupt:
    """Handles Ctrl+C and other signals to end: cancels the call; after `event()` was called, sets its event instead."""

    def __init__(self) -> None:
        this_call = asyncio.current_task()
        assert this_call
        self._call = this_call
        self._event: asyncio.Event | None = None
        when_told_to_end(self._come)

    def _come(self) -> None:
        if self._event:
            self._event.set()
        else:
            self._call.cancel()

    def event(self) -> asyncio.Event:
        """Return an event that is set by the signal from now on, instead of cancelling the call."""
        self._event = asyncio.Event()
        return self._event


async def _until_over(robot: Robot, interrupt: _Interrupt) -> int:
    """Wait for the jobs of the call, or end them in order after Ctrl+C. Report their outcome, and return
    the exit code.
    """
    from ros2_mcp.robot.goals import Goal
    from ros2_mcp.robot.jobs import Job

    jobs = robot.jobs.running(Job)
    if not jobs:
        await _stop(robot)
        return 0
    ending = interrupt.event()  # before the user is told that Ctrl+C ends it
    for job in jobs:
        print(f"{_named(job)} {_until_when(job)}.", file=sys.stderr, flush=True)
    goals = [asyncio.create_task(_follow(robot, job)) for job in jobs if isinstance(job, Goal)]
    others = [job for job in jobs if not isinstance(job, Goal)]
    all_over = [*goals, *(asyncio.create_task(job.wait()) for job in others)]
    waiting = [asyncio.create_task(asyncio.wait(all_over)), asyncio.create_task(ending.wait())]
    await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
    for task in (*waiting, *all_over):
        task.cancel()
    await asyncio.wait((*waiting, *all_over))
    await asyncio.gather(*(_end(robot, job) for job in others))
    await _stop(robot)
    if any(goal.cancelled() for goal in goals):
        return _INTERRUPTED
    return 0 if all(goal.result() for goal in goals) else _FAILED


def _until_when(job: Job) -> str:
    from ros2_mcp.robot.goals import Goal

    if isinstance(job, Goal):
        return "is followed until it ends; Ctrl+C cancels it"
    if job.at_most_s < math.inf:
        return f"runs for at most {job.at_most_s:g} s; Ctrl+C ends it before"
    return "runs until Ctrl+C ends it"


async def _follow(robot: Robot, goal: Goal) -> bool:
    """Show the feedback of a goal until it has ended, and then its result. Return whether it succeeded."""
    from ros2_mcp.ops.actions.send_goal import follow
    from ros2_mcp.ops.results.results import as_json, at_most_every

    async def show(done: float, _: float, line: str) -> None:
        print(visible(f"{done:.0f} s  {line}"), file=sys.stderr, flush=True)

    try:
        outcome = await follow(robot, goal, at_most_every(_FEEDBACK_S, show))
    except RobotError as error:
        print(visible(f"{_named(goal)} could not be followed to its end: {error}"), file=sys.stderr, flush=True)
        return False
    shown = {"result": as_json(outcome)["result"]}
    lines = readable([outcome.summary()], shown, _columns())
    print(visible("\n".join(lines), keep="\n"), file=sys.stderr, flush=True)
    return outcome.status == "SUCCEEDED"


async def _stop(robot: Robot) -> None:
    """Send zeros to the topics that this call drives, cancel its goals, and report each. This is the end of a call, not
    a stop: it does not set the latch.

    The bridge would do the same when this process ends, but could not report it.
    """
    from ros2_mcp.ops.stop.stop import cancel_goals

    zeros, goals = await asyncio.gather(_zeros(robot, robot.failsafes.moving), cancel_goals(robot))
    cancelled = [
        f"goal {goal.goal_id} of {goal.action_name}: "
        + (goal.error or f"{goal.status}{'' if goal.confirmed else ', and has not ended yet'}.")
        for goal in goals
    ]
    for line in (*zeros, *cancelled):
        print(visible(line), file=sys.stderr, flush=True)


async def _zeros(robot: Robot, topics: Sequence[str]) -> list[str]:
    """Send the zeros, and return a sentence for each topic."""
    if not topics:
        return []
    try:
        sent = await robot.zero(topics)
    except RobotError as error:
        return [f"NOT confirmed: whether {', '.join(topics)} got a zero command is not known: {error}"]
    return [
        f"{zero['topic']}: the call has ended, and a zero command was sent to {counted(zero['matched'], 'subscriber')}."
        f"{' NOT confirmed: not every one has acknowledged it.' if zero['matched'] and not zero['acked'] else ''}"
        for zero in sent
    ]


def _named(job: Job) -> str:
    return job.id if job.id.startswith(job.kind) else f"{job.kind} {job.id}"


async def _end(robot: Robot, job: Job) -> None:
    problem = ""
    try:
        await job.stop()
    except Exception as error:  # noqa: BLE001 - it has ended all the same, and the others are ended, too
        problem = f" It did not end in good order: {error}"
    report = getattr(job, "report", None)
    state = report() if report else None
    lines = [state.summary()] if state else [f"{_named(job)} {job.state}."]
    if path := getattr(state, "path", ""):
        lines.append(f"The bag is {path}")
    lines += [
        f"{driven.topic}: a zero command was sent."
        for driven in robot.failsafes.driven
        if driven.has_ended and driven.topic in job.moves
    ]
    print(visible("\n".join(lines) + problem, keep="\n"), file=sys.stderr, flush=True)


async def approved(settings: Settings, tool: BoundTool, arguments: Mapping[str, Any]) -> CallToolResult:
    """Return the answer of the tool. If a person has to approve it, wait, and call it again. Raises `CallFailed`."""
    from ros2_mcp.compose.robot import operated
    from ros2_mcp.guard.consent import Consent
    from ros2_mcp.mcp.binding import CallFailed

    while True:
        try:
            return await tool.call(arguments, _print_progress)
        except CallFailed as error:
            needed, consent = error.__cause__, tool.robot.guard.approvals
            if not (isinstance(needed, ApprovalNeeded) and isinstance(consent, Consent)):
                raise
        waits = f"{needed.request_id} waits for a person: ros2-mcp operate, in another terminal. Ctrl+C gives it up."
        print(waits, file=sys.stderr, flush=True)
        async with operated(tool.robot, settings):
            while any(request.id == needed.request_id for request in consent.approvals.waiting()):
                await asyncio.sleep(_ANSWERED_POLL_S)


async def _print_answer(
    settings: Settings, tool: BoundTool, arguments: dict[str, Any], as_json: bool, output: Path | None
) -> int:
    from ros2_mcp.mcp.binding import SUMMARY, CallFailed

    try:
        result = await approved(settings, tool, arguments)
    except CallFailed as error:
        print(error, file=sys.stderr)
        return _FAILED
    value: dict[str, Any] = result.structured_content or {}
    beside = [f"picture saved: {path}" for path in _saved_pictures(result, output)]
    stops = tool.declaration.risk == "stop"
    if stops:  # so that neither this text nor the exit code suggests that the robot was stopped
        beside.append(_STOPS_ITS_OWN)
        value["confirmed"] = False
    if as_json:
        print(json.dumps(value, ensure_ascii=False), flush=True)
        print("\n".join(beside), end="\n" if beside else "", file=sys.stderr, flush=True)
    else:
        summary = value.pop(SUMMARY).split("\n")
        lines = readable([*summary, *beside], value, _columns())
        print("\n".join(lines), flush=True)
    return _FAILED if stops or result.is_error or _has_gone_wrong(value) else 0


def _has_gone_wrong(result: Mapping[str, Any]) -> bool:
    """Return whether the result is about a goal that was not accepted, ended without success, or did not
    end in time.
    """
    return "goal_id" in result and result.get("status", _ON_THEIR_WAY[0]) not in _ON_THEIR_WAY


def _columns() -> int:
    return shutil.get_terminal_size((_PIPED_COLUMNS, 0)).columns


async def _print_progress(done: float, whole: float, line: str) -> None:
    print(f"{done:.0f}/{whole:.0f} s  {line}", file=sys.stderr)


def _saved_pictures(result: CallToolResult, folder: Path | None) -> list[Path]:
    saved: list[Path] = []
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
    for block in result.content:
        if block.type == "image":
            ending = f".{block.mime_type.split('/')[1]}"
            with tempfile.NamedTemporaryFile(prefix="ros2-mcp-", suffix=ending, dir=folder, delete=False) as file:
                file.write(base64.b64decode(block.data))
            saved.append(Path(file.name))
    return saved
