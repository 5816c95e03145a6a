"""Loops over messages are written anew for the sandbox, and errors are told by the lines of the original."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from ros2_mcp.model.errors import BadInput
from ros2_mcp.programs.rewrite import PRELUDE, rewritten

LOOP = """\
import robot
async for m in robot.messages("/scan",
                              fields=["ranges"]):
    # a remark
    if m["ranges"]:
        break
print("done")
"""


def test_each_line_of_a_rewritten_program_leads_to_that_of_the_original() -> None:
    program = rewritten(LOOP)
    compile(program.text, "main.py", "exec")
    original = LOOP.splitlines()
    for number, line in enumerate(program.text.splitlines(), 1):
        if line.strip() in map(str.strip, original):
            assert original[program.line(number) - 1].strip() == line.strip()


def test_a_program_that_follows_no_messages_stays_as_it_is() -> None:
    text = "for i in range(3):\n    print([x for x in (1, 2)])\n"
    assert rewritten(text).text == text


def test_await_before_a_function_of_the_robot_is_left_out() -> None:
    assert rewritten("await robot.topics()\n").text == "robot.topics()\n"


@pytest.mark.parametrize("text", ["x = (", "if x:\n  a\n b\n", "(" * 100_000, "x = '''"])
def test_what_is_no_python_is_refused_with_its_line(text: str) -> None:
    with pytest.raises(BadInput, match=r"line \d+"):
        rewritten(text)


def result_of(text: str, count: int = 3) -> Any:
    """What a program gives in the sandbox, where each topic has so many messages."""
    sandbox = pytest.importorskip("pydantic_monty", reason="needs the extra `programs`")
    left, streams = list(range(count)), list[Any]()
    modules = {
        "_robot": sandbox.ExternalModule({"next": lambda _: {"n": left.pop(0)} if left else None}),
        "robot": sandbox.ExternalModule({"messages": lambda *_: streams[0][0]}),
    }

    async def run() -> Any:
        async with sandbox.AsyncMonty() as pool, pool.checkout(external_modules=modules) as session:
            streams.append(await session.feed_run(PRELUDE.format(streams=1)))
            return await session.feed_run(rewritten(text).text)

    return asyncio.run(run())


def test_a_loop_sees_each_message_also_where_its_body_stands_on_the_same_line() -> None:
    assert result_of("import robot\na = []\nfor m in robot.messages('/t'): a.append(m['n']); a.append(9)\na") == [
        *(0, 9, 1, 9, 2, 9)
    ]


def test_a_loop_that_is_not_broken_off_comes_to_its_else() -> None:
    loop = "import robot\na = ''\nfor m in robot.messages('/t'):\n    if m['n'] == {}: break\nelse:\n    a = 'else'\na"
    assert (result_of(loop.format(7)), result_of(loop.format(1))) == ("else", "")


def test_a_comprehension_sees_all_messages() -> None:
    assert result_of("import robot\n[m['n'] for m in robot.messages('/t') if m['n']]") == [1, 2]
