"""The loop of the ROS thread, with an executor that has nothing to do."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest

from ros2_mcp_bridge.loop import AT_REST_S, Loop, Seldom, Task
from ros2_mcp_bridge.request import Steps

PATIENCE_S = 20.0


class IdleExecutor:
    """Sleeps until somebody creates a task, as rclpy's do; `failures` are raised by the next rounds."""

    def __init__(self) -> None:
        self._work = threading.Event()
        self.asked_for: list[float | None] = []
        """For how long each round may sleep, in s."""
        self.failures: list[Exception] = []

    def create_task(self, callback: Callable[[], None]) -> None:
        callback()
        self._work.set()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        self.asked_for.append(timeout_sec)
        self._work.wait(timeout_sec)
        self._work.clear()
        if self.failures:
            raise self.failures.pop()


class Outcome:
    """Takes the end of a task."""

    def __init__(self) -> None:
        self.result: object = None
        self.error: Exception | None = None
        self._ended = threading.Event()

    def __call__(self, result: object, error: Exception | None) -> None:
        self.result, self.error = result, error
        self._ended.set()

    def wait(self) -> Outcome:
        assert self._ended.wait(PATIENCE_S)
        return self


@pytest.fixture
def executor() -> IdleExecutor:
    return IdleExecutor()


@pytest.fixture
def loop(executor: IdleExecutor) -> Iterator[Loop]:
    loop = Loop()
    thread = threading.Thread(target=loop.run, args=(executor,))
    thread.start()
    yield loop
    loop.end()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def started(loop: Loop, steps: Steps[object]) -> tuple[list[Task[object]], Outcome]:
    """Steps that run on the loop's own thread: the list has their task as soon as they have begun."""
    outcome, tasks = Outcome(), list[Task[object]]()
    loop.submit(lambda: tasks.append(loop.start(steps, outcome)))
    return tasks, outcome


def test_steps_go_on_after_the_seconds_that_they_ask_for(loop: Loop) -> None:
    def steps() -> Steps[float]:
        begun = time.monotonic()
        yield 0.03
        yield 0.0
        return time.monotonic() - begun

    _, outcome = started(loop, steps())
    assert float(str(outcome.wait().result)) >= 0.03


def test_an_error_of_steps_is_their_outcome(loop: Loop) -> None:
    def steps() -> Steps[None]:
        yield 0.0
        raise ValueError("no")

    _, outcome = started(loop, steps())
    assert str(outcome.wait().error) == "no"


def test_steps_that_sleep_are_woken(loop: Loop) -> None:
    asleep = threading.Event()

    def steps() -> Steps[str]:
        asleep.set()
        yield 3600.0
        return "woken"

    tasks, outcome = started(loop, steps())
    assert asleep.wait(PATIENCE_S)
    loop.submit(tasks[0].wake)
    assert outcome.wait().result == "woken"


def test_an_exception_thrown_into_steps_ends_their_sleep(loop: Loop) -> None:
    asleep = threading.Event()

    def steps() -> Steps[str]:
        asleep.set()
        try:
            yield 3600.0
        except KeyError:
            yield 0.0
        return "tidied up"

    tasks, outcome = started(loop, steps())
    assert asleep.wait(PATIENCE_S)
    loop.submit(lambda: tasks[0].throw(KeyError()))
    assert outcome.wait().result == "tidied up"


def test_what_was_asked_for_before_being_woken_is_forgotten(loop: Loop) -> None:
    rounds, asleep = list[float](), threading.Event()

    def steps() -> Steps[None]:
        asleep.set()
        yield 0.05
        rounds.append(time.monotonic())
        yield 0.15
        rounds.append(time.monotonic())

    tasks, outcome = started(loop, steps())
    assert asleep.wait(PATIENCE_S)
    loop.submit(tasks[0].wake)
    outcome.wait()
    assert rounds[1] - rounds[0] >= 0.15


def test_a_callback_that_fails_does_not_end_the_loop(loop: Loop, executor: IdleExecutor, capsys) -> None:
    executor.failures.append(RuntimeError("from a callback"))

    def steps() -> Steps[str]:
        while executor.failures:
            yield 0.01
        return "went on"

    _, outcome = started(loop, steps())
    assert outcome.wait().result == "went on"
    assert "from a callback" in capsys.readouterr().err


