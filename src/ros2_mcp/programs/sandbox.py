"""The sandbox: a process of pydantic-monty for each program, which has no files, no network and no robot of its own.

The program runs there until it calls a function of the module `robot`; that call comes here, as a question with a line,
and the program stands still until it is answered. So nothing of a program runs in this process, and it can do nothing
but ask. Its check, before it, has another process. No process serves two programs: what one has done to it, no other
meets, and an idle server has none.
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
"""What programs import."""
LONGEST_S = 600.0
"""No program runs longer."""
MEMORY_BYTES = 64_000_000
"""Of the program's values: a hundred thousand messages of a scan's size; the process itself takes 11 MB."""
CPU_S = 60.0
"""Processor time of one program, waiting not counted: six hours of reacting to 100 Hz take less."""
TURN_S = 5.0
"""Processor time between two calls: what computes longer reacts to nothing, and holds a processor of the robot."""
CHECK_S = 5.0
"""Processor time of the check of types: that of the longest program takes 0.2 s."""
CHECK_WITHIN_S = 40.0
"""On the clock: below the 50 s of a call. Only a machine with far more work than processors needs so long."""
DEEPEST_CALLS = 200
"""Functions that have called each other."""
STREAMS = 16
"""Topics that a program can follow one beside the other: more than a task has."""
_MOST_SUSPENSIONS = 10_000_000
"""The sandbox's own count of calls is not used: `Limits` of the program counts what each call is."""
_NICE = 5
"""How far a program stands back behind the server, which the bridge waits for, where both want the processor."""
_SHORTEST_SLEEP_S = 0.001
"""A program that sleeps for no time in a circle would take as much of the server's processor as of its own."""
_SLEEPS = ("system.sleep", "asyncio.sleep", "time.sleep", "sleep")
_GATE = "_checked"
"""The module that the text is made to import first: who asks for it has passed the check."""
_PLACE = re.compile(r"^main\.py:(\d+):\d+: (\w+)\[([\w-]+)\] (.*)$")


