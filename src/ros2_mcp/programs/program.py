"""A program as a job: its process, its calls, its limits, and the end of everything that it has begun."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from time import monotonic
from typing import Any, cast, get_args

import anyio

from ros2_mcp.guard.audit import called_through
from ros2_mcp.model.errors import ApprovalNeeded, BadInput, Rehearsed, RobotError, Stopped
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.pictures import Picture
from ros2_mcp.model.text import counted
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import Report, as_json, lines_of, silent
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.source import Source, SourceKind
from ros2_mcp.programs.crossing import crossed
from ros2_mcp.programs.declare import Function
from ros2_mcp.programs.findings import require_sound
from ros2_mcp.programs.held import Held
from ros2_mcp.programs.help_text import help_text
from ros2_mcp.programs.names import require_names
from ros2_mcp.programs.rewrite import Rewritten, rewritten
from ros2_mcp.programs.sandbox import Failure, Sandbox
from ros2_mcp.programs.streams import FollowRequest, Streams
from ros2_mcp.programs.stub import stub
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.session import Session
from ros2_mcp.robot.stops import Accepted

MOST_CALLS = 100_000
"""The most calls of functions: ten minutes of a loop at 100 Hz with one call per turn, and 40,000 more."""
MOST_CALLS_PER_S = 1000
"""The most calls per second. Each takes this process at least 0.1 ms, so that ten programs in endless loops leave it
time for other work.
"""
MOST_MESSAGES = 600_000
"""The most messages: ten minutes at 1 kHz. For more, statistics are the better tool."""
MOST_COMMANDS = 12_000
"""The most commands: ten minutes at 20 Hz, which is as fast as most bases follow."""
MOST_PRINTED = 12_000
"""The most characters shown of what a program prints."""
_MOST_PRINTED_IN_ALL = 1_000_000
"""The most characters that a program may print: more come from an endless loop."""
_MOST_DONE = 40
"""The most commands that are listed, from the beginning and the end; all are counted."""
_LOOK_S = 0.1
"""Time between two checks that the process and the bridge live: a fifth of the time in which a robot has to stop."""
_ASKED_AGAIN_S = 0.2
"""Time between two checks whether a person has answered, which takes seconds anyway."""
_MOST_PICTURES = 4
"""The most pictures of a result: each costs a model about 1500 tokens."""


@dataclass(frozen=True, slots=True)
class Done:
    """A command of a program: its line, its function, and its outcome."""

    line: int
    function: str
    outcome: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Programs:
    """The environment of a server's programs: the functions of the module `robot`, and the sources of messages."""

    functions: Sequence[Function]
    store: BagStore
    kinds: Sequence[SourceKind]