def test_a_turn_is_over_when_others_wait_or_its_time_is_up() -> None:
    loop = Loop()
    is_enough = loop.turn_of(0.5)  # longer than a busy machine keeps this test waiting
    assert not is_enough()
    time.sleep(0.6)
    assert is_enough()
    is_enough = loop.turn_of(3600.0)
    assert not is_enough()
    loop.submit(lambda: None)
    assert is_enough()


def test_the_last_turn_tells_how_long_the_thread_hangs(loop: Loop) -> None:
    release, hangs = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        release.wait(PATIENCE_S)

    loop.submit(hang)
    assert hangs.wait(PATIENCE_S)
    time.sleep(0.1)
    assert time.monotonic() - loop.last_turn >= 0.09
    release.set()


def test_an_answer_that_cannot_be_given_keeps_nothing_else_of_its_turn_from_going_on(
    loop: Loop, capsys: pytest.CaptureFixture[str]
) -> None:
    def steps() -> Steps[str]:
        yield 0.0
        return "done"

    def unanswerable(*_: object) -> None:
        raise ValueError("no answer")

    other = Outcome()
    loop.submit(lambda: (loop.start(steps(), unanswerable), loop.start(steps(), other)))
    assert other.wait().result == "done"
    assert "no answer" in capsys.readouterr().err


@pytest.mark.parametrize("way", ["submitted", "due"])
def test_many_slow_ones_at_once_are_no_hang_and_hold_up_no_stop(loop: Loop, way: str) -> None:
    """Such as 40 listings of a large graph: a server takes a turn that is too long for a hang, and kills the bridge."""
    turns, stopped_after, begun = set[float](), list[int](), threading.Event()
    done, is_stopping = list[int](), threading.Event()

    def slow() -> None:
        begun.set()
        assert is_stopping.wait(PATIENCE_S)
        turns.add(loop.last_turn)
        time.sleep(0.01)
        done.append(len(done))

    def steps() -> Steps[None]:
        yield 0.0
        slow()

    for _ in range(40):
        loop.submit(slow if way == "submitted" else lambda: loop.start(steps(), Outcome()))  # type: ignore[arg-type]
    assert begun.wait(PATIENCE_S)
    loop.submit_first(lambda: stopped_after.append(len(done)))
    is_stopping.set()
    deadline = time.monotonic() + PATIENCE_S
    while len(done) < 40 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert done == list(range(40))
    assert len(turns) > 10, "a turn ends after a few of them"
    assert stopped_after[0] < 40


def test_at_rest_who_looks_again_and_again_looks_seldom_until_something_begins(
    loop: Loop, executor: IdleExecutor
) -> None:
    is_at_rest, looks, looks_at_rest, ended_at = True, list[float](), list[float](), 0.0
    loop.is_at_rest = lambda: is_at_rest

    def looking() -> Steps[None]:
        while True:
            looks.append(time.monotonic())
            yield Seldom(0.01)

    def begin() -> None:
        nonlocal is_at_rest, ended_at
        is_at_rest, ended_at = False, time.monotonic()
        looks_at_rest.extend(looks)
        loop.end_rest()

    begun = time.monotonic()
    loop.submit(lambda: loop.start(looking(), Outcome()))  # type: ignore[arg-type]
    while len(looks) < 3:
        time.sleep(0.01)
    assert time.monotonic() - begun > AT_REST_S, "the first, and those after each half second"
    loop.submit(begin)
    deadline = time.monotonic() + PATIENCE_S
    while len(looks) < len(looks_at_rest) + 10 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert 0 < len(looks_at_rest) <= 3 + (ended_at - begun) / AT_REST_S
    assert len(looks) >= len(looks_at_rest) + 10
    asked_for = executor.asked_for[-5:]  # for nothing where a busy machine was late
    assert any(0.0 < (each or 0.0) <= 0.01 for each in asked_for), "as often as it asks for"
