"""`ros2_program_save` and `ros2_program_list`: programs that are kept for later use."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

from anyio import to_thread

from ros2_mcp.model import names
from ros2_mcp.model.argument_entries import argument_of
from ros2_mcp.model.arguments import Argument
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.front_matter import FrontMatterError, entry_of
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.results.results import IF_ANY
from ros2_mcp.programs.findings import require_sound
from ros2_mcp.programs.kept import KeptProgram, programs_of
from ros2_mcp.programs.program import Programs
from ros2_mcp.programs.sandbox import Failure, Sandbox, is_installed
from ros2_mcp.programs.stub import stub
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramInput:
    """One input of a program. `default` is null if it has none; `allowed` describes the allowed values."""

    name: str
    type: str
    required: bool
    default: Any
    allowed: str
    description: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramEntry:
    """A kept program. `saved_at` and `saved_by` are empty for one that was written by hand, `code` unless requested."""

    name: str
    description: str
    inputs: Sequence[ProgramInput]
    version: int
    saved_at: str = ""
    saved_by: str = ""
    code: str = ""

    def summary(self) -> str:
        """Return one line: name, inputs, version and description."""
        inputs = ", ".join(each.name if each.required else f"{each.name}={each.default!r}" for each in self.inputs)
        return f"{named(self.name)}({inputs}), version {self.version}: {quoted(self.description)}"


@dataclass(frozen=True, slots=True)
class ProgramList:
    """The kept programs, the folder they are in (if any), and `problems`: files in it that are not valid programs."""

    programs: Sequence[ProgramEntry]
    problems: Sequence[str] = field(metadata=IF_ANY)
    folder: str
    note: str = ""

    def summary(self) -> list[str]:
        """Return a line for each program, and its code if requested."""
        lines = [line for each in self.programs for line in (each.summary(), *each.code.splitlines())]
        return [*(lines or ["No programs are kept."]), *map(quoted, self.problems), *([self.note] if self.note else [])]


@dataclass(frozen=True, slots=True)
class ProgramSaved:
    """The change made: `kept`, `replaced` or `removed`. `previous_file` is the file of the previous version, if any."""

    done: str
    program: ProgramEntry
    folder: str
    previous_file: str = ""

    def summary(self) -> str:
        """Return one line."""
        before = f" The former version is in {named(self.previous_file)}." if self.previous_file else ""
        how = "" if self.done == "removed" else f' To run it: ros2_program_run(program="{self.program.name}").'
        return f"{self.done}: {self.program.summary()}.{how}{before}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramRequest:
    """A program to keep or to remove. `inputs` are declared as in the front matter of a prompt."""

    name: str
    code: str = ""
    description: str = ""
    inputs: Sequence[Mapping[str, Any]] = ()
    overwrite: bool = False
    remove: bool = False


async def list_programs(robot: Robot, pattern: str = "", *, with_code: bool = False) -> ProgramList:
    """Return the programs whose names match the pattern; "" matches all."""
    kept = programs_of(robot)
    programs, mistakes = await to_thread.run_sync(kept.all)
    chosen = set(names.matching([each.name for each in programs], pattern))
    entries = [_entry(each, with_code=with_code) for each in programs if each.name in chosen]
    note = f"{len(programs)} are kept, {len(entries)} match." if len(entries) < len(programs) else ""
    return ProgramList(entries, [str(mistake) for mistake in mistakes], str(kept.folder or ""), note)


async def save_program(robot: Robot, session: Session, programs: Programs, request: ProgramRequest) -> ProgramSaved:
    """Keep a program that passes the checks, or remove a program, and note it in the audit. Nothing runs.

    Raises:
        BadInput: for an error in the program, too.
        BadInput, NotFound, BadData, RobotError: as `KeptPrograms.save` and `remove`.
        Refused: under a policy in the mode observe.
    """
    robot.guard.check_keeping("programs")
    kept = programs_of(robot)
    if request.remove:
        gone = await to_thread.run_sync(kept.remove, request.name)
        _audit(robot, session, "program removed", gone)
        return ProgramSaved("removed", _entry(gone), str(kept.folder or ""), str(kept.former_file(gone)))
    program = KeptProgram(
        name=request.name,
        description=request.description,
        code=request.code,
        inputs=inputs_of(request.inputs),
        saved=datetime.now(timezone.utc).isoformat(timespec="seconds").replace("+00:00", "Z"),
        by=session.principal.name,
    )

    await _require_sound(programs, program)

    def save() -> tuple[KeptProgram, KeptProgram | None]:
        return kept.save(program, overwrite=request.overwrite)

    saved, former = await to_thread.run_sync(save)
    _audit(robot, session, "program kept", saved)
    done = "replaced" if former else "kept"
    return ProgramSaved(done, _entry(saved), str(kept.folder or ""), str(kept.former_file(former)) if former else "")


async def _require_sound(programs: Programs, program: KeptProgram) -> None:
    """Raise `BadInput` for errors that would also keep a run from starting. Inputs may be of any type. Without a
    sandbox, nothing is checked.
    """
    if not is_installed():
        return
    names = [each.name for each in programs.functions]
    sandbox = Sandbox(names, stub(programs.functions), _no_message)
    given = dict.fromkeys(each.name for each in program.inputs)
    async with sandbox.open():
        try:
            found = await sandbox.check(program.code, given)
        except Failure as failure:
            raise BadInput(f"Nothing was kept: {failure.message}.", "Try it again, or a shorter program.") from failure
        require_sound(found, program.code, names, "kept")


async def _no_message(_number: int) -> None:
    """Do nothing: a program that is only checked follows no topic."""


def inputs_of(declared: Sequence[Mapping[str, Any]]) -> tuple[Argument, ...]:
    """Parse inputs as a client declares them.

    Raises:
        BadInput: with the first error.
    """
    found: dict[str, Argument] = {}
    for given in declared:
        try:
            argument = argument_of(entry_of(_as_written(given)))
        except FrontMatterError as error:
            raise BadInput(f"inputs: {error.text}", "Such as {'name': 'distance_m', 'type': 'number'}.") from None
        if argument.name in found:
            raise BadInput(f"The input {argument.name} is given twice.")
        found[argument.name] = argument
    return tuple(found.values())


def _as_written(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return an input as it is written in a file, where a default of type json is a text."""
    default = given.get("default")
    if given.get("type") != "json" or default is None or isinstance(default, str):
        return given
    return {**given, "default": json.dumps(default)}


def _entry(program: KeptProgram, *, with_code: bool = False) -> ProgramEntry:
    return ProgramEntry(
        name=program.name,
        description=program.description,
        inputs=[
            ProgramInput(
                name=each.name,
                type=each.kind,
                required=each.required and each.default is None,
                default=each.default,
                allowed=each.allowed(),
                description=each.description,
            )
            for each in program.inputs
        ],
        version=program.version,
        saved_at=program.saved,
        saved_by=program.by,
        code=program.code if with_code else "",
    )


def _audit(robot: Robot, session: Session, kind: str, program: KeptProgram) -> None:
    if robot.guard.audit:
        digest = hashlib.sha256(program.code.encode()).hexdigest()
        robot.guard.audit.note(
            kind, principal=session.principal.name, name=program.name, version=program.version, sha256=digest
        )
