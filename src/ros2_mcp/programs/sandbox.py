"""The sandbox: a process of pydantic-monty for each program, without files, network or its own access to the robot.

When the program calls a function of the module `robot`, the call comes to this process as a question with a line
number, and the program waits for the answer. So no code of a program runs in this process, and a program can only ask.
Its type check, before it runs, uses another process. No process serves two programs, so none affects another one; an
idle server has no such process.
"""

from __future__ import annotations

import asyncio
import importlib.util
import os
import re
import signal
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

import anyio

from ros2_mcp.model.errors import BridgeLost, RobotError
from ros2_mcp.programs.processor import ProcessorLimit, state_of
from ros2_mcp.programs.rewrite import PRELUDE, Rewritten, without_async

if TYPE_CHECKING:
    from pydantic_monty import AsyncMontySession, AsyncSnapshot, ExternalModule, MontyClassProxy, ResourceLimits

T = TypeVar("T")

MODULE = "robot"
"""The module that programs import."""
LONGEST_S = 600.0
"""The longest run of a program, in s."""
MEMORY_BYTES = 64_000_000
"""The memory for a program's values: a hundred thousand messages of a scan's size. The process itself takes 11 MB."""
CPU_S = 60.0
"""Processor time of one program in s, waiting excluded: enough for six hours of reacting at 100 Hz."""
TURN_S = 5.0
"""Processor time between two calls, in s: a program that computes for longer does not react, and occupies a processor
of the robot.
"""
CHECK_S = 5.0
"""Processor time of the type check, in s: that of the longest program takes 0.2 s."""
CHECK_WITHIN_S = 40.0
"""Time limit of the type check by the clock, in s: less than the 50 s of a call. Only a heavily overloaded machine
needs so long.
"""
DEEPEST_CALLS = 200
"""The deepest recursion of functions."""
STREAMS = 16
"""The most topics that a program can follow at the same time: more than a task needs."""
_MOST_SUSPENSIONS = 10_000_000
"""Practically no limit: `Program` counts the calls itself, by what they do."""
_NICE = 5
"""The nice value of a program's process: the server, for which the bridge waits, takes precedence."""
_SHORTEST_SLEEP_S = 0.001
"""The shortest sleep: a program that sleeps for 0 s in a loop would take as much processor time here as in its own
process.
"""
_PROCESS_ID_TRIES = 2000
"""One each millisecond: seconds, also where the machine is busy."""
_SLEEPS = ("system.sleep", "asyncio.sleep", "time.sleep", "sleep")
_GATE = "_checked"
"""The module that the checked text imports first: when it is requested, the program has passed the type check."""
_PLACE = re.compile(r"^main\.py:(\d+):\d+: (\w+)\[([\w-]+)\] (.*)$")


