"""What ends one topic's motion depends on no other topic, on no clock of others, and is told as it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")

from ros2_mcp_bridge.exit import velocities
from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.request import Request
from ros2_mcp_bridge.ros import clock
from ros2_mcp_bridge.topics import publishers
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES

TWIST = "geometry_msgs/msg/Twist"
MIXED: list[tuple[list[bool | None], bool | None]] = [
    ([True], True),
    ([True, None], None),
    ([True, False], False),
    ([None, False], False),
    ([None], None),
    ([], None),
]


class Exit:
    """A publisher with one subscriber, which says what it is told to."""

    def __init__(self, acked: bool | None = True, *, fails: bool = False, matched: int = 1) -> None:
        self.sent = 0
        self._acked, self._fails, self._matched = acked, fails, matched

    def publish_zero(self, data: bytes) -> None:
        if self._fails:
            raise RuntimeError("the middleware refuses it")
        assert data
        self.sent += 1

    def matched(self) -> int:
        return self._matched

    def has_all_matched(self) -> bool:
        return True

    def acknowledged(self) -> bool | None:
        return self._acked

    def done(self) -> bool:
        return self._acked is not False


@pytest.fixture
def driven(monkeypatch: pytest.MonkeyPatch):
    """Make velocity topics that are driven, by their names; a message is made by the second argument."""
    monkeypatch.setattr(velocities, "rcl", SimpleNamespace(serialize=lambda _: b"zero"))
    everything = velocities.Velocities(SimpleNamespace(forget=lambda _: None), print)  # type: ignore[arg-type]

    def drive(name: str, *exits: Exit, interface: Any = object) -> velocities.VelocityTopic:
        request = Request({"id": 1, "op": "failsafe_publish", "topic": name, "type": TWIST}, b"")
        request.interface = interface
        topic = everything.topic(request)
        assert topic is not None
        topic.holders[request] = None
        topic.publishers.update(dict.fromkeys(exits))
        return topic

    drive.everything = everything  # type: ignore[attr-defined]
    return drive


def test_a_topic_that_fails_does_not_keep_the_others_from_being_stopped(driven, capsys) -> None:
    broken, other, good = Exit(fails=True), Exit(), Exit()
    driven("/a", broken, other)
    driven("/b", interface=lambda: 1 // 0)
    driven("/c", good)
    everything: velocities.Velocities = driven.everything
    everything.send_zeros()
    assert (other.sent, good.sent) == (2, 2)
    steps = everything.stop(everything.driven(), 0.0, 0.0)
    with pytest.raises(StopIteration) as ended:
        next(steps)
    assert [row["topic"] for row in ended.value.value] == ["/a", "/b", "/c"]
    assert (other.sent, good.sent) == (4, 4)
    said = capsys.readouterr().err
    assert "/a could not be stopped" in said and "/b could not be stopped" in said


@pytest.mark.parametrize(("told", "whole"), MIXED)
def test_one_acknowledgement_does_not_stand_for_all(driven, told: list[bool | None], whole: bool | None) -> None:
    topic = driven("/a", *(Exit(acked) for acked in told), Exit(None, matched=0))
    assert topic.outcome()["acked"] is whole


class Hours:
    """A clock that is set forward by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.mark.parametrize(("acked", "sent"), [(True, [2, 2, 2, 2, 2]), (None, [2, 4, 4, 6, 8])])
def test_a_zero_is_sent_again_to_who_acknowledges_nothing(
    driven, monkeypatch: pytest.MonkeyPatch, acked: bool | None, sent: list[int]
) -> None:
    monkeypatch.setattr(velocities, "time", clock := Hours())
    topic = driven("/a", one := Exit(acked))
    topic.about_to_move()
    topic.commanded("")
    topic.send_zero()
    found, rests = [one.sent], list[bool]()
    for clock.now in (100.11, 100.3, 100.41, 101.01):
        topic.look_for_rest()
        rests.append(not topic.moves)
        topic.send_again()
        found.append(one.sent)
    topic.look_for_rest()
    assert found == sent
    assert [*rests, not topic.moves] == ([True] * 5 if acked else [False] * 4 + [True])


def test_a_zero_is_not_sent_again_after_a_command(driven, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(velocities, "time", clock := Hours())
    topic = driven("/a", one := Exit(None))
    topic.send_zero()
    topic.commanded("")
    clock.now += 2.0
    topic.send_again()
    assert one.sent == 2 and not topic.waits_to_send_again


def test_a_broken_message_on_the_clock_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Undecodable, or with nanoseconds that fit into no stamp."""

    def deserialize(data: object, _interface: object) -> object:
        if data == "broken":
            raise ValueError("broken")
        return SimpleNamespace(clock=data)

    waiting: list[Any] = [
        SimpleNamespace(sec=7, nanosec=5),
        "broken",
        SimpleNamespace(sec=2**31 - 1, nanosec=2**32 - 1),
    ]
    raw = SimpleNamespace(take_message=lambda *_: (waiting.pop(0), {}) if waiting else None)
    rcl = SimpleNamespace(deserialize=deserialize, subscription=lambda *_: raw)
    monkeypatch.setattr(clock, "rcl", rcl)
    monkeypatch.setattr(clock.interfaces, "load", lambda _: object)
    nodes = SimpleNamespace(node_name="sim", node_namespace="/")
    graph = SimpleNamespace(subscribers=lambda _: [nodes])
    monkeypatch.setattr(clock.participants, "is_bridge", lambda _: False)
    robots = clock.RobotClock(object(), graph)  # type: ignore[arg-type]
    robots.follow()
    assert robots.now_ns("/a", lambda: 1) == 7_000_000_005
    assert waiting == []


def test_nothing_is_kept_of_a_publisher_that_could_not_be_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("the middleware refuses it")

    monkeypatch.setattr(publishers, "rcl", SimpleNamespace(publisher=fails))
    everything = velocities.Velocities(SimpleNamespace(forget=lambda _: None), print)  # type: ignore[arg-type]
    request = Request({"id": 1, "op": "publish", "topic": "/a", "type": TWIST, "qos": {}}, b"")
    with pytest.raises(RuntimeError):
        publishers.Publisher(
            node=object(),  # type: ignore[arg-type]
            graph=object(),  # type: ignore[arg-type]
            velocities=everything,
            limiter=Limiter(False),
            joint_states=object(),  # type: ignore[arg-type]
            request=request,
        )
    assert everything._topics == {}


@pytest.mark.promise("stopping", "A velocity command is a Twist, TwistStamped, AckermannDrive or AckermannDriveStamped")
def test_the_types_that_keep_a_robot_moving_are_these() -> None:
    names = [name.rpartition("/")[2] for name in VELOCITY_TYPES]
    assert names == ["Twist", "TwistStamped", "AckermannDrive", "AckermannDriveStamped"]
