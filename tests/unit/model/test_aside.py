"""Large work leaves the event loop free; small work is done at once."""

from __future__ import annotations

import asyncio
import threading

import pytest

from ros2_mcp.model.aside import LARGE, READING, aside, extent

PATIENCE_S = 20.0


def compute() -> int:
    """Pure Python, which never waits: some tenths of a second."""
    for _ in range(10_000):
        sum(range(1000))
    return threading.get_ident()


class Held:
    """Work that goes on until it is released."""

    def __init__(self) -> None:
        self.begun, self.released, self.ended = threading.Event(), threading.Event(), threading.Event()

    def __call__(self) -> None:
        self.begun.set()
        assert self.released.wait(PATIENCE_S)
        self.ended.set()


async def test_small_work_is_done_where_it_is_asked_for() -> None:
    assert await aside(LARGE, threading.get_ident) == threading.get_ident()


async def test_the_event_loop_goes_on_while_large_work_is_done() -> None:
    several = [asyncio.ensure_future(aside(LARGE + 1, compute)) for _ in range(3)]
    turns = 0
    while not all(one.done() for one in several):
        await asyncio.sleep(0.001)
        turns += 1
    assert turns > 10, "had it been done on the loop's thread, there would be one for each"
    assert threading.get_ident() not in [one.result() for one in several]


async def test_who_is_cancelled_does_not_wait_for_large_work() -> None:
    work = Held()
    working = asyncio.ensure_future(aside(LARGE + 1, work))
    await asyncio.to_thread(work.begun.wait, PATIENCE_S)
    working.cancel()
    await asyncio.wait({working})
    assert not work.ended.is_set()
    work.released.set()
    assert await asyncio.to_thread(work.ended.wait, PATIENCE_S)


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
    works = [Held() for _ in range(3)]
    several = [asyncio.ensure_future(aside(LARGE + 1, work)) for work in works]
    await aside(LARGE + 1, int, turn=READING)
    assert not any(one.done() for one in several)
    for work in works:
        work.released.set()
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
