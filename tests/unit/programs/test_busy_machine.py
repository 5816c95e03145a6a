"""A program is judged by the processor time that it used: what a busy machine does not run is not ended for that.

A stopped process (SIGSTOP) stands for one that gets no processor: of the two, only the clock goes on.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pydantic_monty", reason="needs the extra programs")

from ros2_mcp.programs import sandbox
from ros2_mcp.programs.processor import processor_s
from ros2_mcp.programs.rewrite import rewritten

STARVED_S = 2.5
"""The check was ended after 2 s on the clock."""
SHORT_S = 0.2
"""Of computing, so that the tests need not wait for seconds of it; it was ended 1 s later on the clock."""
SHORT_STARVED_S = 1.6
NEVER_S = 1e9

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells the processor time of others")


def children() -> set[int]:
    """The processes that any thread of this one has started."""
    return {int(pid) for each in Path("/proc/self/task").glob("*/children") for pid in each.read_text().split()}


@asynccontextmanager
async def opened() -> AsyncIterator[tuple[sandbox.Sandbox, int]]:
    """A sandbox, and its process."""

    async def no_message(_number: int) -> None: ...

    before = children()
    async with sandbox.Sandbox(["topics"], "def topics() -> int: ...\n", no_message).open() as box:
        (pid,) = children() - before
        yield box, pid


async def run(box: sandbox.Sandbox, *lines: str) -> Any:
    async def answer(_name: str, _given: Sequence[Any], _named: Any, _line: int) -> int:
        return 7

    return await box.run(rewritten("\n".join(["import robot", *lines])), {}, answer, lambda _text: None)


@pytest.fixture
def not_run_for(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """The process is stopped for that time where its priority is set: before it begins with a check or a program."""

    def set_to(seconds: float) -> None:
        def stop(_which: int, pid: int, _nice: int) -> None:
            os.kill(pid, signal.SIGSTOP)
            if seconds < NEVER_S:
                asyncio.get_running_loop().call_later(seconds, os.kill, pid, signal.SIGCONT)

        monkeypatch.setattr(os, "setpriority", stop)

    return set_to


async def test_the_check_of_a_program_that_is_not_run_for_seconds_comes_to_its_end(
    not_run_for: Callable[[float], None],
) -> None:
    not_run_for(STARVED_S)
    async with opened() as (box, _):
        assert [finding.line for finding in await box.check("import robot\nrobot.nothing()", {})] == [2]


async def test_a_program_that_is_not_run_for_seconds_goes_on(
    not_run_for: Callable[[float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sandbox, "TURN_S", SHORT_S)
    not_run_for(SHORT_STARVED_S)
    async with opened() as (box, _):
        assert await run(box, "robot.topics() + 1") == 8


async def test_a_program_that_computes_too_long_between_two_calls_is_ended_and_told_where(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sandbox, "TURN_S", SHORT_S)
    for lines, place in (
        (["robot.topics()", "while True:", "    pass"], "after line 2"),
        (["while True:", "    pass"], "before its first one"),
    ):
        async with opened() as (box, _):
            with pytest.raises(sandbox.Failure) as failed:
                await run(box, *lines)
        assert failed.value.kind == "limit"
        assert failed.value.message == f"more than {SHORT_S} s of computing without a call, {place}"


async def test_a_program_that_computes_too_long_in_all_its_turns_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sandbox, "CPU_S", SHORT_S)
    async with opened() as (box, _):
        with pytest.raises(sandbox.Failure, match=rf"more than {SHORT_S} s of computing$"):
            await run(box, "while True:", "    for number in range(1000):", "        robot.topics()")


async def test_a_check_that_does_not_end_is_given_up(
    not_run_for: Callable[[float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    not_run_for(NEVER_S)
    monkeypatch.setattr(sandbox, "CHECK_WITHIN_S", 0.05)
    async with opened() as (box, _):
        with pytest.raises(sandbox.Failure, match="this machine has too much to do"):
            await box.check("1", {})


async def test_a_check_that_computes_too_long_is_ended(
    not_run_for: Callable[[float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is allowed at all, and the first look comes before its end, since it is not run."""
    not_run_for(NEVER_S)
    monkeypatch.setattr(sandbox, "CHECK_S", 0.0)
    async with opened() as (box, _):
        with pytest.raises(sandbox.Failure, match="more than 0 s of computing"):
            await box.check("1", {})


async def test_a_program_whose_process_dies_says_so(not_run_for: Callable[[float], None]) -> None:
    not_run_for(NEVER_S)
    async with opened() as (box, pid):
        asyncio.get_running_loop().call_later(0.05, os.kill, pid, signal.SIGKILL)
        with pytest.raises(sandbox.Failure, match="its process has died") as failed:
            await run(box, "robot.topics()")
        assert failed.value.kind == "crash"


class StillHeld:
    """A session that a thread of its pool holds for a while, as `worker_pid` documents it: the id is not known then."""

    def __init__(self, unknown: int) -> None:
        self._unknown = unknown

    @property
    def worker_pid(self) -> int | None:
        self._unknown -= 1
        return None if self._unknown >= 0 else 4711


async def test_no_program_runs_while_its_process_is_unknown_for_it_would_have_no_limits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sandbox, "_PROCESS_ID_TRIES", 5)
    assert await sandbox._process_id(StillHeld(4)) == 4711
    with pytest.raises(sandbox.Failure, match="its limits cannot be enforced"):
        await sandbox._process_id(StillHeld(5))


def test_the_processor_time_of_a_process_does_not_go_on_while_it_waits() -> None:
    pid = os.fork()
    if pid == 0:
        while True:
            signal.pause()
    try:
        os.kill(pid, signal.SIGSTOP)
        os.waitpid(pid, os.WUNTRACED)
        before = processor_s(pid)
        sum(range(1_000_000))  # this process computes meanwhile
        assert processor_s(pid) == before
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    with pytest.raises(OSError, match="Invalid argument"):
        processor_s(pid)
