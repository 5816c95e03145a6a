"""What the watchdog cannot hear or understand ends or holds up nothing: it is as if it had not come."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels")

from ros2_mcp_bridge.motion import watching
from ros2_mcp_bridge.ros import interfaces, rcl
from ros2_mcp_bridge.stream import Sample
from ros2_mcp_bridge.topics.subscriptions import RawSubscription
from ros2_mcp_common.policy.feedback import PoseRule, Watchdog

POSE = "geometry_msgs/msg/Pose"
RULE = PoseRule("/pose", POSE, "", max_age_s=1.0, brake_mps2=1.0, frame_id="map")


@pytest.fixture
def ear(monkeypatch: pytest.MonkeyPatch) -> Callable[[Iterable[Sample]], watching.Ear]:
    """An ear on whose topic these samples wait."""

    def made(samples: Iterable[Sample]) -> watching.Ear:
        drained = SimpleNamespace(_waiting=lambda: samples)
        drain = partial(RawSubscription.drain, drained)  # type: ignore[arg-type]
        subscription = SimpleNamespace(drain=drain)
        source = SimpleNamespace(resubscribe=lambda: None, subscription=subscription, is_latched=False)
        monkeypatch.setattr(watching, "FollowedSource", lambda *_: source)
        return watching.Ear(object(), object(), RULE)  # type: ignore[arg-type]

    return made


def sample(received_ns: int = 0) -> Sample:
    return Sample(received_ns, 0, None, rcl.serialize(interfaces.load(POSE)()), 0)


def test_a_flood_is_left_for_the_next_look(ear: Callable[[Iterable[Sample]], watching.Ear]) -> None:
    heard: list[Any] = []
    ear(itertools.repeat(sample())).hear(heard.append)
    assert heard


def test_of_a_latched_topic_the_newest_from_before_has_an_age_and_what_comes_has_none(
    ear: Callable[[Iterable[Sample]], watching.Ear],
) -> None:
    now_ns, ages = time.time_ns(), list[float | None]()
    data = rcl.serialize(interfaces.load(POSE)())
    sent_s = (9, 8, -1)
    listening = ear([Sample(now_ns, now_ns - s * 10**9, None, data, 0) for s in sent_s])
    listening._source.is_latched = True  # type: ignore[misc]
    listening.hear(lambda _: ages.append(listening.from_before_s))
    assert [age and round(age) for age in ages] == [8, None]


def test_a_type_that_has_not_what_is_read_is_not_heard(ear: Callable[[Iterable[Sample]], watching.Ear]) -> None:
    watchdog = Watchdog(None, RULE)
    ear([sample()]).hear(watching._pose_to(watchdog))
    watchdog.told(True, 0.0)
    assert "has sent nothing" in watchdog.look(10.0)


def test_an_error_of_the_middleware_does_not_end_the_watchdog(
    ear: Callable[[Iterable[Sample]], watching.Ear], capsys: pytest.CaptureFixture[str]
) -> None:
    def broken() -> Iterator[Sample]:
        raise rcl.RCLError("cannot take")
        yield sample()

    heard: list[Any] = []
    ear(broken()).hear(heard.append)
    assert not heard and "cannot take" in capsys.readouterr().err


def test_a_message_is_told_with_when_it_was_received_and_not_when_it_was_looked_at(
    ear: Callable[[Iterable[Sample]], watching.Ear],
) -> None:
    now_ns, now = time.time_ns(), time.monotonic()
    received_ns = [now_ns - 20_000_000, now_ns + 3_600_000_000_000, now_ns - 3_600_000_000_000]
    listening, ages_s = ear([sample(each) for each in received_ns]), list[float]()
    listening.hear(lambda _: ages_s.append(now - listening.received_at))
    assert ages_s[0] == pytest.approx(0.02, abs=0.01)
    later_s = time.monotonic() - now
    assert ages_s[1] <= 0.0 <= ages_s[1] + later_s, "a clock that was set"
    assert ages_s[2] <= watching.WAITED_AT_MOST_S <= ages_s[2] + later_s
