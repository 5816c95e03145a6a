"""What the bridge hands to the middleware leaves by few exits, and each of them asks whether it still may."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp_bridge.__main__ import ROS_HANGS_AFTER_S, Bridge
from ros2_mcp_bridge.ros import interfaces
from ros2_mcp_common.wire.packets import pack

SOURCE = Path(__file__).resolve().parents[3] / "src/ros2_mcp_bridge"
EXITS = {
    # What others have made, and zeros; zeros only; a limit that can only make Nav2 slower.
    ".publish_raw(": {"publishers.py": 2, "stopper.py": 1, "speed_limit.py": 1},
    ".call_async(": {"clients.py": 1, "stopper.py": 1},  # calls, and fail-safes; fail-safes only
}
PATIENCE_S = 30.0


@pytest.mark.parametrize("exit_name", EXITS)
def test_there_is_one_exit_of_messages_and_one_of_requests(exit_name: str) -> None:
    counts = {path.name: path.read_text(encoding="utf-8").count(exit_name) for path in SOURCE.rglob("*.py")}
    assert {name: count for name, count in counts.items() if count} == EXITS[exit_name]


class Rounds:
    """Stands in for rclpy's executor: it has nothing to do."""

    def create_task(self, callback: Callable[[], None]) -> None:
        """The next round comes at once anyway."""

    def spin_once(self, timeout_sec: float | None = None) -> None:
        time.sleep(min(timeout_sec or 0.0, 0.001))


def test_a_stop_sends_its_zeros_before_what_else_the_ros_thread_does_in_that_turn() -> None:
    """The next request of that turn hangs in the middleware, when nothing is left that would send them instead."""
    (incoming, server), (answers, outgoing) = os.pipe(), os.pipe()
    bridge = Bridge(incoming, outgoing)
    zeros, ended = threading.Event(), threading.Event()
    came_first: list[bool] = []

    def gather() -> None:
        """The turn after this one has the stop and a request that hangs."""
        os.write(server, pack({"id": 1, "op": "stop", "epoch": 1}))
        while not bridge._loop._submitted:
            time.sleep(0.001)
        bridge._loop._submitted.append(hang)

    def hang() -> None:
        came_first.append(zeros.wait(10 * ROS_HANGS_AFTER_S))
        ended.set()

    bridge._operations = SimpleNamespace(  # type: ignore[assignment]
        send_zeros=zeros.set, start=lambda _: None, is_at_rest=lambda: True
    )
    bridge._loop.submit(gather)
    turning = threading.Thread(target=bridge._loop.run, args=(Rounds(),), daemon=True)
    turning.start()
    assert ended.wait(PATIENCE_S)
    bridge._loop.end()
    turning.join(PATIENCE_S)
    assert came_first == [True]
    del answers


@pytest.mark.parametrize(
    ("said", "done"), [({"op": "stop", "epoch": 1}, "zeros"), ({"op": "ping", "lease_s": 0.05}, "fail-safes")]
)
def test_a_ros_thread_that_hangs_keeps_no_robot_moving(said: dict[str, Any], done: str) -> None:
    """Nothing runs the loop here, as if discovery hung: another thread sends the zeros, soon."""
    (incoming, server), (answers, outgoing) = os.pipe(), os.pipe()
    bridge = Bridge(incoming, outgoing)
    heard, came = list[tuple[str, float]](), threading.Event()

    def note(what: str) -> None:
        heard.append((what, time.monotonic()))
        came.set()

    bridge._operations = SimpleNamespace(  # type: ignore[assignment]
        is_at_rest=lambda: False,
        start=lambda _: note("started"),
        lapse=lambda: note("lapsed"),
        send_zeros=lambda: note("zeros"),
        failsafes=SimpleNamespace(carry_out=lambda: note("fail-safes")),
    )
    begun = time.monotonic()
    os.write(server, pack({"id": 1, **said}))
    assert came.wait(PATIENCE_S)
    assert [what for what, _ in heard] == [done]
    assert heard[0][1] - begun >= ROS_HANGS_AFTER_S
    del answers


def test_what_ends_something_does_not_wait_for_the_imports_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    (incoming, server), (answers, outgoing) = os.pipe(), os.pipe()
    bridge = Bridge(incoming, outgoing)
    loaded, ended, begun = threading.Event(), threading.Event(), list[str]()
    monkeypatch.setattr(interfaces, "load", lambda _: loaded.wait(PATIENCE_S))
    bridge._operations = SimpleNamespace(  # type: ignore[assignment]
        start=lambda request: begun.append(request.op),
        end_at_once=lambda _: ended.set(),
        is_at_rest=lambda: True,
    )
    bridge._ros_is_up.set()
    turning = threading.Thread(target=bridge._loop.run, args=(Rounds(),), daemon=True)
    turning.start()
    os.write(server, pack({"id": 1, "op": "subscribe", "type": "a/msg/B"}) + pack({"id": 2, "op": "cancel"}))
    assert ended.wait(PATIENCE_S)
    assert begun == []
    loaded.set()
    deadline = time.monotonic() + PATIENCE_S
    while begun != ["subscribe", "cancel"]:  # in its turn, once more
        assert time.monotonic() < deadline
        time.sleep(0.001)
    bridge._loop.end()
    turning.join(PATIENCE_S)
    del answers
