"""The ROS thread's loop: it spins the executor and runs operations that wait, without ever blocking on one."""

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

# The longest sleep of the ROS thread. Requests and due work wake it; `ping` tells how long ago it went round, and the
# server takes 4 s of that for a hang. Chosen: far below these 4 s. While something moves, what looks after it wakes it
# four times a second and more, which the stopper's lifeline relies on.
IDLE_S = 0.5
# After so long what is submitted, and what is due, waits for the next round: many slow ones at once, such as listings
# of a large graph, hold up neither a stop, which goes first in the next round, nor one another, nor the executor.
# Chosen.
PART_AT_MOST_S = 0.02
# After a callback has failed: one that fails in every round must not take the whole processor. Chosen.
AFTER_FAILURE_S = 0.01
# How often what is `Seldom` goes on while nothing else does: each time that this process wakes up costs 0.2 ms of
# processor time. Chosen.
AT_REST_S = 0.5


class Seldom(float):
    """Seconds that steps wait for before they look again; while the bridge is at rest it may be longer."""


class Executor(Protocol):
    """What the loop needs of rclpy's executors."""

    def create_task(self, callback: Callable[[], None]) -> object:
        """Run it in the next round; wakes `spin_once`. From any thread."""
        ...

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for work, at most that long, and do it."""
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
        """Let it go on now instead of after the seconds it asked for; ROS thread only."""
        if self.open:
            self._loop.resume_after(self, 0.0)

    def throw(self, error: Exception) -> None:
        """Raise an exception inside the steps, where they wait."""
        self._advance(lambda: self._steps.throw(error))

    def advance(self) -> None:
        """Run it up to where it waits next."""
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
    """Everything that touches rclpy entities runs in here, on the thread that calls `run`.

    `after_turn` is called each time that the executor has done something. `is_at_rest` says that nothing goes on, so
    that who looks again and again may do so seldom; whoever begins something then calls `end_rest`.
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
        """Let the ROS thread run `call` soon; from any thread."""
        self._submitted.append(call)
        self._wake()

    def submit_first(self, call: Callable[[], None]) -> None:
        """Let the ROS thread run `call` before all that waits; from any thread."""
        self._submitted.appendleft(call)
        self._wake()

    def end(self) -> None:
        """Let `run` return soon; from any thread."""
        self._ending = True
        self._wake()

    def start(self, steps: Steps[T], finished: Callable[[T | None, Exception | None], None]) -> Task[T]:
        """Run steps; `finished(result, error)` is called once, at the end. ROS thread only."""
        task = Task(self, steps, finished)
        self.resume_after(task, 0.0)
        return task

    def resume_after(self, task: Task[T], seconds: float) -> None:
        """Let a task go on later; replaces what it asked for before."""
        if isinstance(seconds, Seldom) and self.is_at_rest():
            seconds += AT_REST_S - (time.monotonic() + seconds) % AT_REST_S  # all of them at once
            self._resting[task] = None  # pyright: ignore[reportArgumentType]
        task.entry = next(self._numbers)
        # A replaced entry stays in the heap and is skipped when its time comes: its number is not the task's any more.
        heapq.heappush(self._waiting, (time.monotonic() + seconds, task.entry, task))  # pyright: ignore[reportArgumentType]

    def end_rest(self) -> None:
        """Something begins: who waits for longer because of the rest looks now. ROS thread only."""
        resting, self._resting = self._resting, {}
        for task in resting:
            task.wake()

    def has_due(self) -> bool:
        """Whether something else waits for the ROS thread now."""
        return bool(self._submitted or self._ending or (self._waiting and self._waiting[0][0] <= time.monotonic()))

    def turn_of(self, seconds: float) -> Callable[[], bool]:
        """A function that says whether a turn has been long enough: something else waits, or the time is over."""
        deadline = time.monotonic() + seconds
        return lambda: self.has_due() or time.monotonic() > deadline

    def run(self, executor: Executor) -> None:
        """Go round until `end` is called."""
        self._executor = executor
        while not self._ending:
            self._turn(executor)

    def _turn(self, executor: Executor) -> None:
        self.last_turn = time.monotonic()
        # Only as many as wait now: what they submit themselves waits for the next round, so that the executor has one.
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
    """One that fails must not end the bridge, nor keep the others of its turn from being done."""
    try:
        call()
    except Exception:  # noqa: BLE001 - one failing callback must not end the bridge
        traceback.print_exc(file=sys.stderr)
        time.sleep(AFTER_FAILURE_S)


def log_failure(_result: object, error: Exception | None) -> None:
    """For tasks that answer nobody."""
    if error is not None:
        traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
