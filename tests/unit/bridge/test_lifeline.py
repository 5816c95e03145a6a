"""The lifeline says what moves, beats only then, and never holds a command up for longer than was decided."""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp_bridge.exit import lifeline
from ros2_mcp_bridge.exit.lifeline import Lifeline
from ros2_mcp_bridge.exit.spawning import Child

TWIST = "geometry_msgs/msg/Twist"
PATIENCE_S = 30.0
NO_COPY = OSError("no more processes")


@dataclass
class Topic:
    """A velocity topic with one subscriber."""

    name: str = "/cmd_vel"
    type: str = TWIST
    frame_id: str = ""
    joints: tuple[str, ...] = ()
    moves: bool = False
    kinds: list[tuple[str, str]] = field(default_factory=lambda: [("reliable", "volatile")])

    def profiles(self) -> list[tuple[str, str]]:
        return self.kinds

    def matched(self) -> int:
        return 1


class FarEnd:
    """What a stopper reads and tells; its process only waits to be killed."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(["sleep", "60"])
        (self.heard, ours), (told, self.tell) = os.pipe(), os.pipe()
        self.child = Child(self.process.pid, ours, told)
        self._read = b""

    def read(self, within_s: float = PATIENCE_S) -> dict[str, Any] | None:
        """The next line that is no beat, or None for a beat; raises `TimeoutError`."""
        deadline = time.monotonic() + within_s
        while b"\n" not in self._read:
            left_s = max(0.0, deadline - time.monotonic())
            if not select.select([self.heard], [], [], left_s)[0]:
                raise TimeoutError
            self._read += os.read(self.heard, 65536)
        line, _, self._read = self._read.partition(b"\n")
        return json.loads(line) if line else None

    def say(self, **line: object) -> None:
        os.write(self.tell, json.dumps(line).encode() + b"\n")

    def die(self) -> None:
        os.close(self.tell)


@pytest.fixture
def far() -> Iterator[FarEnd]:
    end = FarEnd()
    yield end
    end.process.kill()
    end.process.wait()


def made(far: FarEnd | None = None) -> tuple[Lifeline, list[dict[str, Any]]]:
    told: list[dict[str, Any]] = []
    return Lifeline(lambda: told.append({"event": "lost"}), told.append, {"first": far and far.child}), told


def waited(line: Lifeline, topic: Topic) -> lifeline.Guarded:
    steps = line.wait(topic)
    while True:
        try:
            time.sleep(next(steps))
        except StopIteration as stop:
            return stop.value


def test_the_stopper_hears_of_a_topic_before_it_moves_and_beats_only_while_it_does(far: FarEnd) -> None:
    line, _ = made(far)
    topic = Topic()
    line.begin(topic)
    first = far.read()
    assert first and (first["topic"], first["moves"]) == ("/cmd_vel", False)
    assert first["profiles"] == [["reliable", "volatile"]]
    with pytest.raises(TimeoutError):
        far.read(5 * lifeline.BEAT_S)
    topic.moves = True
    line.tell(topic)
    moving = far.read()
    assert moving and moving["moves"]
    assert [far.read(), far.read(), far.read()] == [None] * 3
    line.forget(topic)
    while (last := far.read()) is None:
        pass
    assert last["profiles"] == []


def test_a_bridge_whose_ros_thread_hangs_does_not_beat(far: FarEnd) -> None:
    turned_at = [time.monotonic() - lifeline.ROS_HANGS_S]
    line = Lifeline(lambda: None, lambda _: None, {"first": far.child}, lambda: turned_at[0])
    line.begin(Topic(moves=True))
    assert far.read()
    with pytest.raises(TimeoutError):
        far.read(5 * lifeline.BEAT_S)
    turned_at[0] = time.monotonic() + PATIENCE_S
    assert far.read() is None


def test_a_stopper_that_reads_no_more_is_ended(far: FarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lifeline, "DEAF_S", 0.5)
    line, _ = made(far)
    line.begin(Topic(moves=True))
    far.say(topic="/cmd_vel", type=TWIST, matched=1)
    assert far.process.wait(PATIENCE_S) < 0


def test_the_first_command_waits_for_the_match_and_the_next_one_does_not(far: FarEnd) -> None:
    line, _ = made(far)
    topic = Topic()
    line.begin(topic)
    far.say(topic="/cmd_vel", type=TWIST, matched=1)
    first, second = waited(line, topic), waited(line, topic)
    assert first.problem == second.problem == ""
    assert first.waited_s < lifeline.READY_S and second.waited_s == 0.0


def test_a_stopper_that_does_not_come_holds_a_command_up_once_and_for_a_while(far: FarEnd, monkeypatch) -> None:
    monkeypatch.setattr(lifeline, "READY_S", 0.2)
    line, _ = made(far)
    topic = Topic()
    line.begin(topic)
    first, second = waited(line, topic), waited(line, topic)
    assert 0.2 <= first.waited_s < PATIENCE_S and "not ready" in first.problem
    assert second.waited_s == 0.0 and "not ready" in second.problem


def test_without_a_stopper_motion_goes_on_and_says_why(monkeypatch) -> None:
    def refuse(_: str) -> Child:
        raise NO_COPY

    monkeypatch.setattr(lifeline, "spawn", refuse)
    line, _ = made()
    topic = Topic()
    line.begin(topic)
    guarded = waited(line, topic)
    assert guarded.waited_s < lifeline.READY_S and "no more processes" in guarded.problem


def test_the_death_of_the_stopper_is_told_only_where_something_moves(far: FarEnd) -> None:
    line, told = made(far)
    topic = Topic(moves=True)
    line.begin(topic)
    far.say(topic="/cmd_vel", type=TWIST, matched=1)
    assert waited(line, topic).problem == ""
    far.die()
    deadline = time.monotonic() + PATIENCE_S
    while len(told) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert [(one["event"], one.get("what")) for one in told] == [("stopper", "lost"), ("lost", None)]
    assert "it has ended" in waited(line, topic).problem


def test_what_a_stopper_was_itself_late_is_no_silence_of_its_bridge() -> None:
    pytest.importorskip("rclpy")
    from ros2_mcp_bridge.stopper import stopper

    (heard, tell), (told, written) = os.pipe(), os.pipe()
    judge = stopper.Stopper(SimpleNamespace(), os.getpid(), heard, written)  # type: ignore[arg-type]
    zeros: list[float] = []
    moving = SimpleNamespace(
        name="/a", type=TWIST, moves=True, commands=0, audience=tuple, send_zero=lambda: zeros.append(time.monotonic())
    )
    judge._topics = {("/a", TWIST): moving}  # type: ignore[dict-item]
    for _ in range(4):
        judge._look_for_silence(60.0)
    assert zeros == []
    for _ in range(4):
        judge._look_for_silence(60.0)
    assert zeros
    assert json.loads(os.read(told, 1000)) == {"why": f"silent for {2 * stopper.TURN_S * 7:.3g} s"}
    del tell
