"""The bridge as the rest of the server sees it: always present, and restarted when it is lost."""

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

# Pauses between starts that fail: 8.5 s together, during which one of the successors should stop what the lost bridge
# kept moving (decision 12). After that a start needs a request, at least 10 s after the last one. A remote robot that
# was reached before may come back at any time: for it the last pause is repeated without end.
_PAUSES_S = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0)
# The shortest time between attempts that requests cause in an outage. ssh starts in a tenth of it.
_AT_ONCE_S = 1.0
# The time limit for the bridge to exit: it gives up after 1.0 s (its GIVE_UP_AFTER_S), plus half a second.
_LEAVE_S = 1.5
# An additional wait, because `Connection.greet` gives up after `Carrier.start_s` and its error says more.
_SETTLED_S = 1.0
# The default for how long a sample may wait in the bridge: the bridge's own minimum (its DRAIN_PERIOD_S).
_DRAIN_S = 0.005
# The most reasons, lapses, outages and reports that are kept: a bridge that is lost repeatedly must not fill the
# memory.
_KEPT_REASONS = 100
# The most repeats whose start is remembered: as many as may run at once (`Repetition.most_running`).
_KEPT_REPEATS = 256
_MOST_REASON = 300
"""The characters that are shown of a reason of the bridge, which names a zone and places."""
_logger = logging.getLogger(__name__)


