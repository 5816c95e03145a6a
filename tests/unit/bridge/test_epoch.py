"""What was accepted before a stop, or before a link lease lapsed, does not leave any more."""

from __future__ import annotations

from pathlib import Path

import pytest

from ros2_mcp_bridge.epoch import StopEpoch
from ros2_mcp_bridge.request import Cancelled, Request
from ros2_mcp_common.latch import FILE, Latch


class Idle:
    """What works on a request."""

    def wake(self) -> None: ...

    def throw(self, error: Exception) -> None: ...


def accepted(stops: StopEpoch, epoch: float) -> Request:
    request = Request({"id": 1, "op": "publish", "topic": "/said"}, b"")
    request.acceptance = stops.accept(epoch)
    request.task = Idle()
    return request


def test_the_highest_epoch_counts() -> None:
    stops = StopEpoch()
    stops.raise_to(3)
    stops.raise_to(2)
    assert (accepted(stops, 2).acceptance or pytest.fail()).overtaken_by() == "stop"
    assert (accepted(stops, 3).acceptance or pytest.fail()).overtaken_by() == ""


def test_a_request_of_before_the_stop_is_held_back_and_the_stop_learns_of_it() -> None:
    stops = StopEpoch()
    before = accepted(stops, 0)
    stops.raise_to(1)
    with pytest.raises(Cancelled) as held_back:
        before.leave()
    assert (held_back.value.kind, held_back.value.ended_by) == ("stopped", "stop")
    assert not before.has_left
    assert stops.overtaken == [before]


def test_a_request_of_after_the_stop_leaves() -> None:
    stops = StopEpoch()
    stops.raise_to(1)
    after = accepted(stops, 1)
    after.leave()
    assert after.has_left


def test_a_request_of_before_a_lapse_is_held_back_and_one_of_after_it_leaves() -> None:
    stops = StopEpoch()
    before = accepted(stops, 0)
    stops.lapse()
    with pytest.raises(Cancelled) as held_back:
        before.leave()
    assert (held_back.value.kind, held_back.value.ended_by) == ("lapsed", "lease")
    assert stops.overtaken == []
    accepted(stops, 0).leave()


def test_a_request_that_only_reads_is_never_held_back() -> None:
    stops = StopEpoch()
    reading = Request({"id": 1, "op": "call"}, b"")
    stops.raise_to(1)
    stops.lapse()
    reading.leave()


def test_what_comes_too_late_never_leaves_and_what_comes_afterwards_does() -> None:
    stops = StopEpoch()
    stops.is_late = True
    late = accepted(stops, 0)
    stops.is_late = False
    with pytest.raises(Cancelled) as held_back:
        late.leave()
    assert held_back.value.kind == "lapsed"
    accepted(stops, 0).leave()


def test_a_request_that_ends_already_is_no_work_for_the_stop() -> None:
    stops = StopEpoch()
    ending = accepted(stops, 0)
    ending.task = None
    stops.raise_to(1)
    with pytest.raises(Cancelled):
        ending.leave()
    assert stops.overtaken == []


def test_a_stop_learns_once_of_what_was_accepted_before_it_and_comes_only_then() -> None:
    stops = StopEpoch()
    before = accepted(stops, 0)
    stops.coming[before] = None
    stops.raise_to(1)
    after = accepted(stops, 1)
    stops.coming[after] = None
    assert stops.take_overtaken() == [before]
    assert stops.take_overtaken() == []
    assert list(stops.coming) == [after]


def test_while_the_latch_is_set_nothing_leaves_whoever_has_set_it(tmp_path: Path) -> None:
    stops, other = StopEpoch(Latch(tmp_path / FILE)), Latch(tmp_path / FILE)
    before = accepted(stops, 0)
    other.set(by="stopper", reason="the bridge was silent")
    for request in (before, accepted(stops, 0)):
        with pytest.raises(Cancelled) as held_back:
            request.leave()
        assert (held_back.value.kind, held_back.value.ended_by) == ("latched", "latch")
    Request({"id": 1, "op": "call"}, b"").leave()  # what only reads, or cancels


def test_a_reset_starts_nothing_that_was_accepted_before_it(tmp_path: Path) -> None:
    stops, operator = StopEpoch(Latch(tmp_path / FILE)), Latch(tmp_path / FILE)
    before = accepted(stops, 0)
    stops.latch.set(by="watchdog", reason="too fast")
    meanwhile = accepted(stops, 0)
    operator.reset(by="operator", seen=operator.look().count)
    with pytest.raises(Cancelled):
        before.leave()
    with pytest.raises(Cancelled):
        meanwhile.leave()
    accepted(stops, 0).leave()
