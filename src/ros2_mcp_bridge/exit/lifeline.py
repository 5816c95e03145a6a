"""The bridge's ends of the lifelines: has two stoppers, tells them what moves, and beats as long as this process lives.

A stopper (`stopper.py`) is another process, which sends the zeros where this one cannot. There are two, so that one of
them and this process may die together. Each has a pipe of its own. Only this process holds
the writing end, so that the kernel closes it however this process dies. A line is a JSON object about one
topic, or about a call that is left to be made; an empty one is a beat. See
docs/decisions/0030-a-second-process-that-stops.md and 0062-a-third-party-that-stops.md.
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

from ros2_mcp_bridge.exit.spawning import Child, spawn
from ros2_mcp_bridge.request import Steps
from ros2_mcp_common.wire.protocol import StopperEvent

# A fifth of the silence after which the stopper acts (SILENCE_S there): four beats may be late. Chosen.
BEAT_S = 0.05
# A ROS thread goes round four times a second at least. One that has not for so long hangs, whatever other threads do:
# then there are no beats. Chosen: twice as long, as a machine that is short of processors makes it late.
ROS_HANGS_S = 0.5
# A stopper reads every 0.02 s while something moves. One that leaves beats unread for so long is stopped, or starves:
# it is none. Chosen.
DEAF_S = 2.0
# Decided: the first command that moves waits no longer for the stoppers. One needs 0.1 to 0.4 s, for its participant
# and for discovery; a later one, which begins without rclpy, up to a second more.
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
    """How long a command waited for the stoppers, in s, and in words why it goes without one; "" if it does not."""

    waited_s: float = 0.0
    problem: str = ""


class _Stopper:
    """One of the stoppers: its process, what that was told, and what it has matched.

    `child` is None until the process is to begin, and after its end; `copy` is the first process, if there is one.
    `heard` is called with each line that it tells, and `ended` with whether it was ready when it ended, both on a
    thread of its own.
    """

    def __init__(
        self,
        name: str,
        copy: Child | None,
        heard: Callable[[_Stopper, Mapping[str, object]], None],
        ended: Callable[[bool], None],
    ) -> None:
        self.child: Child | None = None
        self.problem = ""
        self.told: dict[Key, Mapping[str, object]] = {}
        self.matched: dict[Key, int] = {}
        self._name = name
        self._copy = copy
        self._heard = heard
        self._ended = ended
        self._writing = threading.Lock()
        self._unread = 0
        self._failed_at = -AGAIN_S
        self._is_ending = False

    def start(self) -> bool:
        """Have it begin if it does not run, and has not just failed to; whether it begins now. ROS thread only."""
        if self.child is not None or self._is_ending or time.monotonic() - self._failed_at < AGAIN_S:
            return False
        self.problem, self.told, self.matched, self._unread = "", {}, {}, 0
        child, self._copy = self._copy, None
        try:
            if child is None or child.has_ended():
                child = spawn(self._name)
        except OSError as error:
            self._fail(f"it could not be started: {error}")
            return False
        os.set_blocking(child.lifeline, False)
        self.child = child
        threading.Thread(target=self._hear, args=(child,), daemon=True).start()
        return True

    def tell(self, key: Key, line: Mapping[str, object]) -> None:
        """Tell it of a topic, if it does not know that already."""
        if self.child and self.told.get(key) != line:
            self.told[key] = line
            self.write(json.dumps(line).encode() + b"\n")

    def forget(self, key: Key) -> None:
        """Tell it that the topic is not driven any more."""
        self.matched.pop(key, None)
        if self.told.pop(key, None):
            self.write(json.dumps({"topic": key[0], "type": key[1], "profiles": []}).encode() + b"\n")

    def beat(self, *, hangs: bool) -> None:
        """One beat, which is left out where the bridge `hangs`; ends one that reads no more."""
        child = self.child
        if child is None:
            return
        self._unread = self._unread + 1 if self.matched and self._has_unread(child) else 0  # it reads once it is up
        if self._unread * BEAT_S >= DEAF_S:
            child.kill()  # which `_hear` notices
        elif not hangs:
            self.write(b"\n")

    def end(self) -> None:
        """Let it go: it sends zeros on what it was told that moves, and leaves."""
        with self._writing:
            self._is_ending = True
            if child := self.child or self._copy:
                os.close(child.lifeline)

    def has_left(self) -> bool:
        """Whether it has ended, or never was."""
        child = self.child or self._copy
        return child is None or child.has_ended()

    def write(self, data: bytes) -> None:
        """Never waits: a stopper that does not read is none."""
        with self._writing:
            child, written = self.child, 0
            if child is None or self._is_ending:
                return
            try:
                written = os.write(child.lifeline, data)
            except BlockingIOError:
                pass
            except OSError:  # it has died, which `_hear` notices
                return
            if written < len(data):
                child.kill()

    def _has_unread(self, child: Child) -> bool:
        """Whether something was written that it has not read yet."""
        with self._writing:
            return self.child is child and not self._is_ending and child.has_unread()  # else it is closed

    def _hear(self, child: Child) -> None:
        """What it tells, until it ends."""
        with contextlib.suppress(ValueError), os.fdopen(child.told, encoding="utf-8") as lines:
            for line in lines:
                self._heard(self, json.loads(line))
        with self._writing:
            if self._is_ending:
                return
            os.close(child.lifeline)
            was_ready, self.child = bool(self.matched), None
        child.end()  # one that tells nothing any more is none
        if not was_ready:
            self._fail("it ended before it was ready")
        self._ended(was_ready)

    def _fail(self, problem: str) -> None:
        self.problem, self._failed_at = problem, time.monotonic()
        sys.stderr.write(f"{self._name}, a stopper, does not run: {problem}\n")


class Lifeline:
    """The stoppers, told to begin by the first command that moves; `copies` are their first processes by their names.

    `lost` is called, on a thread of its own, when a stopper that was ready has died while something moves.
    `send_event` tells the server what the stoppers did, or what became of one; `turned_at` when the ROS thread last
    went round (monotonic, s).
    """

    def __init__(
        self,
        lost: Callable[[], None],
        send_event: Callable[[StopperEvent], None],
        copies: Mapping[str, Child | None],
        turned_at: Callable[[], float] = time.monotonic,
    ) -> None:
        self._lost = lost
        self._send_event = send_event
        self._turned_at = turned_at
        self._stoppers = [_Stopper(name, copy, self._take_in, self._has_ended) for name, copy in copies.items()]
        self._beating: threading.Thread | None = None
        self._moving = threading.Event()
        self._known: dict[Key, Moved] = {}
        self._waited_for: set[Key] = set()
        self._left: dict[int, bytes] = {}
        self._numbers = itertools.count(1)
        self._is_ending = False

    def begin(self, topic: Moved) -> None:
        """Have stoppers that know the topic: before a command that moves. ROS thread only."""
        self._known[topic.name, topic.type] = topic
        self._start()
        for known in self._known.values():
            self.tell(known)

    @contextlib.contextmanager
    def leaving(self, service: str, type_name: str, body: bytes) -> Generator[None, None, None]:
        """Inside of this context a stopper makes that call if this process and the server die. ROS thread only."""
        number = next(self._numbers)
        call = {"call": number, "service": service, "type": type_name, "body": body.hex(), "server": os.getppid()}
        line = json.dumps(call).encode() + b"\n"
        if len(line) > MAX_TEXT_CHARS:  # none that cancels a goal, or makes a vehicle stand, is so long
            yield
            return
        self._start()
        self._left[number] = line
        for stopper in self._stoppers:
            stopper.write(line)
        try:
            yield
        finally:
            self._withdraw(number)

    def wait(self, topic: Moved) -> Steps[Guarded]:
        """Steps until the stoppers have matched the subscribers of the topic, at most 2 s, once for each topic."""
        key, started = (topic.name, topic.type), time.monotonic()
        while (
            (running := self._running())
            and key not in self._waited_for
            and any(stopper.matched.get(key, -1) < topic.matched() for stopper in running)
            and time.monotonic() - started < READY_S
        ):
            yield POLL_S
        waited_s = round(time.monotonic() - started, 3)
        if not running:
            problems = [stopper.problem for stopper in self._stoppers if stopper.problem]
            return Guarded(waited_s, problems[0] if problems else "it has ended")
        self._waited_for.add(key)
        is_ready = any(key in stopper.matched for stopper in running)
        return Guarded(waited_s, "" if is_ready else f"it was not ready within {READY_S:g} s")

    def tell(self, topic: Moved) -> None:
        """Tell the stoppers what has become of a topic; without effect as long as there is none. From any thread."""
        line = {
            "topic": topic.name,
            "type": topic.type,
            "frame": topic.frame_id if len(topic.frame_id) <= MAX_TEXT_CHARS else "",
            "joints": list(topic.joints),
            "moves": topic.moves,
            "profiles": topic.profiles(),
        }
        for stopper in self._stoppers:
            stopper.tell((topic.name, topic.type), line)
        self._heed_motion()

    def forget(self, topic: Moved) -> None:
        """The topic is not driven any more."""
        key = topic.name, topic.type
        self._known.pop(key, None)
        self._waited_for.discard(key)
        for stopper in self._stoppers:
            stopper.forget(key)
        self._heed_motion()

    def end(self) -> None:
        """Let the stoppers go: they send zeros on what they were told that moves, and leave. What was left is done."""
        for number in list(self._left):
            self._withdraw(number)
        self._is_ending = True
        for stopper in self._stoppers:
            stopper.end()

    def wait_end(self) -> None:
        """Wait a little for their end, so that nobody else has to; those that have something to stop outlive us."""
        deadline = time.monotonic() + LEAVES_S
        while not all(stopper.has_left() for stopper in self._stoppers) and time.monotonic() < deadline:
            time.sleep(POLL_S)

    def _running(self) -> list[_Stopper]:
        return [stopper for stopper in self._stoppers if stopper.child]

    def _withdraw(self, number: int) -> None:
        if self._left.pop(number, None):
            for stopper in self._stoppers:
                stopper.write(json.dumps({"call": number}).encode() + b"\n")

    def _start(self) -> None:
        """Have those begin that do not run. One that is new knows what is left to be called."""
        for stopper in self._stoppers:
            if stopper.start():
                self._waited_for.clear()
                for line in self._left.values():
                    stopper.write(line)
        if self._beating is None and self._running():
            self._beating = threading.Thread(target=self._beat, daemon=True)
            self._beating.start()

    def _beat(self) -> None:
        while not self._is_ending:
            self._moving.wait()
            hangs = time.monotonic() - self._turned_at() >= ROS_HANGS_S
            for stopper in self._stoppers:
                stopper.beat(hangs=hangs)
            time.sleep(BEAT_S)

    def _has_ended(self, was_ready: bool) -> None:
        if was_ready and self._moving.is_set():
            self._tell_event("lost", "a stopper died, and what moved was stopped")
            self._lost()

    def _take_in(self, stopper: _Stopper, told: Mapping[str, object]) -> None:
        if "matched" in told:
            stopper.matched[str(told["topic"]), str(told["type"])] = int(str(told["matched"]))
        elif stopper in self._running()[:1]:  # they act alike: one of them is enough to tell
            self._tell_event("acted", f"the bridge was {told['why']}: its stopper sent the zeros")

    def _tell_event(self, what: Literal["acted", "lost"], message: str) -> None:
        self._send_event({"event": "stopper", "what": what, "message": message})

    def _heed_motion(self) -> None:
        if any(line["moves"] for stopper in self._stoppers for line in list(stopper.told.values())):
            self._moving.set()
        else:
            self._moving.clear()
