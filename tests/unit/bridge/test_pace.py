"""The pace of requests to one service: at once while its queue has room, then as it takes them."""

from __future__ import annotations

import time

import pytest

from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.topics.pace import ROOM, TAKEN_EVERY_S, Pace


class Turn:
    """A request that waits for its turn; `look` lets it look again."""

    def __init__(self, pace: Pace, patience_s: float = 3600.0) -> None:
        self.request = Request({"id": 1, "op": "call"}, b"")
        self._steps: Steps[None] = pace.wait_turn(self.request, time.monotonic() + patience_s)

    def look(self) -> bool:
        """Whether it may be sent now."""
        try:
            next(self._steps)
        except StopIteration:
            return True
        return False

    def give_up(self) -> None:
        self._steps.close()


def test_as_many_as_fit_into_the_queue_go_at_once() -> None:
    pace = Pace()
    assert [Turn(pace).look() for _ in range(ROOM + 1)] == [True] * ROOM + [False]


def test_an_answer_makes_room_for_the_next() -> None:
    pace = Pace()
    sent = [Turn(pace) for _ in range(ROOM)]
    assert all(turn.look() for turn in sent)
    waiting = Turn(pace)
    assert not waiting.look()
    pace.answered(sent[0].request)
    assert waiting.look()


def test_an_answer_tells_that_the_requests_before_it_were_taken_too() -> None:
    pace = Pace()
    sent = [Turn(pace) for _ in range(ROOM)]
    assert all(turn.look() for turn in sent)
    waiting = [Turn(pace) for _ in range(5)]
    pace.answered(sent[3].request)
    assert [turn.look() for turn in waiting] == [True] * 4 + [False]


def test_requests_keep_their_order() -> None:
    pace = Pace()
    sent = [Turn(pace) for _ in range(ROOM)]
    assert all(turn.look() for turn in sent)
    first, second = Turn(pace), Turn(pace)
    assert not first.look()
    assert not second.look()
    pace.answered(sent[0].request)
    assert not second.look()
    assert first.look()


def test_one_is_presumed_taken_at_each_look_however_long_it_has_been() -> None:
    pace = Pace()
    assert all(Turn(pace).look() for _ in range(ROOM))
    waiting = [Turn(pace) for _ in range(3)]
    assert [turn.look() for turn in waiting] == [False, False, False]
    time.sleep(4 * TAKEN_EVERY_S)
    assert [turn.look() for turn in waiting] == [True, False, False]


def test_one_that_gives_up_leaves_its_place_to_the_next() -> None:
    pace = Pace()
    sent = [Turn(pace) for _ in range(ROOM)]
    assert all(turn.look() for turn in sent)
    impatient, patient = Turn(pace), Turn(pace)
    assert not impatient.look()
    assert not patient.look()
    impatient.give_up()
    pace.answered(sent[0].request)
    assert patient.look()


def test_one_whose_time_is_up_was_not_sent() -> None:
    pace = Pace()
    assert all(Turn(pace).look() for _ in range(ROOM))
    late = Turn(pace, patience_s=0.0)
    with pytest.raises(OperationError, match="not sent in time") as refused:
        late.look()
    assert refused.value.kind == "timeout"
