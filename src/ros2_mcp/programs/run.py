"""Runs a program, and reports its result."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.text import counted, quoted
from ros2_mcp.ops.results.results import HIDDEN, ON_REQUEST, SAID, Report, WithPictures, facts, silent
from ros2_mcp.programs.crossing import crossed
from ros2_mcp.programs.program import MOST_PRINTED, Done, Program, Programs, Record
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session

MOST_CHARACTERS = 20_000
"""The longest program: ten times what a task needs."""
_MOST_TOLD = 5
"""The most notes from functions about their results."""
MOST_VALUE = 12_000
"""The most characters of JSON of a program's value, and of its inputs."""


@dataclass(frozen=True, slots=True)
class ProgramError:
    """The error that ended a program: its line and the text of that line, the problem, and a hint."""

    line: int
    source: str
    message: str
    hint: str = ""


ProgramEnd = Literal["ended", "failed", "limit", "stopped", "crashed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ran(WithPictures):
    """The outcome of a program run.

    `outcome` is `ended`, `failed` (an error in the program), `limit` (of time, memory or calls, for example), `stopped`
    (by `ros2_stop` or the latch) or `crashed` (its process died). `printed` has its output; `returned` has, under
    `value`, the value of the last line if that is an expression. `commands` lists the commands that it sent to the
    robot, with their lines: if there are many, the first and the last. `stopped_at_end` lists what was still in motion
    when the program ended, and was then stopped.
    """

    outcome: ProgramEnd = field(metadata=SAID)
    printed: Sequence[str] = ()
    returned: Mapping[str, Any] | None = field(default=None, metadata=ON_REQUEST)
    error: ProgramError | None = field(default=None, metadata=ON_REQUEST)
    elapsed_s: float = field(metadata=SAID)
    calls: int = field(metadata=SAID)
    commands: Sequence[Done] = ()
    stopped_at_end: Sequence[str] = ()
    program_id: str
    note: str = ""
    commands_given: int = field(default=0, metadata=HIDDEN)

    @property
    def has_failed(self) -> bool:
        """Whether the program failed; a stop is not a failure."""
        return self.outcome in ("failed", "limit", "crashed")

    def summary(self) -> str:
        """Return one line: the outcome, the error, the time, and the counts of calls and commands."""
        why = ""
        if self.error:  # an error of the program may contain texts from the robot
            message = quoted(self.error.message) if self.outcome == "failed" else self.error.message
            why = f" at line {self.error.line}: {message}" if self.error.line else f": {message}"
        did = f"{counted(self.calls, 'call')}, {counted(self.commands_given, 'command')}"
        return f"{self.outcome}{why} after {self.elapsed_s:g} s, {did}. {self.note}".rstrip()


async def run(
    robot: Robot,
    session: Session,
    programs: Programs,
    text: str,
    inputs: Mapping[str, Any] | None,
    timeout_s: float,
    report: Report = silent,
    *,
    dry_run: bool = False,
) -> Ran:
    """Run a program to its end, and return the report. Its output is reported as progress.

    A dry run reads, but carries out no command: it reports what would be done.

    Raises:
        BadInput: if the program cannot be run, or is certainly wrong; nothing was run.
        Refused: if too many programs are running.
    """
    given = _checked_inputs(inputs or {})
    if len(text) > MOST_CHARACTERS:
        raise BadInput(f"The program has {len(text)} characters; at most {MOST_CHARACTERS} are taken.")
    if not text.strip():
        raise BadInput("`program` is empty.", 'Such as: import robot\nprint(robot.latest("/odom")["_age_s"])')
    program = Program(robot, session, programs, text, given, timeout_s, is_rehearsal=dry_run)
    said = 0

    async def progress() -> None:
        nonlocal said
        printed = "".join(program.record.printed)
        new, said = printed[said:].rstrip("\n"), len(printed)
        line = (
            program.waits_for
            or new.rpartition("\n")[2]
            or f"{program.record.calls} calls, {program.record.messages} messages"
        )
        await report(program.elapsed_s, timeout_s, line)

    await robot.jobs.run(program, every_second=progress)
    return _told(program, text, "A dry run: nothing was done." if dry_run else "")


def _told(program: Program, text: str, note: str) -> Ran:
    record, notes = program.record, [note] if note else []
    failure = record.failure
    outcome: ProgramEnd = "ended"
    if failure:
        outcome = cast("ProgramEnd", {"error": "failed", "crash": "crashed"}.get(failure.kind, failure.kind))
    elif program.state == "stopped":
        outcome = "stopped"
        notes.append(f"It was ended by {program.stop_reason or 'a request to cancel it'}.")
    if record.characters > MOST_PRINTED:
        notes.append(f"It printed {record.characters} characters, of which the first {MOST_PRINTED} are shown.")
    if record.commands > len(record.done):
        notes.append(f"{record.commands} commands were given, of which {len(record.done)} are listed.")
    notes += [*record.told][:_MOST_TOLD]
    if record.ended:
        notes.append(f"Ended with it: {', '.join(record.ended)}.")
    returned, cut = _returned(record)
    notes += [cut] if cut else []
    lines = text.splitlines()
    return Ran(
        outcome=outcome,
        printed="".join(record.printed).splitlines(),
        returned=returned,
        error=failure
        and ProgramError(
            failure.line,
            lines[failure.line - 1].strip()[:200] if 0 < failure.line <= len(lines) else "",
            failure.message,
            _hint(failure.message),
        ),
        elapsed_s=round(program.elapsed_s, 3),
        calls=record.calls,
        commands=record.done,
        stopped_at_end=record.ended,
        program_id=program.id,
        note=" ".join(notes),
        commands_given=record.commands,
        pictures=facts(record.pictures),
        images=record.pictures,
    )


def _returned(record: Record) -> tuple[Mapping[str, Any] | None, str]:
    if record.value is None:
        return None, ""
    try:
        value = crossed(record.value, "The value", for_json=True)
    except BadInput as error:
        return None, str(error)
    text = json.dumps(value, ensure_ascii=False)
    if len(text) > MOST_VALUE:
        return {"value": text[:200]}, f"The value has {len(text)} characters of JSON, too many to be shown: print less."
    return {"value": value}, ""


def _checked_inputs(inputs: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the inputs. Raises `BadInput` for an invalid name, or if they are too large."""
    for name in inputs:
        if not name.isidentifier() or name.startswith("_"):
            raise BadInput(f"inputs: {name!r} is not a valid name in a program.", "Use letters, such as topic.")
    if len(json.dumps(inputs, default=str)) > MOST_VALUE:
        raise BadInput(f"inputs: more than {MOST_VALUE} characters of JSON.")
    return inputs


def _hint(message: str) -> str:
    if message.startswith("KeyError"):
        return "print(message.keys()) shows what is there; fields of messages are those of ros2_get_message_fields."
    if "'Messages' object is not iterable" in message:
        return "A stream goes into a for: for m in robot.messages(...): found.append(m), or [m for m in ...]."
    if message.startswith("NotImplementedError"):
        return "The sandbox has no generators, no classes that inherit, and no async for: write a plain loop."
    return ""
