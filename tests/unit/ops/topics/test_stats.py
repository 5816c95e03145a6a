"""How topics flow, of samples made for the purpose."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.topics.stats import TopicStats, measure
from support.made_windows import Make, Recorded

FLOAT = "std_msgs/msg/Float64"


async def only(window: Make, times: Sequence[float], duration_s: float) -> TopicStats:
    made = window("/speed", FLOAT, [(at, {"data": 0.0}) for at in times], duration_s)
    (found,) = (await measure(Recorded([made], GraphSnapshot({}, None, None)), ["/speed"])).topics
    return found


async def test_a_silence_between_messages_is_a_gap(window: Make) -> None:
    found = await only(window, [0.1, 0.2, 0.3, 0.9, 1.0], 1.05)
    assert (found.count, found.gaps, found.longest_gap_s) == (5, 1, pytest.approx(0.6))
    assert found.note.startswith("The longest silence is 0.6 s from ")


async def test_a_topic_that_has_stopped_is_told(window: Make) -> None:
    found = await only(window, [0.1, 0.2, 0.3, 0.4], 2.4)
    assert (found.gaps, found.longest_gap_s) == (1, pytest.approx(2.0))
    assert found.rate_hz == pytest.approx(10.0)
    assert found.note == "It has stopped: nothing came in the last 2 s."


async def test_a_slow_topic_has_not_stopped_between_two_messages(window: Make) -> None:
    found = await only(window, [1.0, 3.0, 5.0, 7.0], 12.0)
    assert (found.gaps, found.note) == (0, "")
