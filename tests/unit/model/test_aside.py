"""Large work leaves the event loop free; small work is done at once."""

from __future__ import annotations

import asyncio
import threading
import time

import pytest

from ros2_mcp.model.aside import LARGE, READING, aside, extent

COMPUTES_S = 0.5


def compute() -> int:
    """Pure Python, which never waits."""
    end = time.monotonic() + COMPUTES_S
    while time.monotonic() < end:
        sum(range(1000))
    return threading.get_ident()


async def test_small_work_is_done_where_it_is_asked_for() -> None:
    assert await aside(LARGE, threading.get_ident) == threading.get_ident()


async def test_the_event_loop_goes_on_while_large_work_is_done() -> None:
    several = [asyncio.ensure_future(aside(LARGE + 1, compute)) for _ in range(3)]
    latest, before = 0.0, time.monotonic()
    while not all(one.done() for one in several):
        await asyncio.sleep(0.01)
        latest, before = max(latest, time.monotonic() - before), time.monotonic()
    assert latest < COMPUTES_S
    assert threading.get_ident() not in [one.result() for one in several]


async def test_who_is_cancelled_does_not_wait_for_large_work() -> None:
    working = asyncio.ensure_future(aside(LARGE + 1, compute))
    await asyncio.sleep(0.05)
    began = time.monotonic()
    working.cancel()
    await asyncio.wait({working})
    assert time.monotonic() - began < COMPUTES_S / 2
    await asyncio.sleep(COMPUTES_S)


async def test_the_turn_of_a_cancelled_caller_ends_when_its_work_does() -> None:
    computing: list[int] = []
    most: list[int] = []

    def one() -> None:
        computing.append(1)
        most.append(len(computing))
        compute()
        computing.pop()

    for _ in range(3):
        working = asyncio.ensure_future(aside(LARGE + 1, one))
        await asyncio.sleep(0.05)
        working.cancel()
    await aside(LARGE + 1, one)
    assert most == [1] * len(most)


async def test_messages_are_read_while_values_are_worked_on() -> None:
    several = [asyncio.ensure_future(aside(LARGE + 1, compute)) for _ in range(3)]
    await aside(LARGE + 1, int, turn=READING)
    assert not any(one.done() for one in several)
    await asyncio.wait(several)


@pytest.mark.parametrize(
    ("value", "is_large"),
    [
        ({"linear": {"x": 0.5}}, False),
        ({"data": [0] * 100}, False),
        ("x" * LARGE, True),
        ({"poses": [{"position": {"x": 1.0}}] * 10_000}, True),
        ([[], [[0] * LARGE]], True),
    ],
)
def test_the_extent_of_a_value_tells_large_ones(value: object, is_large: bool) -> None:
    assert (extent(value) > LARGE) is is_large
