"""The bridge as the rest of the server sees it: always there, started again when it is lost."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any

from ros2_mcp.link.carrier import SLOW_START, Carrier
from ros2_mcp.link.clock import RobotClock
from ros2_mcp.link.connection import Connection, Hello, Posted, Reply
from ros2_mcp.link.sharing import Sharing
from ros2_mcp.link.subscription import Subscription
from ros2_mcp.model.errors import BridgeLost, LinkError, RobotError, Unreachable
from ros2_mcp.model.text import named, quoted
from ros2_mcp.model.times import Outage
from ros2_mcp_common.wire.protocol import Keep, Told

__all__ = ["Bridge", "Hello", "Posted", "Reply", "Subscription"]

# Between lives that do not begin: together 8.5 s, in which one of the successors is to stop what the lost bridge kept
# moving (decision 12). After that a life begins only when a request comes, 10 s after the last one at the earliest. A
# robot elsewhere that had been reached may come back at any time: for it the last pause is repeated without end.
_PAUSES_S = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0)
# Requests in an outage ask for an attempt at once, but not more often than this. Chosen: ssh starts in a tenth of it.
_AT_ONCE_S = 1.0
# The bridge gives itself up after 1.0 s (GIVE_UP_AFTER_S there): half a second more, and nobody is there any more.
_LEAVE_S = 1.5
# `Connection.greet` gives up after `Carrier.start_s`; a little later its error is here, which says more than this one.
_SETTLED_S = 1.0
# As much as the bridge lets a message wait at least (DRAIN_PERIOD_S there).
_DRAIN_S = 0.005
# A bridge that is lost again and again must not fill the memory. Chosen.
_KEPT_REASONS = 100
# As many as may run at once (`Repetition.most_running`).
_KEPT_REPEATS = 256
_logger = logging.getLogger(__name__)


class Bridge:
    """The connection to one robot: starts a bridge, watches it and starts it again.

    `start_carrier` starts a bridge and what carries its stream; it is called once for each life and raises a
    `RobotError` that tells why there is none. `hello` is how the running bridge introduced itself, `generation` the
    number of starts, `losses` how many former ones were lost, `restarts` why the last hundred of them were, `origin`
    what the last one runs in. `nodes` are the names of all its nodes: the graph shows those of lost ones for some
    seconds more. `stop_epoch` is told to every bridge as soon as it is there; `frame_ids` has the frame of the last
    command on each velocity topic, as bridges told it;
    `lapses` for how long this server had been silent, in seconds, each time that a link lease lapsed; `lapsed_at` when
    the last one was heard of (monotonic, in s; 0 before); `outages` the times in which a robot elsewhere was out of
    reach; `failure` says why the last life did not begin, empty once one has. `on_latched` is told by whom and why the
    latch was set; `latched_by` and `latched_at` say it in words, and when the last one was heard of.
    `relays_ended` has the last counts of relays whose caller was cancelled, by name, `repeats_begun` when it was heard
    that the first message of a repeat had been sent (monotonic, in s), `motions` what was told last of each motion, by
    its name. `rules` gives those of the policy, compiled, which every bridge is told first: to be set before
    `attach`; empty without a policy. `on_spent` is told by name, type and bound what was used of the policy's budgets.
    `clock` is the robot's. `latch` gives what pings tell a bridge elsewhere of it.
    """

    def __init__(self, start_carrier: Callable[[], Carrier]) -> None:
        self._start_carrier = start_carrier
        self.rules: Callable[[], bytes] = bytes
        self.on_spent: Callable[[str, str, str], None] = lambda _name, _type, _bound: None
        self.origin = ""
        self.generation = 0
        self.restarts: list[str] = []
        self.losses = 0
        self.nodes: set[str] = set()
        self.stop_epoch = 0
        self.frame_ids: dict[str, str] = {}
        self.relays_ended: dict[str, Mapping[str, Any]] = {}
        self.repeats_begun: dict[str, float] = {}
        self.motions: dict[str, Mapping[str, Any]] = {}
        self.lapses: list[float] = []
        self.outages: list[Outage] = []
        self.lapsed_at = 0.0
        self.failure = ""
        self.latched_by = ""
        self.latched_at = 0.0
        self.on_latched: Callable[[str, str, bool], None] = lambda _by, _reason, _own: None
        self.latch: Callable[[], Mapping[str, Any]] = dict
        self.clock = RobotClock()
        self._launched: Carrier | RobotError | None = None
        self._carrier: Carrier | None = None
        self._connection: Connection | None = None
        self._sharing: Sharing | None = None
        self._supervisor: asyncio.Task[None] | None = None
        self._outcome: asyncio.Future[Connection | RobotError] | None = None
        self._unwritten: list[Posted] = []
        self._heard_at = 0.0
        self._begun_at = math.inf
        self._retry = asyncio.Event()
        self._retry_at = 0.0
        self._closed = False

    # ── start and end ──────────────────────────────────────────────────────────────────────────────────────────

    def launch(self) -> None:
        """Starts the first life at once, needs no event loop; what goes wrong is told to the first request."""
        if self._launched is None and self._supervisor is None:
            self._launched = self._start()

    async def attach(self) -> None:
        """Connects to it in the running event loop and watches over it from now on. Returns at once."""
        self._attach()

    def _attach(self) -> None:
        if self._supervisor is None and not self._closed:
            self.launch()
            self._outcome = asyncio.get_running_loop().create_future()
            self._supervisor = asyncio.ensure_future(self._supervise())

    async def close(self) -> None:
        """Ends the stream, gives the bridge 1.5 s to stop the robot and leave, and leaves nothing behind."""
        self._closed = True
        if self._supervisor:
            self._supervisor.cancel()
            await asyncio.wait({self._supervisor})
        if self._launched and not isinstance(self._launched, RobotError):
            await self._launched.close(_LEAVE_S)
            self._launched = None
        self._settle(LinkError("The link to the robot is closed."))  # nobody waits any more for it to come

    async def __aenter__(self) -> Bridge:
        await self.attach()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # ── requests and subscriptions ─────────────────────────────────────────────────────────────────────────────

    async def request(self, op: str, body: bytes = b"", *, timeout_s: float, **arguments: Any) -> Reply:
        """One request of `docs/reference/stream.md`; cancelling the caller cancels it in the bridge.

        Waits for a bridge that is starting, as long as its carrier allows. `timeout_s` is also sent to the operations
        that take it.

        Raises:
            BridgeRefused: with the kind of error that the bridge answered.
            TimedOut: if no answer came in `timeout_s` and a margin.
            BridgeLost: if the bridge died or hung meanwhile; it is being started again.
            RosNotFound: if there is no ROS 2 here.
            LinkError: if the bridge cannot be started.
        """
        connection = await self._connected()
        return await connection.request(op, body, timeout_s, arguments)

    async def subscribe(
        self,
        topic: str,
        type_name: str,
        qos: Mapping[str, Any],
        *,
        keep: Keep,
        max_samples: int,
        max_bytes: int,
        backlog_bytes: int | None = None,
        head_bytes: int = 0,
        every_n: int = 1,
        newest_of_old: bool = False,
        drain_s: float = _DRAIN_S,
    ) -> Subscription:
        """A new subscription; keeps `all` or the `latest`, bounded on each side of the stream. Raises as `request`.

        Those that are alike share one in the bridge (`sharing.py`).
        `drain_s` is how long a sample may wait in the bridge; where no subscription is in a hurry, it sleeps longer.
        Over a network no more than `backlog_bytes` (None: `max_bytes`) wait in the bridge, so that what comes is no
        older than it must be. With `head_bytes` only so many of the first bytes of each sample come, with `every_n`
        only every n-th sample: those between are counted as received. With `newest_of_old` of what a latched topic
        replays only the newest comes.
        """
        connection = await self._connected()
        assert self._sharing
        if connection.carrier.is_remote and backlog_bytes is not None:
            max_bytes = min(max_bytes, backlog_bytes)
        bounds = {"keep": keep, "max_samples": max_samples, "max_bytes": max_bytes, "drain_s": drain_s}
        bounds |= {"head_bytes": head_bytes} if head_bytes else {}
        bounds |= {"every_n": every_n} if every_n > 1 else {}
        bounds |= {"newest_of_old": True} if newest_of_old else {}
        return await self._sharing.subscribe({"topic": topic, "type": type_name, "qos": qos, **bounds})

    def post(self, op: str, body: bytes = b"", **arguments: Any) -> Posted:
        """Writes a request now, so that the bridge reads it before all that is sent later; its answer is awaited later.

        Where there is no bridge yet, it is written as soon as one is there, before whatever else waits for that bridge.
        Never raises a `LinkError`: awaiting the request does, as `request`.
        """
        posted = Posted(op, body, arguments)
        try:
            outcome = self._wanted()
        except LinkError as error:
            posted.fail(error)
            return posted
        if outcome.done():
            self._write(posted, outcome.result())
        else:
            self._unwritten.append(posted)
        return posted

    def tell(self, op: str, body: bytes) -> None:
        """Sends a request before all later ones and does not wait for its answer. Without effect on a bridge that has
        not been told its rules yet.
        """
        if self._connection:
            self._connection.tell(op, body)

    async def ready(self) -> Hello:
        """The bridge's hello, as soon as it is there; raises as `request`."""
        hello = (await self._connected()).hello
        assert hello
        return hello

    @property
    def is_closed(self) -> bool:
        """Whether `close` has been called."""
        return self._closed

    @property
    def is_remote(self) -> bool:
        """Whether a network lies between, so that large messages take their time."""
        return self._carrier is not None and self._carrier.is_remote

    @property
    def hello(self) -> Hello | None:
        """How the running bridge introduced itself; None while there is none."""
        outcome = self._outcome.result() if self._outcome and self._outcome.done() else None
        return outcome.hello if isinstance(outcome, Connection) else None

    @property
    def silent_s(self) -> float:
        """How long ago the running bridge was last heard of, in s; infinite while there is none."""
        outcome = self._outcome.result() if self._outcome and self._outcome.done() else None
        return time.monotonic() - outcome.heard_at if isinstance(outcome, Connection) else math.inf

    @property
    def unheard_s(self) -> float:
        """How long ago any of its bridges was last heard of, in s; infinite where none ever was."""
        if math.isfinite(silent_s := self.silent_s):
            return silent_s
        return time.monotonic() - self._heard_at if self._heard_at else math.inf

    @property
    def age_s(self) -> float:
        """For how long the present life of the bridge has been connected; 0 while none is."""
        return max(time.monotonic() - self._begun_at, 0.0)

    @property
    def log_tail(self) -> Sequence[str]:
        """The last lines that the bridge wrote to its log, as far as they came along."""
        return self._carrier.log_tail() if self._carrier else []

    # ── its lives ──────────────────────────────────────────────────────────────────────────────────────────────

    def _start(self) -> Carrier | RobotError:
        self.generation += 1
        try:
            carrier = self._start_carrier()
        except RobotError as error:
            return error
        self._carrier, self.origin = carrier, carrier.origin
        return carrier

    async def _connected(self) -> Connection:
        """The running bridge; waits for one that starts, and starts one again that failed a while ago."""
        wanted = self._wanted()
        if not wanted.done():
            # A start that has just been asked for has a carrier, which knows how long it may take, only after this.
            await asyncio.wait({wanted}, timeout=_SETTLED_S)
            start_s = self._carrier.start_s if self._carrier else 0.0  # without one, the reason is about to come
            wanted = self._outcome or wanted  # the bridge that came may be lost already
            await asyncio.wait({wanted}, timeout=start_s)
            wanted = self._outcome or wanted
            if not wanted.done():
                raise LinkError(f"The bridge was not ready after {start_s:.0f} s.", SLOW_START)
        outcome = wanted.result()
        if isinstance(outcome, RobotError):
            raise outcome.again()
        return outcome

    def _wanted(self) -> asyncio.Future[Connection | RobotError]:
        """The running bridge or the one that starts, begun again if it failed a while ago; or why there is none."""
        self._attach()
        if self._closed or self._outcome is None:
            raise LinkError("The link to the robot is closed.")
        failed = self._outcome.done() and isinstance(self._outcome.result(), RobotError)
        if failed and time.monotonic() >= self._retry_at:
            self._outcome = asyncio.get_running_loop().create_future()
            self._retry.set()
        return self._outcome

    async def _supervise(self) -> None:
        """Life after life: at once after one that had begun well, on demand and after a pause when none begins.

        A successor that does not begin is followed by others, for what was set in motion has yet to be stopped: of a
        robot elsewhere without end, unless only a person can change what is in the way.
        """
        failures = 0
        while True:
            begun, reason = await self._live()
            if begun:
                failures = 0
                self.losses += 1
                self.restarts = [*self.restarts, reason.message][-_KEPT_REASONS:]
                continue
            pause_s = _PAUSES_S[min(failures, len(_PAUSES_S) - 1)]
            failures += 1
            if self.nodes and failures < len(_PAUSES_S) and not self.is_remote:
                await asyncio.sleep(pause_s)
                continue
            self._retry_at = time.monotonic() + (min(pause_s, _AT_ONCE_S) if self.is_remote else pause_s)
            self._retry.clear()
            self._settle(reason)
            needs_a_person = isinstance(reason, Unreachable) and reason.is_lasting
            with contextlib.suppress(asyncio.TimeoutError):
                goes_on = self.is_remote and self.nodes and not needs_a_person
                await asyncio.wait_for(self._retry.wait(), pause_s if goes_on else None)
            if not self._retry.is_set():
                self._outcome = asyncio.get_running_loop().create_future()

    async def _live(self) -> tuple[bool, RobotError]:
        """One life of the bridge: whether it had begun, and why it ended."""
        carrier, self._launched = self._launched or self._start(), None
        if isinstance(carrier, RobotError):
            return False, carrier
        told = (lambda: self.stop_epoch, self._hear, self._relay_ended)
        connection = Connection(carrier, *told, rules=self.rules, clock=self.clock, latch=self.latch)
        self._connection = connection
        try:
            reason = await connection.greet()
            if reason:
                return False, reason
            assert connection.hello
            self.origin = carrier.origin  # of a robot elsewhere it is known only now
            if carrier.is_remote and self.nodes:
                self._note_outage()
            self.nodes.add(connection.hello.node)
            self._sharing = Sharing(connection)
            self._begun_at = time.monotonic()
            self._settle(connection)
            reason = await connection.run()
            self._heard_at = connection.heard_at
            self._outcome = asyncio.get_running_loop().create_future()
            return True, reason
        finally:
            self._begun_at = math.inf
            connection.fail(BridgeLost("The link to the robot was closed."))
            if not self._closed:
                carrier.kill()
            await carrier.close(_LEAVE_S)

    def _note_outage(self) -> None:
        """The robot is reached again."""
        outage = Outage(self._heard_at, time.monotonic() - self._heard_at)
        self.outages = [*self.outages, outage][-_KEPT_REASONS:]
        back = f"The robot was reached again {outage.lasted_s:.1f} s after its last message."
        self.restarts[-1] += f" {back}"
        _logger.warning("%s", self.restarts[-1])

    def _hear(self, event: Told) -> None:
        """Takes in what a bridge tells unasked."""
        if event["event"] == "stopper":
            _logger.warning("%s", event["message"])
            return
        if event["event"] == "begun":
            self.repeats_begun[event["name"]] = time.monotonic()
            if len(self.repeats_begun) > _KEPT_REPEATS:
                del self.repeats_begun[next(iter(self.repeats_begun))]
            return
        if event["event"] == "spent":
            self.on_spent(event["name"], event["type"], event["bound"])
            return
        if event["event"] == "motion":
            self.motions[event["name"]] = event["report"]
            if len(self.motions) > _KEPT_REASONS:
                del self.motions[next(iter(self.motions))]
            return
        if event["event"] == "frame":
            self.frame_ids[event["topic"]] = event["frame_id"]
            return
        if event["event"] == "latched":
            by, reason = quoted(event["by"]), quoted(event["reason"])
            _logger.warning("the latch of this robot is set, by %s (%s): what moved was stopped", by, reason)
            self.latched_by, self.latched_at = f"{named(event['by'])}: {reason}", time.monotonic()
            self.on_latched(event["by"], event["reason"], event["own"])
            return
        self.lapsed_at = time.monotonic()
        self.lapses = [*self.lapses, event["silent_s"]][-_KEPT_REASONS:]
        _logger.warning(
            "the link lease lapsed: this server was silent for %.1f s; what it moved, if anything, was stopped",
            event["silent_s"],
        )

    def _relay_ended(self, name: str, counts: Mapping[str, Any]) -> None:
        self.relays_ended[name] = counts
        if len(self.relays_ended) > _KEPT_REASONS:
            del self.relays_ended[next(iter(self.relays_ended))]

    def _settle(self, outcome: Connection | RobotError) -> None:
        self.failure = str(outcome) if isinstance(outcome, RobotError) else ""
        unwritten, self._unwritten = self._unwritten, []
        for posted in unwritten:  # before those who wait for this bridge are told that it is there
            self._write(posted, outcome)
        if self._outcome and not self._outcome.done():
            self._outcome.set_result(outcome)

    @staticmethod
    def _write(posted: Posted, outcome: Connection | RobotError) -> None:
        if not posted.is_open:  # it was withdrawn meanwhile
            return
        if isinstance(outcome, Connection):
            outcome.post(posted)
        else:
            posted.fail(outcome.again())
