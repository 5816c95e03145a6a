"""Under a policy every way to move the robot is limited, through the real server: calls refused, streams scaled."""

from __future__ import annotations

import pytest

from support.agent import FULL, Refusal, until
from support.driver import WAYS, Driver, calm, fresh
from support.limits import HOLD_S, LINEAR, over
from support.observer import Observer
from support.velocities import TWIST, speed

STREAMS = ("relay", "feed", "playback")
REST_S = 30.0
"""Only ends a hang: what drives would go on for a minute, or for good."""


def subscribed(server: Driver, observer: Observer) -> str:
    """A topic that the policy allows, with a subscriber that the server knows."""
    topic = f"{fresh('base')}/cmd_vel"
    observer.join(by=topic, topic=topic, kind=TWIST)
    server.knows(topic, 1)
    return topic


def speeds(observer: Observer, topic: str) -> list[float]:
    """What arrived, which is within the limits."""
    came = [(one["values"][:3], one["values"][3:]) for one in observer.messages(topic=topic)]
    assert [problem for one in came if (problem := over(*one))] == []
    return [linear[0] for linear, _ in came]


@pytest.mark.parametrize("way", sorted(WAYS))
def test_what_is_too_fast_is_refused_or_scaled_whichever_way_it_takes(server, observer, way: str) -> None:
    topic = subscribed(server, observer)
    request = WAYS[way](server, observer, topic)
    if way in STREAMS:
        until(lambda: max(speeds(observer, topic), default=0.0) > LINEAR * 0.99)
    else:
        with pytest.raises(Refusal, match=r"linear is 0\.5, at most 0\.4 is allowed \(hall: limit base\)"):
            server.result(request)
    calm(observer, topic)
    server.stop()
    assert observer.comes_to_rest(topic, 2.0 if FULL else REST_S) == []
    server.reset()
    assert way in STREAMS or not any(speeds(observer, topic))


@pytest.mark.parametrize("within_s", [REST_S, pytest.param(HOLD_S + 1.0, marks=pytest.mark.full)])
def test_one_command_begins_slowly_holds_for_a_moment_and_says_both(server, observer, within_s: float) -> None:
    topic = subscribed(server, observer)
    done = server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, 0.3))
    assert "reduced 1 message to stay" in done["note"]
    assert f"The robot keeps this velocity for {HOLD_S:g} s" in done["note"]
    assert observer.comes_to_rest(topic, within_s) == []
    assert 0.0 < max(speeds(observer, topic)) <= 0.05


def test_a_repeat_reaches_what_it_was_asked_for(server, observer) -> None:
    topic = subscribed(server, observer)
    given = {"topic_name": topic, "message_type": TWIST, "data": speed(TWIST, 0.3), "frequency": 20, "duration": 4}
    done = server.do("ros2_topic_publish", **given)
    assert max(speeds(observer, topic)) == 0.3
    assert done["stopped_with_zero"] and "A zero command was sent at the end." in done["note"]


@pytest.mark.parametrize("within_s", [REST_S, pytest.param(2.0, marks=pytest.mark.full)])
def test_when_the_server_is_killed_nothing_over_a_limit_is_left_behind(start_server, observer, within_s: float) -> None:
    server = start_server()
    topic = subscribed(server, observer)
    given = {"topic_name": topic, "message_type": TWIST, "data": speed(TWIST, 0.3), "frequency": 50, "duration": 60}
    server.tool("ros2_topic_publish", **given)
    observer.until_driven(topic, 5)
    server.process.kill()
    assert observer.comes_to_rest(topic, within_s) == []
    assert max(speeds(observer, topic)) <= 0.3
