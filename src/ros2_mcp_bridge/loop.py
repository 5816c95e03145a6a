# pyright: basic
"""The ROS thread's loop: it spins the executor and runs operations that wait, without ever blocking on one.

An operation that waits is a generator of *steps*: it yields the seconds after which it wants to go on.
"""

from __future__ import annotations

import heapq
import itertools
import sys
import time
import traceback
from collections import deque
from typing import Any

IDLE_S = 0.25


class Task:
    """A generator of steps that runs on the loop."""

    def __init__(self, loop, steps, finished):
        self._loop = loop
        self._steps = steps
        self._finished = finished
        self.entry = 0
        self.open = True

    def wake(self):
        """Let it go on now instead of after the seconds it asked for; ROS thread only."""
        if self.open:
            self._loop.resume_after(self, 0.0)

    def throw(self, error):
        """Raise an exception inside the generator, where it waits."""
        self._advance(lambda: self._steps.throw(error))

    def advance(self):
        """Run it up to where it waits next."""
        self._advance(lambda: next(self._steps))

    def _advance(self, step):
        try:
            self._loop.resume_after(self, step())
        except StopIteration as stop:
            self._finish(stop.value, None)
        except Exception as error:  # noqa: BLE001 - whatever it is, it answers the request and not the loop
            self._finish(None, error)

    def _finish(self, result, error):
        self.open = False
        self._finished(result, error)


class Loop:
    """Everything that touches rclpy entities runs in here, on the thread that calls `run`."""

    def __init__(self):
        self.last_turn = time.monotonic()
        self._executor: Any = None
        self._submitted = deque()
        self._waiting = []
        self._numbers = itertools.count(1)
        self._ending = False

    def submit(self, call):
        """Let the ROS thread run `call` soon; from any thread."""
        self._submitted.append(call)
        self._wake()

    def end(self):
        """Let `run` return soon; from any thread."""
        self._ending = True
        self._wake()

    def start(self, steps, finished):
        """Run a generator of steps; `finished(result, error)` is called once, at the end. ROS thread only."""
        task = Task(self, steps, finished)
        self.resume_after(task, 0.0)
        return task

    def resume_after(self, task, seconds):
        """Let a task go on later; replaces what it asked for before."""
        task.entry = next(self._numbers)
        heapq.heappush(self._waiting, (time.monotonic() + seconds, task.entry, task))

    def has_due(self):
        """Whether something else waits for the ROS thread now."""
        return bool(self._submitted or self._ending or (self._waiting and self._waiting[0][0] <= time.monotonic()))

    def turn_of(self, seconds):
        """What tells whether a turn has been long enough: something else waits, or so many seconds are over."""
        deadline = time.monotonic() + seconds
        return lambda: self.has_due() or time.monotonic() > deadline

    def run(self, executor):
        """Go round until `end` is called."""
        self._executor = executor
        while not self._ending:
            try:
                self._turn()
            except Exception:  # noqa: BLE001 - one failing callback must not end the bridge
                traceback.print_exc(file=sys.stderr)
                time.sleep(0.01)

    def _turn(self):
        self.last_turn = time.monotonic()
        for _ in range(len(self._submitted)):
            self._submitted.popleft()()
        self._resume_due()
        pause = self._waiting[0][0] - time.monotonic() if self._waiting else IDLE_S
        if self._submitted or self._ending:
            pause = 0.0
        self._executor.spin_once(timeout_sec=min(max(pause, 0.0), IDLE_S))

    def _resume_due(self):
        now = time.monotonic()
        due = []
        while self._waiting and self._waiting[0][0] <= now:
            due.append(heapq.heappop(self._waiting))
        for _, entry, task in due:
            if task.open and task.entry == entry:
                task.advance()

    def _wake(self):
        if self._executor is not None:
            self._executor.create_task(_nothing)


def log_failure(_result, error):
    """For tasks that answer nobody."""
    if error is not None:
        traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)


def _nothing():
    """A task of no work: creating it wakes the executor."""
