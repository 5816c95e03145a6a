"""The bridge's end of the lifeline: has a stopper, tells it what moves, and beats as long as this process lives.

The stopper (`stopper.py`) is a second process, which sends the zeros where this one cannot. Only this process holds
the writing end of the pipe, so that the kernel closes it however this process dies. A line is a JSON object about one
topic, or about a call that is left to be made; an empty one is a beat. See
docs/decisions/0030-a-second-process-that-stops.md.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping
from typing import Literal, NamedTuple, Protocol

from .protocol import StopperEvent
from .request import Steps
from .spawning import Child, spawn

# A fifth of the silence after which the stopper acts (SILENCE_S there): four beats may be late. Chosen.
BEAT_S = 0.05
# A ROS thread goes round four times a second at least. One that has not for so long hangs, whatever other threads do:
# then there are no beats. Chosen: twice as long, as a machine that is short of processors makes it late.
ROS_HANGS_S = 0.5
# A stopper reads every 0.02 s while something moves. One that leaves beats unread for so long is stopped, or starves:
# it is none. Chosen.
DEAF_S = 2.0
# Decided: the first command that moves waits no longer for the stopper. It needs 0.1 to 0.4 s, for its participant and
# for discovery; a second one, which begins without rclpy, up to a second more.
READY_S = 2.0
# While it is waited for; on one machine it says what it has matched within milliseconds. Chosen.
POLL_S = 0.005
# One that ended before it was ready is most likely to end so again: the next try is made by a command after this time.
AGAIN_S = 10.0
# One that moves nothing leaves at once when the lifeline ends; this process has 1 s for its whole end. Chosen.
LEAVES_S = 0.2
# A line has to fit into the pipe beside others; no frame id of ROS is nearly as long. Chosen.
MAX_TEXT_CHARS = 4000

Key = tuple[str, str]


class Moved(Protocol):
    """What the lifeline reads of a velocity topic."""

    name: str
    type: str
    frame_id: str
    joints: tuple[str, ...]
    moves: bool

    def profiles(self) -> list[tuple[str, str]]:
        """Reliability and durability of each of its publishers, none of them twice."""
        ...

    def matched(self) -> int:
        """The number of subscribers that would get a message now."""
        ...


class Guarded(NamedTuple):
    """How long a command waited for the stopper, in s, and in words why it goes without one; "" if it does not."""

    waited_s: float = 0.0
    problem: str = ""


class Lifeline:
    """One stopper at a time, told to begin by the first command that moves; `copy` is the first, if there is one.

    `lost` is called, on a thread of its own, when a stopper that was ready has died while something moves.
    `send_event` tells the server what the stopper did, or what became of it; `turned_at` when the ROS thread last went
    round (monotonic, s).
    """

    def __init__(
        self,
        lost: Callable[[], None],
        send_event: Callable[[StopperEvent], None],
        copy: Child | None = None,
        turned_at: Callable[[], float] = time.monotonic,
    ) -> None:
        self._lost = lost
        self._send_event = send_event
        self._copy = copy
        self._turned_at = turned_at
        self._stopper: Child | None = None
        self._writing = threading.Lock()
        self._moving = threading.Event()
        self._known: dict[Key, Moved] = {}
        self._told: dict[Key, Mapping[str, object]] = {}
        self._matched: dict[Key, int] = {}
        self._waited_for: set[Key] = set()
        self._left: dict[int, bytes] = {}
        self._numbers = itertools.count(1)
        self._problem = ""
        self._failed_at = -AGAIN_S
        self._is_ending = False

    def begin(self, topic: Moved) -> None:
        """Have a stopper that knows the topic: before a command that moves. ROS thread only."""
        self._known[topic.name, topic.type] = topic
        if self._stopper is None and time.monotonic() - self._failed_at >= AGAIN_S and not self._is_ending:
            self._start()
        for known in self._known.values():
            self.tell(known)

    @contextlib.contextmanager
    def leaving(self, service: str, type_name: str, body: bytes) -> Generator[None, None, None]:
        """Inside of this context the stopper makes that call if this process and the server die. ROS thread only."""
        number = next(self._numbers)
        call = {"call": number, "service": service, "type": type_name, "body": body.hex(), "server": os.getppid()}
        line = json.dumps(call).encode() + b"\n"
        if len(line) > MAX_TEXT_CHARS:  # none that cancels a goal, or makes a vehicle stand, is so long
            yield
            return
        self._left[number] = line
        if self._stopper is None and time.monotonic() - self._failed_at >= AGAIN_S and not self._is_ending:
            self._start()
        else:
            self._write(line)
        try:
            yield
        finally:
            self._withdraw(number)

    def wait(self, topic: Moved) -> Steps[Guarded]:
        """Steps until the stopper has matched the subscribers of the topic, at most 2 s, once for each topic."""
        key, started = (topic.name, topic.type), time.monotonic()
        while (
            self._stopper
            and key not in self._waited_for
            and self._matched.get(key, -1) < topic.matched()
            and time.monotonic() - started < READY_S
        ):
            yield POLL_S
        waited_s = round(time.monotonic() - started, 3)
        if self._stopper is None:
            return Guarded(waited_s, self._problem or "it has ended")
        self._waited_for.add(key)
        is_ready = key in self._matched
        return Guarded(waited_s, "" if is_ready else f"it was not ready within {READY_S:g} s")

    def tell(self, topic: Moved) -> None:
        """Tell the stopper what has become of a topic; without effect as long as there is none. From any thread."""
        line = {
            "topic": topic.name,
            "type": topic.type,
            "frame": topic.frame_id if len(topic.frame_id) <= MAX_TEXT_CHARS else "",
            "joints": list(topic.joints),
            "moves": topic.moves,
            "profiles": topic.profiles(),
        }
        key = topic.name, topic.type
        if self._stopper and self._told.get(key) != line:
            self._told[key] = line
            self._write(json.dumps(line).encode() + b"\n")
        self._heed_motion()

    def forget(self, topic: Moved) -> None:
        """The topic is not driven any more."""
        key = topic.name, topic.type
        self._known.pop(key, None)
        self._waited_for.discard(key)
        self._matched.pop(key, None)
        if self._told.pop(key, None):
            self._write(json.dumps({"topic": topic.name, "type": topic.type, "profiles": []}).encode() + b"\n")
        self._heed_motion()

    def end(self) -> None:
        """Let the stopper go: it sends zeros on what it was told that moves, and leaves. What was left is done."""
        for number in list(self._left):
            self._withdraw(number)
        with self._writing:
            self._is_ending = True
            if stopper := self._stopper or self._copy:
                os.close(stopper.lifeline)

    def wait_end(self) -> None:
        """Wait a little for its end, so that nobody else has to; one that has something to stop outlives us."""
        if stopper := self._stopper or self._copy:
            deadline = time.monotonic() + LEAVES_S
            while not stopper.has_ended() and time.monotonic() < deadline:
                time.sleep(POLL_S)

    def _withdraw(self, number: int) -> None:
        if self._left.pop(number, None):
            self._write(json.dumps({"call": number}).encode() + b"\n")

    def _start(self) -> None:
        self._problem, self._told, self._matched, self._waited_for = "", {}, {}, set()
        stopper, self._copy = self._copy, None
        try:
            if stopper is None or stopper.has_ended():
                stopper = spawn()
        except OSError as error:
            self._fail(f"it could not be started: {error}")
            return
        os.set_blocking(stopper.lifeline, False)
        self._stopper = stopper
        for line in self._left.values():
            self._write(line)
        for work in (self._hear, self._beat):
            threading.Thread(target=work, args=(stopper,), daemon=True).start()

    def _fail(self, problem: str) -> None:
        self._problem, self._failed_at = problem, time.monotonic()
        sys.stderr.write(f"there is no stopper: {problem}\n")

    def _beat(self, stopper: Child) -> None:
        unread = 0
        while self._stopper is stopper and not self._is_ending:
            self._moving.wait()
            unread = unread + 1 if self._matched and self._has_unread(stopper) else 0  # it reads once it has come up
            if unread * BEAT_S >= DEAF_S:
                stopper.kill()  # which `_hear` notices
            elif time.monotonic() - self._turned_at() < ROS_HANGS_S:
                self._write(b"\n")
            time.sleep(BEAT_S)

    def _has_unread(self, stopper: Child) -> bool:
        """Whether something was written that the stopper has not read yet."""
        with self._writing:
            return self._stopper is stopper and not self._is_ending and stopper.has_unread()  # else it is closed

    def _hear(self, stopper: Child) -> None:
        """What the stopper tells, until it ends."""
        with contextlib.suppress(ValueError), os.fdopen(stopper.told, encoding="utf-8") as lines:
            for line in lines:
                self._take_in(json.loads(line))
        with self._writing:
            if self._is_ending:
                return
            os.close(stopper.lifeline)
            was_ready, is_moving, self._stopper = bool(self._matched), self._moving.is_set(), None
        stopper.end()  # one that tells nothing any more is none
        if not was_ready:
            self._fail("it ended before it was ready")
        elif is_moving:
            self._tell_event("lost", "the stopper died, and what moved was stopped")
            self._lost()

    def _take_in(self, told: Mapping[str, object]) -> None:
        if "matched" in told:
            self._matched[str(told["topic"]), str(told["type"])] = int(str(told["matched"]))
        else:
            self._tell_event("acted", f"the bridge was {told['why']}: its stopper sent the zeros")

    def _tell_event(self, what: Literal["acted", "lost"], message: str) -> None:
        self._send_event({"event": "stopper", "what": what, "message": message})

    def _heed_motion(self) -> None:
        if any(line["moves"] for line in list(self._told.values())):
            self._moving.set()
        else:
            self._moving.clear()

    def _write(self, data: bytes) -> None:
        """Never waits: a stopper that does not read is none."""
        with self._writing:
            stopper, written = self._stopper, 0
            if stopper is None or self._is_ending:
                return
            try:
                written = os.write(stopper.lifeline, data)
            except BlockingIOError:
                pass
            except OSError:  # it has died, which `_hear` notices
                return
            if written < len(data):
                stopper.kill()
