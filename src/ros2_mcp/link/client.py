"""The bridge as the rest of the server sees it: always there, started again when it is lost."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any

from ros2_mcp.link.carrier import Carrier
from ros2_mcp.link.connection import Connection, Hello, Reply
from ros2_mcp.link.subscription import Subscription
from ros2_mcp.model.errors import BridgeLost, LinkError, RobotError
from ros2_mcp_bridge.protocol import FrameIdChanged, Keep, Lapsed

__all__ = ["Bridge", "Hello", "Reply", "Subscription"]

# Between lives that do not begin: together 8.5 s, in which one of the successors is to stop what the lost bridge kept
# moving (decision 12). After that a life begins only when a request comes, 10 s after the last one at the earliest.
_PAUSES_S = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0)
# The bridge gives itself up after 1.0 s (GIVE_UP_AFTER_S there): half a second more, and nobody is there any more.
_LEAVE_S = 1.5
# Creating an entity can block for up to 3 s inside Fast DDS after a peer was killed (decision 12).
_SUBSCRIBE_S = 5.0
# `Connection.greet` gives up after `Carrier.start_s`; a little later its error is here, which says more than this one.
_SETTLED_S = 1.0
# As much as the bridge lets a message wait at least (DRAIN_PERIOD_S there).
_DRAIN_S = 0.005
# A bridge that is lost again and again must not fill the memory. Chosen.
_KEPT_REASONS = 100
_logger = logging.getLogger(__name__)


class Bridge:
    """The connection to one robot: starts a bridge, watches it and starts it again.

    `start_carrier` starts a bridge and what carries its stream; it is called once for each life and raises a
    `RobotError` that tells why there is none. `hello` is how the running bridge introduced itself, `generation` the
    number of starts, `restarts` why each former one was lost, `origin` what the last one runs in. `nodes` are the names
    of all its nodes: the graph shows those of lost ones for some seconds more. `stop_epoch` is told to every bridge as
    soon as it is there; `frame_ids` has the frame of the last command on each velocity topic, as bridges told it;
    `lapses` for how long this server had been silent, in seconds, each time that a link lease lapsed.
    """

    def __init__(self, start_carrier: Callable[[], Carrier]) -> None:
        self._start_carrier = start_carrier
        self.origin = ""
        self.generation = 0
        self.restarts: list[str] = []
        self.nodes: set[str] = set()
        self.stop_epoch = 0
        self.frame_ids: dict[str, str] = {}
        self.lapses: list[float] = []
        self._launched: Carrier | RobotError | None = None
        self._carrier: Carrier | None = None
        self._supervisor: asyncio.Task[None] | None = None
        self._outcome: asyncio.Future[Connection | RobotError] | None = None
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
        drain_s: float = _DRAIN_S,
    ) -> Subscription:
        """A new subscription; keeps `all` or the `latest`, bounded on each side of the stream. Raises as `request`.

        `drain_s` is how long a sample may wait in the bridge; where no subscription is in a hurry, it sleeps longer.
        """
        connection = await self._connected()
        subscription = Subscription(keep, max_samples, max_bytes, connection.unsubscribe)
        bounds = {"keep": keep, "max_samples": max_samples, "max_bytes": max_bytes, "drain_s": drain_s}
        arguments = {"topic": topic, "type": type_name, "qos": qos, **bounds}
        await connection.subscribe(subscription, _SUBSCRIBE_S, arguments)
        return subscription

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
    def hello(self) -> Hello | None:
        """How the running bridge introduced itself; None while there is none."""
        outcome = self._outcome.result() if self._outcome and self._outcome.done() else None
        return outcome.hello if isinstance(outcome, Connection) else None

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
        await self.attach()
        if self._closed or self._outcome is None:
            raise LinkError("The link to the robot is closed.")
        failed = self._outcome.done() and isinstance(self._outcome.result(), RobotError)
        if failed and time.monotonic() >= self._retry_at:
            self._outcome = asyncio.get_running_loop().create_future()
            self._retry.set()
        if not self._outcome.done():
            # A start that has just been asked for has a carrier, which knows how long it may take, only after this.
            await asyncio.wait({self._outcome}, timeout=_SETTLED_S)
            start_s = self._carrier.start_s if self._carrier else 0.0  # without one, the reason is about to come
            await asyncio.wait({self._outcome}, timeout=start_s)
            if not self._outcome.done():
                raise LinkError(f"The bridge was not ready after {start_s:.0f} s.", "Run: ros2-mcp doctor")
        outcome = self._outcome.result()
        if isinstance(outcome, RobotError):
            raise type(outcome)(outcome.message, outcome.hint)
        return outcome

    async def _supervise(self) -> None:
        """Life after life: at once after one that had begun well, on demand and after a pause when none begins.

        A successor that does not begin is followed by others, for what was set in motion has yet to be stopped.
        """
        failures = 0
        while True:
            begun, reason = await self._live()
            if begun:
                failures = 0
                self.restarts = [*self.restarts, reason.message][-_KEPT_REASONS:]
                continue
            pause_s = _PAUSES_S[min(failures, len(_PAUSES_S) - 1)]
            failures += 1
            if self.nodes and failures < len(_PAUSES_S):
                await asyncio.sleep(pause_s)
                continue
            self._retry_at = time.monotonic() + pause_s
            self._retry.clear()
            self._settle(reason)
            await self._retry.wait()

    async def _live(self) -> tuple[bool, RobotError]:
        """One life of the bridge: whether it had begun, and why it ended."""
        carrier, self._launched = self._launched or self._start(), None
        if isinstance(carrier, RobotError):
            return False, carrier
        connection = Connection(carrier, lambda: self.stop_epoch, self._hear)
        try:
            reason = await connection.greet()
            if reason:
                return False, reason
            assert connection.hello
            self.nodes.add(connection.hello.node)
            self._settle(connection)
            reason = await connection.run()
            self._outcome = asyncio.get_running_loop().create_future()
            return True, reason
        finally:
            connection.fail(BridgeLost("The link to the robot was closed."))
            if not self._closed:
                carrier.kill()
            await carrier.close(_LEAVE_S)

    def _hear(self, event: FrameIdChanged | Lapsed) -> None:
        """Takes in what a bridge tells unasked."""
        if event["event"] == "frame":
            self.frame_ids[event["topic"]] = event["frame_id"]
            return
        self.lapses = [*self.lapses, event["silent_s"]][-_KEPT_REASONS:]
        _logger.warning(
            "the link lease lapsed: this server was silent for %.1f s, and what it moved was stopped", event["silent_s"]
        )

    def _settle(self, outcome: Connection | RobotError) -> None:
        if self._outcome and not self._outcome.done():
            self._outcome.set_result(outcome)
