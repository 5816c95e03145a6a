"""What a live stream learns of the clock of its publisher."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources.live import _LiveStream  # pyright: ignore[reportPrivateUsage]
from support.made_windows import CODEC, START_NS

TYPE = "std_msgs/msg/Int32"


def stream_of(clock_s: float, sent_s: list[float]) -> tuple[_LiveStream, list[Sample]]:
    """Latched messages sent at these times from asking on, by a publisher whose clock is so far ahead of ours."""
    listening: Any = SimpleNamespace(choice=SimpleNamespace(qos=SimpleNamespace(durability="transient_local")))
    seen = SimpleNamespace(note_stream=lambda _: None)
    robot: Any = SimpleNamespace(graph=SimpleNamespace(seen=seen))
    stream = _LiveStream(
        topic="/map",
        type=TYPE,
        codec=CODEC,
        publishers=[],
        robot=robot,
        listening=listening,
        asked_at=0.0,
        asked_ns=START_NS,
    )
    samples = [
        Sample(START_NS + round((max(at, 0.2) + 0.001) * 1e9), START_NS + round((at + clock_s) * 1e9), None, b"")
        for at in sent_s
    ]
    return stream, samples


@pytest.mark.parametrize("clock_s", [0.0, -6.0, -2.0, 47.0])
@pytest.mark.parametrize("history", [0, 10])
def test_history_is_told_from_what_is_new_whatever_the_publisher_s_clock_says(clock_s: float, history: int) -> None:
    stream, samples = stream_of(clock_s, [at - 20.0 for at in range(history)] + [0.3 + at / 2 for at in range(9)])
    stream.look_at(samples)
    assert stream.tells_replayed
    assert [stream.is_replayed(sample) for sample in samples] == [True] * history + [False] * 9


def test_a_lone_burst_is_old_by_its_time() -> None:
    stream, samples = stream_of(0.0, [-3600.0, -1800.0])
    stream.look_at(samples)
    assert not stream.tells_replayed
    assert all(map(stream.is_replayed, samples))