@dataclass(slots=True, kw_only=True)
class Record:
    """The record of a program so far: its output, counts, commands and result."""

    printed: list[str] = field(default_factory=list[str])
    characters: int = 0
    calls: int = 0
    messages: int = 0
    commands: int = 0
    done: list[Done] = field(default_factory=list[Done])
    pictures: list[Picture] = field(default_factory=list[Picture])
    told: dict[str, None] = field(default_factory=dict[str, None])
    ended: list[str] = field(default_factory=list[str])
    value: Any = None
    failure: Failure | None = None

    def note(self, done: Done) -> None:
        """Add a command. Of many, the first and the last are kept."""
        self.done.append(done)
        if len(self.done) > _MOST_DONE:
            del self.done[_MOST_DONE // 2]


@dataclass(frozen=True, slots=True)
class _Use:
    """The `declare.Use` of one call: what the function can use on behalf of the program."""

    program: Program
    robot: Robot
    session: Session
    line: int

    @property
    def store(self) -> BagStore:
        return self.program.programs.store

    @property
    def sources(self) -> Sources:
        return Sources(self.robot, self.program.programs.store, self.program.programs.kinds)

    @property
    def streams(self) -> Streams:
        return self.program.streams

    @property
    def held(self) -> Held:
        return self.program.streams.held

    @property
    def report(self) -> Report:
        return silent

    async def follow(self, source: Source, wanted: FollowRequest) -> Any:
        return await self.program.follow(source, wanted)

    def follow_goal(self, goal: Goal | None) -> Any:
        return self.program.follow_goal(self.robot, goal)

    def tell(self, note: str) -> None:
        self.program.record.told[note] = None

    def keep(self, picture: Picture) -> None:
        self.program.keep(picture)

    async def stop_own(self) -> list[str]:
        return await self.program.end_own()


class Program(Job):
    """A program that runs in the sandbox. Its owner is the principal who started it.

    All that the program begins ends with it, whatever ends it: its topics are unsubscribed, its motion is
    stopped by a zero, its goals are cancelled. `record` is its record so far. `waits_for` says, in words, which
    approval it waits for. A rehearsal reads, but carries out no command.
    """

    kind = "program"
    most_running = 10
    """Each may use a processor for a while."""
    stopped_by = "ros2_stop"

    def __init__(
        self,
        robot: Robot,
        session: Session,
        programs: Programs,
        text: str,
        inputs: Mapping[str, Any],
        timeout_s: float,
        *,
        is_rehearsal: bool,
    ) -> None:
        super().__init__(owner=session.principal)
        self.moves = (self.id,)  # it may move anything, so a stop and the end of its client end it
        self.at_most_s = timeout_s
        self.programs = programs
        self.record = Record()
        self.streams = Streams()
        self.waits_for = ""
        self._second_began_at, self._calls_in_second = monotonic(), 0
        self._is_rehearsal = is_rehearsal
        self._robot = robot
        self._text = text
        self._inputs = inputs
        self._principal = replace(session.principal, program=self.id)
        self._accepted = session.accepted
        self._losses = robot.graph.losses
        self._functions = {each.name: each for each in programs.functions}
        self._sandbox = Sandbox([*self._functions], stub(programs.functions), self._next_message, self._help)

    async def run(self) -> None:
        """Check the program, run it, and end everything that it has begun."""
        program = rewritten(self._text)
        try:
            async with self._sandbox.open():
                require_sound(await self._sandbox.check(self._text, self._inputs), self._text, [*self._functions])
                if not self._robot.policy.recorded:
                    await require_names(self._robot, self._text)
                self.begun()
                with anyio.move_on_after(self.at_most_s) as time:
                    self.record.value = await self._run(program)
                if time.cancelled_caught:
                    raise Failure("limit", 0, f"it ran longer than its timeout of {self.at_most_s:g} s")
        except Failure as failure:
            self.record.failure = self._over_printed() or failure
        finally:
            with anyio.CancelScope(shield=True):
                await self.streams.close()
                self.record.ended += await self.end_own(self.stop_reason or f"the end of {self.id}")

    async def _run(self, program: Rewritten) -> Any:
        """Run the program and return its value. Raise a `Failure` if its process dies or its bridge is lost."""
        value: Any = None
        failures: list[Exception] = []  # the first one is raised itself, not in an exception group

        async def watch(scope: anyio.CancelScope) -> None:
            while not (lost := self._sandbox.died() or self._bridge_lost()):
                await asyncio.sleep(_LOOK_S)
            failures.append(lost)
            self._sandbox.kill()
            scope.cancel()

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(watch, tasks.cancel_scope)
            try:
                value = await self._sandbox.run(program, self._inputs, self._answer, self._print)
            except Exception as error:  # noqa: BLE001 - raised below
                failures.append(error)
            tasks.cancel_scope.cancel()
        if failures:
            raise failures[0]
        return value

    def _bridge_lost(self) -> Failure | None:
        """Return a failure if the bridge with which the program began is lost: its next commands would restart motion
        that the loss has stopped.
        """
        graph = self._robot.graph
        if graph.losses == self._losses:
            return None
        return Failure("error", 0, f"BridgeLost: {graph.last_loss}")

    def doing(self) -> str:
        """Return the number of the program's commands, and the approval that it waits for."""
        told = "rehearsal" if self._is_rehearsal else counted(self.record.commands, "command")
        return f"{told}; {self.waits_for}" if self.waits_for else told

    async def end_own(self, reason: str = "its program") -> list[str]:
        """End the program's motion. Return the ended motions, in words. Later commands of the program still work."""
        ended = list(await self._robot.stop_owned(self._principal, reason))
        self._accepted = Accepted(self._accepted.epoch, self._robot.stops.now().ends)
        return ended

    async def follow(self, source: Source, wanted: FollowRequest) -> Any:
        """Follow topics. Return the object in the sandbox that represents their messages."""
        return self._sandbox.stream(await self.streams.follow(source, wanted))

    def follow_goal(self, robot: Robot, goal: Goal | None) -> Any:
        """Follow the feedback of a goal. Return the object in the sandbox that represents it."""
        return self._sandbox.stream(self.streams.follow_goal(robot, goal))

    def keep(self, picture: Picture) -> None:
        """Add a picture to the result."""
        if len(self.record.pictures) >= _MOST_PICTURES:
            raise BadInput(f"A program can return at most {_MOST_PICTURES} pictures.")
        self.record.pictures.append(picture)

    # ── calls from the sandbox ─────────────────────────────────────────────────────────────────────────────────

    async def _answer(self, name: str, given: Sequence[Any], named: Mapping[str, Any], line: int) -> Any:
        if lost := self._bridge_lost():
            raise Failure(lost.kind, line, lost.message)
        record, function = self.record, self._functions.get(name)
        if function is None:
            raise BadInput(f"The module robot has no {name}.", did_you_mean(name, [*self._functions]))
        record.calls += 1
        if record.calls > MOST_CALLS:
            raise Failure("limit", line, f"more than {MOST_CALLS} calls of functions")
        await self._in_turn()
        what = f"The argument of robot.{name}"
        arguments = _bound(function, crossed(list(given), what), crossed(dict(named), what))
        acts = function.risk == "act"
        if acts:
            record.commands += 1
            if record.commands > MOST_COMMANDS:
                raise Failure("limit", line, f"more than {MOST_COMMANDS} commands")
        try:
            with called_through(function.tool or "ros2_program_run", f"{self.id}, line {line}"):
                if acts and self._is_rehearsal:
                    return await self._rehearse(function, arguments, line)
                result = await self._perform(function, arguments, line)
        except Stopped as error:
            raise Failure("stopped", line, str(error)) from error
        except RobotError as error:
            if acts:
                record.note(Done(line, name, f"{type(error).__name__}: {error.message}"))
            raise
        if acts:
            record.note(Done(line, name, _in_words(result)))
        record.pictures += getattr(result, "images", ())[: _MOST_PICTURES - len(record.pictures)]
        value = as_json(result) if is_dataclass(result) else result
        return value[function.unwrapped] if function.unwrapped else value

    async def _in_turn(self) -> None:
        """Delay a program that calls so often that others would suffer."""
        now = monotonic()
        if now - self._second_began_at >= 1.0:
            self._second_began_at, self._calls_in_second = now, 0
        self._calls_in_second += 1
        if self._calls_in_second > MOST_CALLS_PER_S:
            await asyncio.sleep(self._second_began_at + 1.0 - now)

    async def _perform(self, function: Function, arguments: Mapping[str, Any], line: int) -> Any:
        """Perform a function. If a person has to approve it, wait for the answer and try again."""
        while True:
            use = _Use(self, self._robot, self._robot.session(self._principal, self._accepted), line)
            try:
                return await function.perform(use, arguments)
            except ApprovalNeeded as needed:
                approvals = self._robot.guard.approvals
                if approvals is None or not needed.request_id:
                    raise
                self.waits_for = f"line {line} waits for a person: {needed.request_id} (ros2-mcp operate)"
                while approvals.is_waiting(needed.request_id):
                    await asyncio.sleep(_ASKED_AGAIN_S)
                self.waits_for = ""

    async def _rehearse(self, function: Function, arguments: Mapping[str, Any], line: int) -> Any:
        """Check a command without carrying it out, and record what would be done. All fields of the result are None."""
        session = self._robot.session(self._principal, self._accepted)
        session.rehearsed = []
        said = ""
        try:
            if function.name != "stop":
                await function.perform(_Use(self, self._robot, session, line), arguments)
        except Rehearsed:
            pass
        except RobotError as error:  # it would fail now; the commands before it might change that
            said = f"would fail now: {error.message}"
        self.record.note(Done(line, function.name, "; ".join(session.rehearsed) or said or "would be done"))
        return dict.fromkeys(getattr(function.signature.return_annotation, "__dataclass_fields__", {}))

    def _help(self, name: str) -> str:
        return help_text(self.programs.functions, name)

    async def _next_message(self, number: int) -> Any:
        self.record.messages += 1
        if self.record.messages > MOST_MESSAGES:
            raise Failure("limit", 0, f"more than {MOST_MESSAGES} messages")
        return await self.streams.next(number)

    def _print(self, text: str) -> None:
        record = self.record
        if record.characters < MOST_PRINTED:
            record.printed.append(text[: MOST_PRINTED - record.characters])
        record.characters += len(text)
        if self._over_printed():
            self._sandbox.kill()

    def _over_printed(self) -> Failure | None:
        if self.record.characters <= _MOST_PRINTED_IN_ALL:
            return None
        return Failure("limit", 0, f"it printed more than {_MOST_PRINTED_IN_ALL} characters")


def _bound(function: Function, given: Sequence[Any], named: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the arguments by name. Raises `BadInput` for arguments that the function does not take."""
    names = [*function.signature.parameters]
    named = {name: value for name, value in named.items() if value is not None or not _means_not_given(function, name)}
    if unknown := [name for name in named if name not in names]:
        hint = did_you_mean(unknown[0], names, f"It has: {', '.join(names)}.")
        raise BadInput(f"robot.{function.name} has no argument {unknown[0]!r}.", hint)
    try:
        bound = function.signature.bind(*given, **named)
    except TypeError as error:
        raise BadInput(f"robot.{function.name}: {error}.") from error
    missing = [name for name, value in bound.arguments.items() if value is None and _means_not_given(function, name)]
    return {name: value for name, value in bound.arguments.items() if name not in missing}


def _means_not_given(function: Function, name: str) -> bool:
    """Return whether None for an argument stands for its default, like null in a call of a tool."""
    each = function.signature.parameters.get(name)
    if each is None or each.default in (each.empty, None):
        return False
    return type(None) not in get_args(each.annotation)


def _in_words(result: Any) -> str:
    """Return the outcome of a command in one line."""
    if hasattr(result, "summary"):
        return (lines_of(result.summary()) or [""])[0][:200]
    return ", ".join(map(str, cast("list[Any]", result)))[:200] if isinstance(result, list) else "done"
