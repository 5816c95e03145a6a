"""The bridge's ends of the lifelines: starts two stoppers, reports moving topics to them, and sends heartbeats while
this process is alive.

A stopper (`stopper.py`) is another process, which sends the zeros when this one cannot. There are two, so that one of
them and this process may die together. Each has its own pipe. Only this process holds the writing end, so the kernel
closes the pipe however this process dies. Each line is a JSON object about one topic, or about a call to be made after
a death; an empty line is a heartbeat. See docs/decisions/0030-a-second-process-that-stops.md and
0062-a-third-party-that-stops.md.
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

# The period of beats: a fifth of the silence after which the stopper acts (its SILENCE_S), so four beats may be late.
BEAT_S = 0.05
# After this time without a turn the ROS thread is hung, whatever other threads do, and no beats are sent. It makes a
# turn at least four times a second; twice that period allows for a machine short of processors.
ROS_HANGS_S = 0.5
# A stopper reads every 0.02 s while something moves. One that leaves beats unread for this long is suspended or
# starved, and is replaced.
DEAF_S = 2.0
# The longest wait of the first moving command for the stoppers. A stopper needs 0.1 to 0.4 s for its participant and
# for discovery; a later one, which starts without rclpy loaded, up to a second more.
READY_S = 2.0
# The polling period of that wait. On one machine, a stopper reports its matches within milliseconds.
POLL_S = 0.005
# A stopper that ended before it was ready would probably end again: it is started again only after this time.
AGAIN_S = 10.0
# The longest wait for the stoppers to exit. With nothing moving they exit at once; this process has 1 s for its own
# exit.
LEAVES_S = 0.2
# The longest text in a line: a line has to fit into the pipe beside others. No frame id in ROS is nearly as long.
MAX_TEXT_CHARS = 4000

Key = tuple[str, str]


class Moved(Protocol):
    """A velocity topic, as the lifeline reads it."""

    name: str
    type: str
    frame_id: str
    joints: tuple[str, ...]
    moves: bool

    def profiles(self) -> list[tuple[str, str]]:
        """Return the distinct pairs of reliability and durability of its publishers."""
        ...

    def matched(self) -> int:
        """Return the number of matched subscribers."""
        ...


class Guarded(NamedTuple):
    """How long a command waited for the stoppers, in s, and why it is sent without a stopper (else "")."""

    waited_s: float = 0.0
    problem: str = ""


class _Stopper:
    """One of the stoppers: its process, what was sent to it, and its matched subscribers.

    `child` is None before the process starts and after it ends; `copy` is a process forked in advance, if there is one.
    `heard` is called with each line that the stopper sends; `ended` is called when it ended, with whether it had been
    ready. Both are called on a separate thread.
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
        """Start the process unless it runs or has failed recently; return whether it was started now.

        ROS thread only.
        """
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
        """Send the stopper this line about a topic, unless it was the last line sent."""
        if self.child and self.told.get(key) != line:
            self.told[key] = line
            self.write(json.dumps(line).encode() + b"\n")

    def forget(self, key: Key) -> None:
        """Notify the stopper that the topic is no longer driven."""
        self.matched.pop(key, None)
        if self.told.pop(key, None):
            self.write(json.dumps({"topic": key[0], "type": key[1], "profiles": []}).encode() + b"\n")

    def beat(self, *, hangs: bool) -> None:
        """Send one beat, unless the bridge `hangs`. Kill a stopper that no longer reads."""
        child = self.child
        if child is None:
            return
        self._unread = self._unread + 1 if self.matched and self._has_unread(child) else 0  # it reads once it is up
        if self._unread * BEAT_S >= DEAF_S:
            child.kill()  # which `_hear` notices
        elif not hangs:
            self.write(b"\n")

    def end(self) -> None:
        """Close the lifeline for good: the stopper sends zeros on topics that move, and exits."""
        with self._writing:
            self._is_ending = True
            if child := self.child or self._copy:
                os.close(child.lifeline)

    def has_left(self) -> bool:
        """Return whether the process has ended or was never started."""
        child = self.child or self._copy
        return child is None or child.has_ended()

    def write(self, data: bytes) -> None:
        """Write to the lifeline without blocking. Kill a stopper whose pipe is full: it does not read."""
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
        """Return whether the stopper has not yet read everything that was written."""
        with self._writing:
            return self.child is child and not self._is_ending and child.has_unread()  # if not, it is closed

    def _hear(self, child: Child) -> None:
        """Pass on the lines that the stopper sends, until it ends."""
        with contextlib.suppress(ValueError), os.fdopen(child.told, encoding="utf-8") as lines:
            for line in lines:
                self._heard(self, json.loads(line))
        with self._writing:
            if self._is_ending:
                return
            os.close(child.lifeline)
            was_ready, self.child = bool(self.matched), None
        child.end()  # a stopper that closed its output is useless
        if not was_ready:
            self._fail("it ended before it was ready")
        self._ended(was_ready)

    def _fail(self, problem: str) -> None:
        self.problem, self._failed_at = problem, time.monotonic()
        sys.stderr.write(f"{self._name}, a stopper, does not run: {problem}\n")