class Bridge:
    """The connection to one robot: starts a bridge, monitors it, and restarts it.

    `start_carrier` starts a bridge and its carrier. It is called once per start, and raises a `RobotError` with the
    reason if there can be no bridge.

    State of the bridge: `hello` is the running bridge's introduction, `generation` the number of starts, `losses` the
    number of lost bridges, `restarts` the reasons of the last hundred losses, `origin` the ROS installation of the last
    bridge, `failure` the reason why the last start failed ("" after a success). `nodes` are the names of the nodes of
    all bridges: the graph shows those of lost bridges for some seconds more. `outages` are the times during which a
    remote robot was unreachable. `clock` is the robot's clock.

    Sent to the bridge: `rules` returns the compiled rules of the policy, which every bridge gets first (set it before
    `attach`; empty without a policy). `stop_epoch` is sent to every bridge as soon as it is connected. `latch` returns
    the state of the latch for pings to a remote bridge.

    Received from the bridge: `frame_ids` has the frame of the last command on each velocity topic. `lapses` are the
    durations of this server's silence in s, one for each lapse of the link lease; `lapsed_at` is the time of the report
    of the last one (monotonic, in s; 0 before). `on_latched` is called when the latch was set, with the originator, the
    reason, and whether only the bridge's own latch is set so far; `latched_by` has originator and reason in words,
    `latched_at` the time of the report. `kept_out` says before which keep-out zone the bridge last ended what drove the
    robot, and `kept_out_at` when. `relays_ended` has the last counts of cancelled relays, by name,
    `repeats_begun` the time of the report that a repeat has sent its first message (monotonic, in s), and `motions` the
    last report of each motion, by name. `on_spent` is called with name, type and bound of each use of the policy's
    budgets.
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
        self.kept_out = ""
        self.kept_out_at = 0.0
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
        """Start the first bridge process at once, without an event loop. An error is raised by the first request."""
        if self._launched is None and self._supervisor is None:
            self._launched = self._start()

    async def attach(self) -> None:
        """Connect to the bridge in the running event loop, and monitor it from now on. Returns at once."""
        self._attach()

    def _attach(self) -> None:
        if self._supervisor is None and not self._closed:
            self.launch()
            self._outcome = asyncio.get_running_loop().create_future()
            self._supervisor = asyncio.ensure_future(self._supervise())

    async def close(self) -> None:
        """End the stream, wait up to 1.5 s for the bridge to stop the robot and exit, and clean up."""
        self._closed = True
        if self._supervisor:
            self._supervisor.cancel()
            await asyncio.wait({self._supervisor})
        if self._launched and not isinstance(self._launched, RobotError):
            await self._launched.close(_LEAVE_S)
            self._launched = None
        self._settle(LinkError("The link to the robot is closed."))  # no task needs to wait for it any more

    async def __aenter__(self) -> Bridge:
        await self.attach()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # ── requests and subscriptions ─────────────────────────────────────────────────────────────────────────────

    async def request(self, op: str, body: bytes = b"", *, timeout_s: float, **arguments: Any) -> Reply:
        """Send one request of `docs/reference/stream.md`, and return the reply. Cancelling this cancels the request.

        Waits for a bridge that is starting, as long as its carrier allows. `timeout_s` is also sent to the operations
        that accept it.

        Raises:
            BridgeRefused: with the kind of the bridge's error.
            TimedOut: if no reply came within `timeout_s` and a margin.
            BridgeLost: if the bridge died or hung meanwhile; it is being restarted.
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
        """Open a subscription that keeps `all` samples or the `latest`, bounded on each side of the stream.

        Raises as `request`. Equal subscriptions share one in the bridge (`sharing.py`). `drain_s` is how long a sample
        may wait in the bridge; if no subscription is urgent, the bridge sleeps longer. Over a network, at most
        `backlog_bytes` (None: `max_bytes`) wait in the bridge, so that samples arrive fresh. With `head_bytes`, only
        that many of the first bytes of each sample are transferred; with `every_n`, only every n-th sample, while the
        others count as received. With `newest_of_old`, only the newest of the samples that a latched topic replays is
        transferred.
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
        """Write a request now, so that the bridge reads it before everything that is sent later; its reply is awaited
        later.

        Without a bridge, it is written as soon as one is connected, before everything else that waits for that bridge.
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
        """Send a request before all later requests without waiting for its reply. No effect on a bridge that has not
        got its rules yet.
        """
        if self._connection:
            self._connection.tell(op, body)

    async def ready(self) -> Hello:
        """Return the bridge's hello, once it is connected. Raises as `request`."""
        hello = (await self._connected()).hello
        assert hello
        return hello

    @property
    def is_closed(self) -> bool:
        """Whether `close` has been called."""
        return self._closed

    @property
    def is_remote(self) -> bool:
        """Whether a network lies between, so that large messages take time."""
        return self._carrier is not None and self._carrier.is_remote

    @property
    def hello(self) -> Hello | None:
        """The running bridge's introduction; None while there is none."""
        outcome = self._outcome.result() if self._outcome and self._outcome.done() else None
        return outcome.hello if isinstance(outcome, Connection) else None

    @property
    def silent_s(self) -> float:
        """The time since the running bridge's last message, in s; infinite while there is none."""
        outcome = self._outcome.result() if self._outcome and self._outcome.done() else None
        return time.monotonic() - outcome.heard_at if isinstance(outcome, Connection) else math.inf

    @property
    def unheard_s(self) -> float:
        """The time since the last message of any of the bridges, in s; infinite before the first."""
        if math.isfinite(silent_s := self.silent_s):
            return silent_s
        return time.monotonic() - self._heard_at if self._heard_at else math.inf

    @property
    def age_s(self) -> float:
        """The age of the present connection, in s; 0 while there is none."""
        return max(time.monotonic() - self._begun_at, 0.0)

    @property
    def log_tail(self) -> Sequence[str]:
        """The last lines of the bridge's log, if its carrier transports them."""
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
        """Return the running bridge. Wait for one that is starting; start one again if the last attempt is long enough
        ago.
        """
        wanted = self._wanted()
        if not wanted.done():
            # A start that was just requested gets its carrier, which knows how long it may take, only after this wait.
            await asyncio.wait({wanted}, timeout=_SETTLED_S)
            start_s = self._carrier.start_s if self._carrier else 0.0  # without a carrier, the reason is about to come
            wanted = self._outcome or wanted  # the bridge that came may be lost again
            await asyncio.wait({wanted}, timeout=start_s)
            wanted = self._outcome or wanted
            if not wanted.done():
                raise LinkError(f"The bridge was not ready after {start_s:.0f} s.", SLOW_START)
        outcome = wanted.result()
        if isinstance(outcome, RobotError):
            raise outcome.again()
        return outcome

    def _wanted(self) -> asyncio.Future[Connection | RobotError]:
        """Return the future of the running or starting bridge, or of the reason why there is none. Start one again if
        the last attempt is long enough ago.
        """
        self._attach()
        if self._closed or self._outcome is None:
            raise LinkError("The link to the robot is closed.")
        failed = self._outcome.done() and isinstance(self._outcome.result(), RobotError)
        if failed and time.monotonic() >= self._retry_at:
            self._outcome = asyncio.get_running_loop().create_future()
            self._retry.set()
        return self._outcome

    async def _supervise(self) -> None:
        """Run one bridge process after another: at once after a process that had begun to work, otherwise after a pause
        or on request.

        After a failed start there are further ones, because motions of the lost bridge must still be stopped: without
        limit for a remote robot, unless only a person can remove the obstacle.
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
        """Run one bridge process until it ends; return whether it had begun to work, and why it ended."""
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
            self.origin = carrier.origin  # of a remote robot it is known only now
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
        """Record the end of an outage."""
        outage = Outage(self._heard_at, time.monotonic() - self._heard_at)
        self.outages = [*self.outages, outage][-_KEPT_REASONS:]
        back = f"The robot was reached again {outage.lasted_s:.1f} s after its last message."
        self.restarts[-1] += f" {back}"
        _logger.warning("%s", self.restarts[-1])

    def _hear(self, event: Told) -> None:
        """Process an event of the bridge."""
        if event["event"] == "stopper":
            _logger.warning("%s", event["message"])
            return
        if event["event"] == "kept_out":
            self.kept_out, self.kept_out_at = quoted(event["reason"], _MOST_REASON), time.monotonic()
            _logger.warning("what drove the robot was ended: %s", self.kept_out)
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
        for posted in unwritten:  # before tasks that wait for this bridge learn of it
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
