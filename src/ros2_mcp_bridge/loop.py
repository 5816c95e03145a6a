"""The loop of the ROS thread: spins the executor and runs operations that wait, without blocking on any operation."""

from __future__ import annotations

import heapq
import itertools
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from ros2_mcp_bridge.request import Steps

T = TypeVar("T")

# The longest sleep of the ROS thread. Requests and due work wake it. `ping` reports the age of its last turn, and the
# server takes 4 s for a hang; this is far below. While something moves, other work wakes it at least four times a
# second, on which the stopper's lifeline relies.
IDLE_S = 0.5
# After this time, submitted and due work waits for the next turn. So many slow pieces of work, such as listings of a
# large graph, delay neither a stop, which is first in the next turn, nor one another, nor the executor.
PART_AT_MOST_S = 0.02
# The pause after a callback has failed: one that fails in every turn must not use a whole processor.
AFTER_FAILURE_S = 0.01
# The period of `Seldom` steps while the bridge is at rest: each wake-up costs 0.2 ms of processor time.
AT_REST_S = 0.5


class Seldom(float):
    """Seconds that steps wait before they look again; the wait may be longer while the bridge is at rest."""


class Executor(Protocol):
    """An executor of rclpy, as the loop uses it."""

    def create_task(self, callback: Callable[[], None]) -> object:
        """Run the callback in the next turn, and wake `spin_once`. Thread-safe."""
        ...

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for work, at most `timeout_sec`, and do it."""
        ...


class Task(Generic[T]):
    """Steps that run on the loop."""

    def __init__(self, loop: Loop, steps: Steps[T], finished: Callable[[T | None, Exception | None], None]) -> None:
        self._loop = loop
        self._steps = steps
        self._finished = finished
        self.entry = 0
        self.open = True

    def wake(self) -> None:
        """Resume the steps now instead of after the seconds that they asked for. ROS thread only."""
        if self.open:
            self._loop.resume_after(self, 0.0)

    def throw(self, error: Exception) -> None:
        """Raise an exception inside the steps, where they wait."""
        self._advance(lambda: self._steps.throw(error))

    def advance(self) -> None:
        """Run the steps up to their next wait."""
        self._advance(lambda: next(self._steps))

    def _advance(self, step: Callable[[], float]) -> None:
        try:
            self._loop.resume_after(self, step())
            return
        except StopIteration as stop:
            result, failure = stop.value, None
        except Exception as error:  # noqa: BLE001 - whatever it is, it answers the request and not the loop
            result, failure = None, error
        self.open = False
        self._finished(result, failure)


class Loop:
    """The loop on the thread that calls `run`. Everything that touches rclpy entities runs in it.

    `after_turn` is called after each turn of the executor. `is_at_rest` returns whether nothing is under way, so that
    steps that poll may do so seldom; a caller that begins something then calls `end_rest`.
    """

    def __init__(self) -> None:
        self.last_turn = time.monotonic()
        self.after_turn: Callable[[], None] = lambda: None
        self.is_at_rest: Callable[[], bool] = lambda: False
        self._resting: dict[Task[object], None] = {}
        self._executor: Executor | None = None
        self._submitted: deque[Callable[[], None]] = deque()
        self._waiting: list[tuple[float, int, Task[object]]] = []
        self._numbers = itertools.count(1)
        self._ending = False

    def submit(self, call: Callable[[], None]) -> None:
        """Run `call` on the ROS thread soon. Thread-safe."""
        self._submitted.append(call)
        self._wake()

    def submit_first(self, call: Callable[[], None]) -> None:
        """Run `call` on the ROS thread before all other submitted work. Thread-safe."""
        self._submitted.appendleft(call)
        self._wake()

    def end(self) -> None:
        """Make `run` return soon. Thread-safe."""
        self._ending = True
        self._wake()

    def start(self, steps: Steps[T], finished: Callable[[T | None, Exception | None], None]) -> Task[T]:
        """Run steps; `finished(result, error)` is called once, when they end. ROS thread only."""
        task = Task(self, steps, finished)
        self.resume_after(task, 0.0)
        return task

    def resume_after(self, task: Task[T], seconds: float) -> None:
        """Resume a task after these seconds, instead of the time that was set before."""
        if isinstance(seconds, Seldom) and self.is_at_rest():
            seconds += AT_REST_S - (time.monotonic() + seconds) % AT_REST_S  # all of them at once
            self._resting[task] = None  # pyright: ignore[reportArgumentType]
        task.entry = next(self._numbers)
        # A replaced entry stays in the heap and is skipped when its time comes: its number is not the task's any more.
        heapq.heappush(self._waiting, (time.monotonic() + seconds, task.entry, task))  # pyright: ignore[reportArgumentType]

    def end_rest(self) -> None:
        """End the rest: wake the tasks that wait longer because of it. ROS thread only."""
        resting, self._resting = self._resting, {}
        for task in resting:
            task.wake()

    def has_due(self) -> bool:
        """Return whether other work waits for the ROS thread now."""
        return bool(self._submitted or self._ending or (self._waiting and self._waiting[0][0] <= time.monotonic()))

    def turn_of(self, seconds: float) -> Callable[[], bool]:
        """Return a function that says whether a piece of work should pause: other work waits,
        or these seconds are over.
        """
        deadline = time.monotonic() + seconds
        return lambda: self.has_due() or time.monotonic() > deadline

    def run(self, executor: Executor) -> None:
        """Make turns until `end` is called."""
        self._executor = executor
        while not self._ending:
            self._turn(executor)

    def _turn(self, executor: Executor) -> None:
        self.last_turn = time.monotonic()
        # Only those that are submitted by now: calls that they submit wait for the next turn, so that the executor gets
        # its turn.
        for _ in range(len(self._submitted)):
            _try(self._submitted.popleft())
            if time.monotonic() > self.last_turn + PART_AT_MOST_S:
                break
        began_at = time.monotonic()
        due: list[tuple[float, int, Task[object]]] = []
        while self._waiting and self._waiting[0][0] <= began_at:
            due.append(heapq.heappop(self._waiting))
        while due and time.monotonic() <= began_at + PART_AT_MOST_S:
            _, entry, task = due.pop(0)
            if task.open and task.entry == entry:
                _try(task.advance)
        for left in due:
            heapq.heappush(self._waiting, left)
        pause = self._waiting[0][0] - time.monotonic() if self._waiting else IDLE_S
        if self._submitted or self._ending:
            pause = 0.0
        _try(lambda: executor.spin_once(timeout_sec=min(max(pause, 0.0), IDLE_S)))
        _try(self.after_turn)

    def _wake(self) -> None:
        if self._executor is not None:
            self._executor.create_task(lambda: None)  # creating a task wakes the executor


def _try(call: Callable[[], object]) -> None:
    """Call a function, and log its error: a failure must not end the bridge, nor prevent other work of its turn."""
    try:
        call()
    except Exception:  # noqa: BLE001 - one failing callback must not end the bridge
        traceback.print_exc(file=sys.stderr)
        time.sleep(AFTER_FAILURE_S)


def log_failure(_result: object, error: Exception | None) -> None:
    """Log the error of a task, for tasks that answer no request."""
    if error is not None:
        traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
