"""Finding the first message that meets a condition, in a source that is no robot."""

from __future__ import annotations

import pytest

from ros2_mcp.model.errors import BadInput
from ros2_mcp.ops.measure.wait_until import wait_until
from support.made_windows import Make, Recorded

FLOAT = "std_msgs/msg/Float64"


def ramp(window: Make) -> Recorded:
    return Recorded([window("/x", FLOAT, [(i / 1000, {"data": float(i)}) for i in range(1000)])])


async def test_the_first_message_that_meets_the_condition_is_returned(window: Make) -> None:
    found = await wait_until(ramp(window), "/x", "data > 400")
    assert (found.met, found.looked_at, found.message, dict(found.values)) == (
        True,
        402,
        {"data": 401.0},
        {"data": 401.0},
    )
    assert found.at == "2023-11-14T22:13:20.401000Z"
    assert "is met" in found.summary()


async def test_the_last_seen_is_returned_if_none_meets_it(window: Make) -> None:
    found = await wait_until(ramp(window), "/x", "data < 0")
    assert (found.met, found.looked_at, found.message) == (False, 1000, {"data": 999.0})
    assert "was not met" in found.summary()


async def test_silence_says_so(window: Make) -> None:
    found = await wait_until(Recorded([window("/x", FLOAT, [])]), "/x", "data < 0")
    assert (found.met, found.message, found.note) == (False, None, "No message came.")


async def test_messages_without_an_answer_are_counted(window: Make) -> None:
    found = await wait_until(ramp(window), "/x", "1 / data > 0.9")
    assert (found.met, found.looked_at, found.undecided) == (True, 2, 1)


async def test_a_bad_condition_is_refused_before_waiting(window: Make) -> None:
    with pytest.raises(BadInput, match="dat"):
        await wait_until(ramp(window), "/x", "dat > 1")