class Failure(Exception):
    """A program that has not come to its end: an error of its own, a limit, a stop, or the death of its process.

    `kind` is `error`, `limit`, `stopped` or `crash`; `line` that of the program, 0 where there is none.
    """

    def __init__(self, kind: str, line: int, message: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.line = line
        self.message = message


@dataclass(frozen=True, slots=True)
class Finding:
    """What the check of types says of a line."""

    line: int
    rule: str
    message: str


Answer = Callable[[str, Sequence[Any], Mapping[str, Any], int], Awaitable[Any]]
"""Answers a call of a function of the module: its name, positional and named arguments, and the line that calls."""


def is_installed() -> bool:
    """Whether there is a sandbox: it comes with the extra `programs`."""
    return importlib.util.find_spec("pydantic_monty") is not None


class Sandbox:
    """The process of one program, while it is `open`.

    `names` are the functions of the module `robot`, `stubs` says of what types they are. `next_message` gives the next
    message of a stream by its number, None at its end; `help_text` what `help(…)` prints of a function by its name, or
    of all of them.
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
        """While it is entered there is a process, anew for check and run; each is killed at its end."""
        from pydantic_monty import AsyncMonty

        async with AsyncMonty(
            min_processes=1,
            max_processes=1,
            feed_duration_limit_grace=None,  # these two end the process by the clock, however little it has computed
            turn_duration_limit_grace=None,
        ) as self._pool:
            yield self

    def kill(self) -> None:
        """Ends the process at once, if it runs."""
        if self._pid is not None:
            with suppress(OSError):
                os.kill(self._pid, signal.SIGKILL if sys.platform != "win32" else signal.SIGTERM)

    def died(self) -> Failure | None:
        """Why its process cannot go on, where nothing here has ended it: it has died, or was stopped (SIGSTOP)."""
        if self._pid is None or (self._limit and self._limit.exceeded is not None):
            return None
        state = state_of(self._pid)
        if state == "T":
            return Failure("crash", 0, "its process was stopped from outside, and ended then")
        if state in ("", "Z", "X"):
            return Failure("crash", 0, "its process has died: it was killed from outside, or for want of memory")
        return None

    async def check(self, text: str, inputs: Mapping[str, Any]) -> list[Finding]:
        """What the check of types says of a program, which does not run: it is let go at its first line.

        Raises:
            Failure: if it does not come to its end.
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
            return []  # what is wrong at run time is said there
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
        """Runs a program to its end; its value is that of its last line, if that is an expression.

        Raises:
            Failure: if it does not come to its end; also as `answer` raises it, which nothing in the program catches.
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
        """What stands for a stream of messages in the sandbox."""
        return self._streams[number]

    # ── one step after the other ───────────────────────────────────────────────────────────────────────────────

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
            except BridgeLost as error:  # nothing in the program catches it: its next call would start to move again
                raise Failure("error", self._last_call, f"BridgeLost: {error.message}") from error
            except RobotError as error:
                snapshot = await self._turn(snapshot.resume({"exception": in_program(error)}))
                continue
            snapshot = await self._turn(snapshot.resume({"return_value": value}))
        return snapshot.output

    async def _system(self, snapshot: Any, name: str) -> AsyncSnapshot:
        """What the sandbox asks its host for: imports and waiting; all else it has not."""
        if name.startswith("import"):
            return await self._turn(snapshot.resume_auto())
        if name in _SLEEPS:
            seconds = snapshot.args[0] if snapshot.args else 0.0
            with suppress(TypeError, ValueError, OverflowError):  # it says itself what is no time
                await asyncio.sleep(max(_SHORTEST_SLEEP_S, min(float(seconds), LONGEST_S)))
            given = snapshot.args[1] if len(snapshot.args) > 1 else None
            return await self._turn(snapshot.resume({"return_value": given}))
        return await self._turn(snapshot.resume_not_handled())

    async def _turn(self, step: Awaitable[T]) -> T:
        """The result of a step in which the sandbox computes, within the limits of its processor time."""
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
        """A session with its limits of processor time (s). The limits of the sandbox go by the clock, also while the
        machine does not run its process: they are not used.

        The process is killed first at the end, which else waits for an answer of it: one that is not run gives none.
        The next session begins with a new one, after 4 ms.
        """
        limits: ResourceLimits = {
            "max_memory": MEMORY_BYTES,
            "max_recursion_depth": DEEPEST_CALLS,
            "max_suspensions": _MOST_SUSPENSIONS,
        }
        async with self._pool.checkout(limits=limits, **options) as session:
            self._note_process(session, turn_s, all_s)
            try:
                yield session
            finally:
                self.kill()
                self._pid = None

    def _note_process(self, session: AsyncMontySession, turn_s: float, all_s: float) -> None:
        self._pid = session.worker_pid
        self._limit = None if self._pid is None else ProcessorLimit(self._pid, turn_s, all_s, self.kill)
        if self._pid is not None and sys.platform != "win32":
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, self._pid, _NICE)


def in_program(error: RobotError) -> Exception:
    """The exception of Python that a program can catch, with the words of the error and its kind."""
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
    """Stands for a function in the module; each call of one is answered by `_drive`, and never comes here."""
    raise AssertionError("a function of the sandbox was called in this process")


def _dropped(_stream: str, _text: str) -> None:
    """What a program prints that is only checked."""


def _pass_on(printed: Callable[[str], None], _stream: str, text: str) -> None:
    printed(text)


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0][:300]


def _crash(error: Exception) -> Failure:
    return Failure("crash", 0, f"its process has died: {_first_line(str(error))}")


def _failure(error: Any, program: Rewritten) -> Failure:
    """Why a program ended early, with its own line."""
    message = _first_line(error.display("type-msg"))
    frames = error.traceback()
    own = [frame for frame in frames if frame.filename != "<python-input-0>"]
    line = program.line(own[-1].line) if own else 0
    is_limit = message.startswith(("MemoryError", "RecursionError")) or " limit exceeded" in message
    return Failure("limit" if is_limit else "error", line, message)


def _findings(text: str) -> list[Finding]:
    """The lines of the check; those of the program count from 1, without the one that was put before it."""
    found = [_PLACE.match(line) for line in text.splitlines()]
    return [Finding(int(one[1]) - 1, one[3], one[4]) for one in found if one and one[2] == "error"]
