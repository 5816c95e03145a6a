"""Hostile programs in the sandbox, without a robot: some here, every one in full."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pydantic_monty", reason="needs the extra programs")

from ros2_mcp.model.errors import BadInput
from ros2_mcp.programs import sandbox
from ros2_mcp.programs.crossing import crossed
from ros2_mcp.programs.rewrite import rewritten
from ros2_mcp.programs.run import ProgramError, Ran
from support.agent import FULL
from support.hostile_programs import PROGRAMS, Trap, trap
from support.outlets import FORGED

MOST = 300
"""Of the issue."""
EVERY = 1 if FULL else 40
CPU_S = 0.2
"""Of computing, where a program of a user has a minute."""
TIME_S = 5.0
"""Then it is ended, as by the time that every program has: those that only wait."""
FUNCTIONS = ("topics", "latest", "messages", "publish", "stop", "picture", "call", "drive", "wait_until")

pytestmark = pytest.mark.timeout(1500 if FULL else 120)


@pytest.fixture
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Trap]:
    with trap(tmp_path) as host:
        for name, value in host.environment().items():
            monkeypatch.setenv(name, value)
        yield host


async def outcome(text: str, inputs: dict[str, Any]) -> str:
    """All that a program says, and what becomes of it; it is ended after a number of calls or characters."""
    said: list[str] = []
    left = [300, 100_000]

    async def answer(name: str, given: Any, named: Any, line: int) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise sandbox.Failure("limit", line, "calls")
        said.append(str(crossed([name, *given, dict(named)], "An argument", for_json=True))[:1000])

    async def next_message(number: int) -> Any:
        return await answer("next", (number,), {}, 0)

    def printed(text: str) -> None:
        left[1] -= len(text)
        said.append(text[:1000])
        if left[1] < 0:
            box.kill()

    box = sandbox.Sandbox(FUNCTIONS, "", next_message)
    async with box.open():
        try:
            value = await asyncio.wait_for(box.run(rewritten(text), inputs, answer, printed), TIME_S)
            said.append(str(crossed(value, "The value", for_json=True))[:100_000])
        except (sandbox.Failure, BadInput) as error:
            said.append(str(error))
        except asyncio.TimeoutError:
            said.append("its time is over")
    return "\n".join(said)


def test_there_are_enough_hostile_programs_and_no_two_are_alike() -> None:
    assert len(PROGRAMS) >= MOST
    assert len(set(PROGRAMS.values())) == len(PROGRAMS)


def test_a_trap_tells_what_reached_the_host(tmp_path: Path) -> None:
    with trap(tmp_path) as host:
        assert host.sprung("") == []
        assert host.sprung(f"it is {host.secret}") == ["said the secret"]
        (tmp_path / "marker").touch()
        assert host.sprung("") == ["changed the folder"]


@pytest.mark.parametrize("name", list(PROGRAMS)[::EVERY])
async def test_a_hostile_program_reaches_nothing_and_ends(
    host: Trap, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """As it is; and as a text that the program is given and executes, which no check has seen."""
    monkeypatch.setattr(sandbox, "CPU_S", CPU_S)
    text = host.set_for(PROGRAMS[name], os.getpid())
    said = ""
    for program, inputs in ((text, {}), ("exec(own)", {"own": text})):
        try:
            said += await outcome(program, inputs)
        except BadInput as error:
            said += str(error)
    assert host.sprung(said) == []


def test_what_a_program_fails_with_is_not_told_as_the_servers_own_words() -> None:
    error = ProgramError(2, "raise ValueError(text)", f"ValueError: {FORGED}")
    ran = Ran(outcome="failed", error=error, elapsed_s=1.0, calls=1, program_id="program_1")
    assert ran.summary() == f"failed at line 2: «ValueError: {FORGED}» after 1 s, 1 call, 0 commands."