class Failure(Exception):
    """The early end of a program: an error of its own, a limit, a stop, or the death of its process.

    `kind` is `error`, `limit`, `stopped` or `crash`. `line` is the line in the program, 0 if there is none.
    """

    def __init__(self, kind: str, line: int, message: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.line = line
        self.message = message


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding of the type check about a line."""

    line: int
    rule: str
    message: str


Answer = Callable[[str, Sequence[Any], Mapping[str, Any], int], Awaitable[Any]]
"""Answers a call of a function of the module: its name, positional and named arguments, and the line of the call."""


def is_installed() -> bool:
    """Return whether the sandbox is installed: it comes with the extra `programs`."""
    return importlib.util.find_spec("pydantic_monty") is not None


class Sandbox:
    """The process of one program, while it is `open`.

    `names` are the functions of the module `robot`, `stubs` their types. `next_message` returns the next message of a
    stream by its number, None at its end. `help_text` returns the text of `help(…)` for a function by its name, or for
    all functions.
    """

    def __init__(
        self,
        names: Sequence[str],
        stubs: str,
        next_message: Callable[[int], Awaitable[Any]],
        help_text: Callable[[str], str] = "".join,
    ) -> None:
        self._names = names
        self._help_text = help_text
        self._stubs = stubs
        self._next_message = next_message
        self._pid: int | None = None
        self._limit: ProcessorLimit | None = None
        self._last_call = 0
        self._streams: Sequence[MontyClassProxy] = ()

    @asynccontextmanager
    async def open(self) -> AsyncGenerator[Sandbox, None]:
        """Provide a process within this context: a process for the check, then another for the run, each killed at its
        end.
        """
        from pydantic_monty import AsyncMonty

        async with AsyncMonty(
            min_processes=1,
            max_processes=1,
            feed_duration_limit_grace=None,  # these two end the process by the clock, not by its processor time
            turn_duration_limit_grace=None,
        ) as self._pool:
            yield self

    def kill(self) -> None:
        """Kill the process, if it runs."""
        if self._pid is not None:
            with suppress(OSError):
                os.kill(self._pid, signal.SIGKILL if sys.platform != "win32" else signal.SIGTERM)

    def died(self) -> Failure | None:
        """Return why the process cannot go on: it has died, or was stopped (SIGSTOP). None if it runs, or a limit has
        ended it.
        """
        if self._pid is None or (self._limit and self._limit.exceeded is not None):
            return None
        state = state_of(self._pid)
        if state == "T":
            return Failure("crash", 0, "its process was stopped from outside, and ended then")
        if state in ("", "Z", "X"):
            return Failure("crash", 0, "its process has died: it was killed from outside, or for want of memory")
        return None

    async def check(self, text: str, inputs: Mapping[str, Any]) -> list[Finding]:
        """Return the findings of the type check. The program does not run: it is abandoned at its first line.

        Raises:
            Failure: if the check does not end.
        """
        from pydantic_monty import (
            AsyncFunctionSnapshot,
            ExternalModule,
            MontyCrashedError,
            MontyRuntimeError,
            MontyTypingError,
        )

        modules = {MODULE: self._module(), _GATE: ExternalModule({}, stubs="")}
        given = "\n".join(["from typing import Any", *(f"{name}: Any" for name in inputs)])
        gated = f"import {_GATE}, {MODULE}\n{without_async(text)}"
        try:
            async with self._session(
                CHECK_S,
                CHECK_S,
                type_check=True,
                type_check_stubs=given,
                type_check_format="concise",
                external_modules=modules,
            ) as session:
                with anyio.fail_after(CHECK_WITHIN_S):
                    snapshot = await self._turn(session.feed_start(gated, inputs=dict(inputs), print_callback=_dropped))
                    while isinstance(snapshot, AsyncFunctionSnapshot) and snapshot.function_name == "import_stubs":
                        snapshot = await self._turn(snapshot.resume_auto())
        except MontyTypingError as error:
            return _findings(error.display())
        except MontyRuntimeError:
            return []  # the run reports run-time errors
        except MontyCrashedError as error:
            if self._limit and self._limit.exceeded is not None:
                raise Failure("limit", 0, f"its check took more than {CHECK_S:g} s of computing") from None
            raise _crash(error) from None
        except TimeoutError:
            why = f"its check did not end within {CHECK_WITHIN_S:g} s: this machine has too much to do"
            raise Failure("limit", 0, why) from None
        return []

    async def run(
        self, program: Rewritten, inputs: Mapping[str, Any], answer: Answer, printed: Callable[[str], None]
    ) -> Any:
        """Run a program to its end. Return the value of its last line, if that is an expression.

        Raises:
            Failure: if it does not reach its end. A `Failure` of `answer` cannot be caught by the program.
        """
        from pydantic_monty import ExternalModule, MontyCrashedError, MontyError, MontyRuntimeError, MontySyntaxError

        ask = ExternalModule({"next": _never, "help": _never})
        modules = {MODULE: self._module(), "_robot": ask}
        async with self._session(TURN_S, CPU_S, external_modules=modules) as session:
            try:
                self._streams = cast(
                    "Sequence[MontyClassProxy]", await self._turn(session.feed_run(PRELUDE.format(streams=STREAMS)))
                )
                snapshot = await self._turn(
                    session.feed_start(program.text, inputs=dict(inputs), print_callback=partial(_pass_on, printed))
                )
                return await self._drive(snapshot, program, answer)
            except (MontyRuntimeError, MontySyntaxError) as error:
                raise _failure(error, program) from None
            except MontyCrashedError as error:
                if self._limit and self._limit.exceeded is not None:
                    raise self._computed_too_long(self._limit.exceeded) from None
                raise _crash(error) from None
            except MontyError as error:
                raise Failure("error", 0, _first_line(str(error))) from None

    def stream(self, number: int) -> Any:
        """Return the object in the sandbox that represents a stream of messages."""
        return self._streams[number]

    # ── steps of a program ─────────────────────────────────────────────────────────────────────────────────────

    async def _drive(self, snapshot: AsyncSnapshot, program: Rewritten, answer: Answer) -> Any:
        from pydantic_monty import AsyncFunctionSnapshot, MontyComplete

        source = program.text.encode()
        while not isinstance(snapshot, MontyComplete):
            if not isinstance(snapshot, AsyncFunctionSnapshot):
                snapshot = await self._turn(snapshot.resume_auto())
                continue
            name = str(snapshot.function_name)
            if snapshot.is_os_function:
                snapshot = await self._system(snapshot, name)
                continue
            try:
                if name == "_robot.next":
                    value = await self._next_message(int(snapshot.args[0]))
                elif name == "_robot.help":
                    about = snapshot.args[0]
                    value = self._help_text(about.removeprefix(f"{MODULE}.") if isinstance(about, str) else "")
                else:
                    line = program.line(source.count(b"\n", 0, snapshot.position.start) + 1)
                    self._last_call = line
                    value = await answer(name.removeprefix(f"{MODULE}."), snapshot.args, snapshot.kwargs, line)
            except BridgeLost as error:  # the program must not catch it: its next call would restart motion
                raise Failure("error", self._last_call, f"BridgeLost: {error.message}") from error
            except RobotError as error:
                snapshot = await self._turn(snapshot.resume({"exception": in_program(error)}))
                continue
            snapshot = await self._turn(snapshot.resume({"return_value": value}))
        return snapshot.output

    async def _system(self, snapshot: Any, name: str) -> AsyncSnapshot:
        """Answer a system call of the sandbox: only imports and sleeping are supported."""
        if name.startswith("import"):
            return await self._turn(snapshot.resume_auto())
        if name in _SLEEPS:
            seconds = snapshot.args[0] if snapshot.args else 0.0
            with suppress(TypeError, ValueError, OverflowError):  # the sandbox reports an invalid time itself
                await asyncio.sleep(max(_SHORTEST_SLEEP_S, min(float(seconds), LONGEST_S)))
            given = snapshot.args[1] if len(snapshot.args) > 1 else None
            return await self._turn(snapshot.resume({"return_value": given}))
        return await self._turn(snapshot.resume_not_handled())

    async def _turn(self, step: Awaitable[T]) -> T:
        """Await a step in which the sandbox computes, within the limits of its processor time."""
        return await (self._limit.turn(step) if self._limit else step)

    def _computed_too_long(self, limit_s: float) -> Failure:
        if limit_s != TURN_S:
            return Failure("limit", 0, f"more than {limit_s:g} s of computing")
        since = f"after line {self._last_call}" if self._last_call else "before its first one"
        return Failure("limit", 0, f"more than {limit_s:g} s of computing without a call, {since}")

    def _module(self) -> ExternalModule:
        from pydantic_monty import ExternalModule

        return ExternalModule(dict.fromkeys(self._names, _never), stubs=self._stubs)

    @asynccontextmanager
    async def _session(self, turn_s: float, all_s: float, **options: Any) -> AsyncGenerator[AsyncMontySession, None]:
        """A session with limits of processor time, in s. The sandbox's own limits are not used: they go by the clock,
        even while the machine does not run its process.

        At the end the process is killed first: otherwise closing would wait for an answer, which a stopped process
        never gives. The next session begins with a new process, within 4 ms.
        """
        limits: ResourceLimits = {
            "max_memory": MEMORY_BYTES,
            "max_recursion_depth": DEEPEST_CALLS,
            "max_suspensions": _MOST_SUSPENSIONS,
        }
        async with self._pool.checkout(limits=limits, **options) as session:
            self._note_process(await _process_id(session), turn_s, all_s)
            try:
                yield session
            finally:
                self.kill()
                self._pid = None

    def _note_process(self, pid: int, turn_s: float, all_s: float) -> None:
        self._pid = pid
        self._limit = ProcessorLimit(pid, turn_s, all_s, self.kill)
        if sys.platform != "win32":
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, pid, _NICE)


async def _process_id(session: AsyncMontySession) -> int:
    """Return the process id of a session's worker. The session does not know it while a thread of its pool still holds
    the session's lock, as it does for a moment after the checkout; a program whose process is unknown would run without
    limits.

    Raises:
        Failure: if it stays unknown.
    """
    for _ in range(_PROCESS_ID_TRIES):
        if (pid := session.worker_pid) is not None:
            return pid
        await asyncio.sleep(_SHORTEST_SLEEP_S)
    raise Failure("crash", 0, "the process of the program is unknown, so its limits cannot be enforced: run it again")


def in_program(error: RobotError) -> Exception:
    """Return the Python exception that a program can catch, with the text of the error."""
    from ros2_mcp.model import errors

    kinds: Sequence[tuple[type[RobotError], type[Exception]]] = (
        (errors.BadInput, ValueError),
        (errors.NotFound, LookupError),
        (errors.NoTransform, LookupError),
        (errors.TimedOut, TimeoutError),
        (errors.Refused, PermissionError),
    )
    kind = next((plain for own, plain in kinds if isinstance(error, own)), RuntimeError)
    return kind(str(error))


def _never(*_: Any, **__: Any) -> None:
    """Never called: it represents a function in the module, whose calls `_drive` answers."""
    raise AssertionError("a function of the sandbox was called in this process")


def _dropped(_stream: str, _text: str) -> None:
    """Drop the output of a program that is only checked."""


def _pass_on(printed: Callable[[str], None], _stream: str, text: str) -> None:
    printed(text)


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0][:300]


def _crash(error: Exception) -> Failure:
    return Failure("crash", 0, f"its process has died: {_first_line(str(error))}")


def _failure(error: Any, program: Rewritten) -> Failure:
    """Return the failure of a program that ended early, with the line in its original text."""
    message = _first_line(error.display("type-msg"))
    frames = error.traceback()
    own = [frame for frame in frames if frame.filename != "<python-input-0>"]
    line = program.line(own[-1].line) if own else 0
    is_limit = message.startswith(("MemoryError", "RecursionError")) or " limit exceeded" in message
    return Failure("limit" if is_limit else "error", line, message)


def _findings(text: str) -> list[Finding]:
    """Return the findings of the type check. Lines count from 1, without the line that was put before the program."""
    found = [_PLACE.match(line) for line in text.splitlines()]
    return [Finding(int(one[1]) - 1, one[3], one[4]) for one in found if one and one[2] == "error"]
