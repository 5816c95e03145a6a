"""The sandbox: a process of pydantic-monty for each program, which has no files, no network and no robot of its own.

The program runs there until it calls a function of the module `robot`; that call comes here, as a question with a line,
and the program stands still until it is answered. So nothing of a program runs in this process, and it can do nothing
but ask. One process for one program: what one has done to it, no other meets, and an idle server has none.
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
from typing import TYPE_CHECKING, Any, cast

from ros2_mcp.model.errors import RobotError
from ros2_mcp.programs.rewrite import PRELUDE, Rewritten, without_async

if TYPE_CHECKING:
    from pydantic_monty import AsyncMontySession, AsyncSnapshot, ExternalModule, MontyClassProxy, ResourceLimits

MODULE = "robot"
"""What programs import."""
LONGEST_S = 600.0
"""No program runs longer."""
MEMORY_BYTES = 64_000_000
"""Of the program's values: a hundred thousand messages of a scan's size; the process itself takes 11 MB."""
CPU_S = 60.0
"""Of computing in one program, waiting not counted: six hours of reacting to 100 Hz take less."""
TURN_S = 5.0
"""Of computing between two calls: what computes longer reacts to nothing, and holds a processor of the robot."""
DEEPEST_CALLS = 200
"""Functions that have called each other."""
STREAMS = 16
"""Topics that a program can follow one beside the other: more than a task has."""
_MOST_SUSPENSIONS = 10_000_000
"""The sandbox's own count of calls is not used: `Limits` of the program counts what each call is."""
_NICE = 5
"""How far a program stands back behind the server, which the bridge waits for, where both want the processor."""
_CHECK_S = 1.0
"""Of computing before the first import in a program that is checked and not run; none of it matters."""
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
    message of a stream by its number, None at its end.
    """

    def __init__(self, names: Sequence[str], stubs: str, next_message: Callable[[int], Awaitable[Any]]) -> None:
        self._names = names
        self._stubs = stubs
        self._next_message = next_message
        self._pid: int | None = None
        self._streams: Sequence[MontyClassProxy] = ()

    @asynccontextmanager
    async def open(self) -> AsyncGenerator[Sandbox, None]:
        """While it is entered there is the process; at the end it is killed, whatever it does then."""
        from pydantic_monty import AsyncMonty

        async with AsyncMonty(min_processes=1, max_processes=1, max_checkouts_per_worker=1000) as self._pool:
            try:
                yield self
            finally:
                self.kill()

    def kill(self) -> None:
        """Ends the process at once, if it runs."""
        if self._pid is not None:
            with suppress(OSError):
                os.kill(self._pid, signal.SIGKILL if sys.platform != "win32" else signal.SIGTERM)

    async def check(self, text: str, inputs: Mapping[str, Any]) -> list[Finding]:
        """What the check of types says of a program, which does not run: it is let go at its first line."""
        from pydantic_monty import AsyncFunctionSnapshot, ExternalModule, MontyRuntimeError, MontyTypingError

        modules = {MODULE: self._module(), _GATE: ExternalModule({}, stubs="")}
        limits = self._limits(_CHECK_S)
        given = "\n".join(["from typing import Any", *(f"{name}: Any" for name in inputs)])
        async with self._pool.checkout(
            limits=limits,
            type_check=True,
            type_check_stubs=given,
            type_check_format="concise",
            external_modules=modules,
        ) as session:
            self._note_process(session)
            gated = f"import {_GATE}\n{without_async(text)}"
            try:
                snapshot = await session.feed_start(gated, inputs=dict(inputs), print_callback=_dropped)
                while isinstance(snapshot, AsyncFunctionSnapshot) and snapshot.function_name == "import_stubs":
                    snapshot = await snapshot.resume_auto()
            except MontyTypingError as error:
                return _findings(error.display())
            except MontyRuntimeError:
                return []  # what is wrong at run time is said there
            return []

    async def run(
        self, program: Rewritten, inputs: Mapping[str, Any], answer: Answer, printed: Callable[[str], None]
    ) -> Any:
        """Runs a program to its end; its value is that of its last line, if that is an expression.

        Raises:
            Failure: if it does not come to its end; also as `answer` raises it, which nothing in the program catches.
        """
        from pydantic_monty import ExternalModule, MontyCrashedError, MontyError, MontyRuntimeError, MontySyntaxError

        ask = ExternalModule({"next": _never})
        modules = {MODULE: self._module(), "_robot": ask}
        async with self._pool.checkout(limits=self._limits(CPU_S), external_modules=modules) as session:
            self._note_process(session)
            try:
                self._streams = cast(
                    "Sequence[MontyClassProxy]", await session.feed_run(PRELUDE.format(streams=STREAMS))
                )
                snapshot = await session.feed_start(
                    program.text, inputs=dict(inputs), print_callback=partial(_pass_on, printed)
                )
                return await self._drive(snapshot, program, answer)
            except (MontyRuntimeError, MontySyntaxError) as error:
                raise _failure(error, program) from None
            except MontyCrashedError as error:
                if getattr(error, "timed_out", False) or "time" in str(error):
                    raise Failure("limit", 0, f"more than {TURN_S:g} s of computing without a call") from None
                raise Failure("crash", 0, f"its process has died: {_first_line(str(error))}") from None
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
                snapshot = await snapshot.resume_auto()
                continue
            name = str(snapshot.function_name)
            if snapshot.is_os_function:
                snapshot = await self._system(snapshot, name)
                continue
            try:
                if name == "_robot.next":
                    value = await self._next_message(int(snapshot.args[0]))
                else:
                    line = program.line(source.count(b"\n", 0, snapshot.position.start) + 1)
                    value = await answer(name.removeprefix(f"{MODULE}."), snapshot.args, snapshot.kwargs, line)
            except RobotError as error:
                snapshot = await snapshot.resume({"exception": in_program(error)})
                continue
            snapshot = await snapshot.resume({"return_value": value})
        return snapshot.output

    async def _system(self, snapshot: Any, name: str) -> AsyncSnapshot:
        """What the sandbox asks its host for: imports and waiting; all else it has not."""
        if name.startswith("import"):
            return await snapshot.resume_auto()
        if name in _SLEEPS:
            seconds = snapshot.args[0] if snapshot.args else 0.0
            with suppress(TypeError, ValueError, OverflowError):  # it says itself what is no time
                await asyncio.sleep(max(_SHORTEST_SLEEP_S, min(float(seconds), LONGEST_S)))
            return await snapshot.resume({"return_value": snapshot.args[1] if len(snapshot.args) > 1 else None})
        return await snapshot.resume_not_handled()

    def _module(self) -> ExternalModule:
        from pydantic_monty import ExternalModule

        return ExternalModule(dict.fromkeys(self._names, _never), stubs=self._stubs)

    def _limits(self, cpu_s: float) -> ResourceLimits:
        return {
            "max_feed_duration_secs": cpu_s,
            "max_turn_duration_secs": min(cpu_s, TURN_S),
            "max_memory": MEMORY_BYTES,
            "max_recursion_depth": DEEPEST_CALLS,
            "max_suspensions": _MOST_SUSPENSIONS,
        }

    def _note_process(self, session: AsyncMontySession) -> None:
        self._pid = session.worker_pid
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