class Lifeline:
    """The two stoppers, started by the first command that moves; `copies` are processes forked in advance, by name.

    `lost` is called, on a separate thread, when a stopper that was ready has died while something moves.
    `send_event` reports to the server what the stoppers did, or that one died; `turned_at` returns when the ROS
    thread made its last turn (monotonic, s).
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
        """Start the stoppers, if necessary, and send them the topic; called before a command that moves.

        ROS thread only.
        """
        self._known[topic.name, topic.type] = topic
        self._start()
        for known in self._known.values():
            self.tell(known)

    @contextlib.contextmanager
    def leaving(self, service: str, type_name: str, body: bytes) -> Generator[None, None, None]:
        """A context manager during which a stopper makes this call if this process and the server die.

        ROS thread only.
        """
        number = next(self._numbers)
        call = {"call": number, "service": service, "type": type_name, "body": body.hex(), "server": os.getppid()}
        line = json.dumps(call).encode() + b"\n"
        if len(line) > MAX_TEXT_CHARS:  # no request that cancels a goal or stops a vehicle is so long
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
        """Steps that wait, once for each topic and at most 2 s, until the stoppers have matched the
        subscribers of the topic.
        """
        key, started, has_waited = (topic.name, topic.type), time.monotonic(), False
        while (
            (running := self._running())
            and key not in self._waited_for
            and any(stopper.matched.get(key, -1) < topic.matched() for stopper in running)
            and time.monotonic() - started < READY_S
        ):
            has_waited = True
            yield POLL_S
        waited_s = round(time.monotonic() - started, 3) if has_waited else 0.0
        if not running:
            problems = [stopper.problem for stopper in self._stoppers if stopper.problem]
            return Guarded(waited_s, problems[0] if problems else "it has ended")
        self._waited_for.add(key)
        is_ready = any(key in stopper.matched for stopper in running)
        return Guarded(waited_s, "" if is_ready else f"it was not ready within {READY_S:g} s")

    def tell(self, topic: Moved) -> None:
        """Send the stoppers the current state of a topic; without effect while none runs. Thread-safe."""
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
        """Notify the stoppers that the topic is no longer driven."""
        key = topic.name, topic.type
        self._known.pop(key, None)
        self._waited_for.discard(key)
        for stopper in self._stoppers:
            stopper.forget(key)
        self._heed_motion()

    def end(self) -> None:
        """Withdraw the calls left to the stoppers and close the lifelines: they send zeros on
        topics that move, and exit.
        """
        for number in list(self._left):
            self._withdraw(number)
        self._is_ending = True
        for stopper in self._stoppers:
            stopper.end()

    def wait_end(self) -> None:
        """Wait up to 0.2 s for the stoppers to exit, and reap them.

        A stopper that still has something to stop outlives this process.
        """
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
        """Start the stoppers that do not run, and send each new stopper the calls that are left to be made."""
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
        elif stopper in self._running()[:1]:  # both do the same: one report is enough
            self._tell_event("acted", f"the bridge was {told['why']}: its stopper sent the zeros")

    def _tell_event(self, what: Literal["acted", "lost"], message: str) -> None:
        self._send_event({"event": "stopper", "what": what, "message": message})

    def _heed_motion(self) -> None:
        if any(line["moves"] for stopper in self._stoppers for line in list(stopper.told.values())):
            self._moving.set()
        else:
            self._moving.clear()
