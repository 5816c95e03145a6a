"""The connection to one bridge process: requests out, replies and samples in."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, cast
from weakref import WeakSet

from ros2_mcp.link.carrier import SLOW_START, Carrier
from ros2_mcp.link.clock import RobotClock
from ros2_mcp.link.heartbeat import PING_S, Heartbeat
from ros2_mcp.link.outflow import Outflow
from ros2_mcp.model.errors import BadInput, BridgeLost, BridgeRefused, LinkError, RobotError, TimedOut
from ros2_mcp_common.wire.limits import NO_HURRY_S, WINDOW_BYTES
from ros2_mcp_common.wire.packets import Packet, PacketError, PacketReader, pack
from ros2_mcp_common.wire.pieces import Lanes
from ros2_mcp_common.wire.protocol import PROTOCOL, Counts, Failure, Hello, Samples, Told

# The margin beyond the bridge's own time limit before a request times out: for the transfer and for late turns of the
# bridge.
MARGIN_S = 2.0
_PING = 0
_POLICY = -1
_SHOWN_LINES = 5
_BOUNDED_BY_THE_BRIDGE = ("call", "wait_endpoints")
_NEVER_CANCELLED = ("unsubscribe", "stop", "zero")
# A request with a body up to this size does not wait until the carrier has room, and overtakes large requests that do:
# a goal must be cancelled without waiting for an image. It adds no more than headers do, which never wait.
_SMALL_BODY = 1024


@dataclass(frozen=True, slots=True)
class Reply:
    """The bridge's reply to one request: named results, and bytes for some requests."""

    ok: Mapping[str, Any]
    body: bytes


class Posted:
    """A request that is written when it is posted, or later before everything else that waits. Awaiting it returns its
    reply.

    It has no time limit, and stays open if the task that awaits it is cancelled; `cancel` withdraws it. Awaiting it
    raises `BridgeRefused` with the bridge's error, and `LinkError` if no bridge answered.
    """

    def __init__(self, op: str, body: bytes, arguments: Mapping[str, object]) -> None:
        self.op = op
        self.body = body
        self.arguments = arguments
        self.answer: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self.answer.add_done_callback(_retrieve)
        self.send_cancel: Callable[[], None] = lambda: None

    def __await__(self) -> Generator[Any, None, Reply]:
        return asyncio.shield(self.answer).__await__()

    @property
    def is_open(self) -> bool:
        """Whether it was not answered, withdrawn or lost."""
        return not self.answer.done()

    @property
    def error(self) -> BaseException | None:
        """The error that it was answered with, or lost by; None otherwise."""
        return self.answer.exception() if self.answer.done() and not self.answer.cancelled() else None

    def fail(self, error: RobotError) -> None:
        """Fail the request, which was not written because there is no bridge."""
        self.answer.set_exception(error)

    def cancel(self) -> None:
        """Withdraw the request, before anything that is sent later. No effect once it is answered."""
        if self.answer.cancel():
            self.send_cancel()


class Receiver(Protocol):
    """The receiver of the samples of one subscription in the bridge; the subscription has this number there."""

    number: int | None

    def arrived(self, header: Samples, body: bytes) -> None:
        """Take in a packet of samples."""
        ...

    def count(self, totals: Counts) -> None:
        """Take in the bridge's present totals."""
        ...

    def lose(self, error: LinkError) -> None:
        """Take note that the bridge is gone: nothing more will arrive."""
        ...


@dataclass(slots=True)
class _Open:
    """A request without an answer. It is kept here if its caller gives up, because a late answer may need to be
    undone.
    """

    answer: asyncio.Future[Reply]
    subscription: Receiver | None = None
    relay: str = ""
    has_left: bool = False
    at_answer: Callable[[Mapping[str, Any]], None] | None = None


class Connection:
    """The exchange of packets with one bridge; `run` returns why it ended.

    Each ping has the link lease and the result of `stop_epoch`. `hear` is called with the bridge's events, and
    `relay_ended` with the name and the last counts of a relay whose caller was cancelled. `rules` returns the compiled
    rules of the policy, which the bridge gets before anything else; empty without a policy. `clock` gets every reply to
    a ping. `latch` returns the state of the latch for pings to a remote bridge, which cannot see it.
    """

    def __init__(
        self,
        carrier: Carrier,
        stop_epoch: Callable[[], int] = lambda: 0,
        hear: Callable[[Told], None] = lambda _: None,
        relay_ended: Callable[[str, Mapping[str, Any]], None] = lambda _name, _counts: None,
        *,
        rules: Callable[[], bytes] = bytes,
        clock: RobotClock | None = None,
        latch: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        loop = asyncio.get_running_loop()
        self.carrier = carrier
        self._stop_epoch = stop_epoch
        self._hear = hear
        self._relay_ended = relay_ended
        self._rules = rules
        self._has_rules = False
        self._clock = clock or RobotClock()
        self._latch = latch
        self.hello: Hello | None = None
        self._greeted: asyncio.Future[None] = loop.create_future()
        self._ended: asyncio.Future[LinkError | None] = loop.create_future()
        self._reader = PacketReader()
        self._lanes = Lanes()
        self._window_bytes = WINDOW_BYTES if carrier.is_remote else 0
        self._outflow = Outflow(carrier.write, self._window_bytes)
        self._heartbeat = Heartbeat(carrier, self._ping, self._is_at_rest)
        self._heard_s = 0.0  # by the bridge's own monotonic clock
        self._numbers = itertools.count(1)
        self._open: dict[int, _Open] = {}
        self._subscriptions: dict[int, Receiver] = {}
        self._hurried: WeakSet[Receiver] = WeakSet()
        self._writing = asyncio.Lock()

    # ── its life ───────────────────────────────────────────────────────────────────────────────────────────────

    async def greet(self) -> LinkError | None:
        """Open the carrier and wait for the bridge's hello; return the error if that fails, else None."""
        await self.carrier.open(self._received, lambda: self._end(None))
        if rules := self._rules():
            self._send({"id": _POLICY, "op": "policy"}, rules)
            self._has_rules = True
        if self.carrier.is_remote:
            self._ping()
        start_s = self.carrier.start_s
        await asyncio.wait({self._greeted, self._ended}, timeout=start_s, return_when=asyncio.FIRST_COMPLETED)
        if self._greeted.done():
            return None
        if not self._ended.done():
            self._end(LinkError(f"{self._name} was not ready after {start_s:.0f} s.{self._last_words()}", SLOW_START))
        return await self._reason()

    @property
    def heard_at(self) -> float:
        """The time of the bridge's last bytes (monotonic, in s)."""
        return self._heartbeat.heard_at

    async def run(self) -> LinkError:
        """Monitor a bridge that has sent its hello; return why it was lost, after all waiting requests got that
        error.
        """
        watch = asyncio.ensure_future(self._heartbeat.until_silent())
        try:
            await asyncio.wait({watch, self._ended}, return_when=asyncio.FIRST_COMPLETED)
            if watch.done():
                self._end(self._lost(watch.result()))
            reason = await self._reason()
        finally:
            watch.cancel()
        self.fail(reason)
        return reason

    def fail(self, reason: LinkError) -> None:
        """Fail all waiting requests and subscriptions with this error."""
        for request in self._open.values():
            if not request.answer.done():
                request.answer.set_exception(type(reason)(reason.message, reason.hint))
        for subscription in self._subscriptions.values():
            subscription.lose(reason)
        self._open.clear()
        self._subscriptions.clear()
        self._end(reason)

    async def _reason(self) -> LinkError:
        reason = await self._ended
        if not reason and not self.hello:
            reason = await self.carrier.failure()
        return reason or self._lost(await self.carrier.ending(), has_ended=True)

    def _lost(self, what: str, *, has_ended: bool = False) -> LinkError:
        if not self.hello:
            return LinkError(f"{self._name} {what} before it was ready.{self._last_words()}", "Run: ros2-mcp doctor")
        last_words = self._last_words() if has_ended else ""
        stop = "what this server drove is being stopped, but goals go on"
        if self.carrier.is_remote:  # it is unknown here which message it received last
            stop = (
                f"the bridge stops what this server drove {self.carrier.lease_s:g} s after the last message it received"
            )
        return BridgeLost(
            f"{self._name} {what} and is started again.{last_words}",
            f"Calls under way may or may not have been carried out, and {stop}: check the robot's state, then call "
            "again.",
        )

    @property
    def _name(self) -> str:
        return f"The bridge ({self.carrier.describe()})"

    def _last_words(self) -> str:
        lines = self.carrier.log_tail()[-_SHOWN_LINES:]
        return " Its last words: " + " | ".join(lines) if lines else ""

    def _end(self, reason: LinkError | None) -> None:
        if not self._ended.done():
            self._ended.set_result(reason)

    def _is_at_rest(self) -> bool:
        """Return whether nothing waits for the bridge of this machine. Over a network never: there pings also carry the
        latch and measure the clock.
        """
        return not (self.carrier.is_remote or self._open or self._hurried.intersection(self._subscriptions.values()))

    def _ping(self, next_s: float = PING_S) -> None:
        told: dict[str, Any] = {"lease_s": self.carrier.lease_s * next_s / PING_S, "epoch": self._stop_epoch()}
        told["sent_ns"] = self._clock.sending_ns()
        if self.carrier.is_remote:
            # From `heard_s` the bridge computes how long this packet was in transit; see its LATE_S.
            told |= {"heard_s": self._heard_s, **self._latch()}
        self._send({"id": _PING, "op": "ping", "window_bytes": self._window_bytes, **told})

    # ── requests ───────────────────────────────────────────────────────────────────────────────────────────────

    async def request(
        self,
        op: str,
        body: bytes,
        timeout_s: float,
        arguments: Mapping[str, object],
        subscription: Receiver | None = None,
        at_answer: Callable[[Mapping[str, Any]], None] | None = None,
    ) -> Reply:
        """Send one request and wait for its reply. A caller that is cancelled or times out cancels the request.

        `at_answer` is called with the reply before later packets are processed.
        """
        number = next(self._numbers)
        header = {**arguments, "id": number, "op": op}
        if op in _BOUNDED_BY_THE_BRIDGE:
            header["timeout_s"] = timeout_s
        wait_s = arguments.get("wait_s")  # how long to wait for the server of a service, before its response
        limit_s = timeout_s + MARGIN_S + (wait_s if op == "call" and isinstance(wait_s, (int, float)) else 0.0)
        relay = str(arguments["name"]) if op == "relay" else ""
        request = _Open(asyncio.get_running_loop().create_future(), subscription, relay, at_answer=at_answer)
        request.answer.add_done_callback(_retrieve)
        self._open[number] = request
        self._heartbeat.end_rest()
        try:
            if len(body) > _SMALL_BODY:
                await self._send_large(header, body, request)
            else:
                self._send(header, body)
                request.has_left = True
            await asyncio.wait({request.answer}, timeout=limit_s)
            if not request.answer.done():
                raise TimedOut(f"The bridge gave no answer to {op} within {limit_s:.1f} s.")
            return request.answer.result()
        finally:
            if not request.answer.done():
                request.answer.cancel()
                if not request.has_left:
                    self._open.pop(number, None)
                elif op not in _NEVER_CANCELLED:
                    self._send_cancel(number)

    def post(self, posted: Posted) -> None:
        """Write a request now, so that the bridge reads it before everything that is sent later."""
        number = next(self._numbers)
        self._open[number] = _Open(posted.answer, has_left=True)
        self._heartbeat.end_rest()
        posted.send_cancel = partial(self._send_cancel, number)
        self._send({**posted.arguments, "id": number, "op": posted.op}, posted.body)

    def tell(self, op: str, body: bytes) -> None:
        """Send a request without waiting for its reply. Nothing is sent before the rules."""
        if self._has_rules:
            self._send({"id": next(self._numbers), "op": op}, body)

    async def _send_large(self, header: Mapping[str, object], body: bytes, request: _Open) -> None:
        """Send a large request after earlier requests, once there is room, so that the write queue stays bounded.

        Over a slow link it takes time, during which other packets pass; if it is cancelled meanwhile, it was never
        sent.
        """
        if not self._window_bytes:
            async with self._writing:
                await self.carrier.writable()
                self._send(header, body)
                request.has_left = True
            return
        if self._ended.done():
            return
        sent = self._outflow.send(_packed(header, body))
        try:
            await asyncio.wait({sent, request.answer}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            request.has_left = not sent.cancel()

    def _send_cancel(self, number: int) -> None:
        self._send({"id": next(self._numbers), "op": "cancel", "request": number})

    def _send(self, header: Mapping[str, object], body: bytes = b"") -> None:
        if not self._ended.done():
            self.carrier.write(_packed(header, body))

    # ── subscriptions ──────────────────────────────────────────────────────────────────────────────────────────

    async def subscribe(self, subscription: Receiver, timeout_s: float, arguments: Mapping[str, Any]) -> None:
        """Open a subscription in the bridge; if the caller is cancelled meanwhile, none is left behind."""
        if arguments.get("drain_s", 0.0) < NO_HURRY_S:
            self._hurried.add(subscription)
        try:
            await self.request("subscribe", b"", timeout_s, arguments, subscription)
        except BaseException:
            self.dismiss(subscription)
            raise

    async def unsubscribe(self, subscription: Receiver) -> None:
        """End a subscription; take in the samples in transit and the final counts, which may be missing over a slow
        link.
        """
        number = subscription.number
        if number is None or number not in self._subscriptions:
            return
        try:
            reply = await self.request("unsubscribe", b"", MARGIN_S, {"sub": number})
            subscription.count(cast("Counts", reply.ok))
        except TimedOut:
            return  # what was read is not worth less for it
        except LinkError:
            return  # the bridge is gone, and the subscription with it
        finally:
            self._subscriptions.pop(number, None)
            self._lanes.close(number)

    def dismiss(self, subscription: Receiver) -> None:
        """End a subscription without waiting for the reply."""
        if self._subscriptions.pop(subscription.number or 0, None):
            self._send({"id": next(self._numbers), "op": "unsubscribe", "sub": subscription.number})

    # ── packets of the bridge ──────────────────────────────────────────────────────────────────────────────────

    def _received(self, piece: bytes) -> None:
        self._heartbeat.received()
        if self._ended.done():
            return
        try:
            for packet in self._reader.feed(piece):
                self._take_in(packet)
        except (PacketError, KeyError, TypeError, ValueError) as error:
            self._end(self._lost(f"sent what is not part of the protocol ({error})"))

    def _take_in(self, packet: Packet) -> None:
        header = packet.header
        event = header.get("event")
        if event is None:
            self._answered(packet)
        elif event == "piece":
            for whole in self._lanes.feed(header, packet.body):
                self._take_in(whole)
            self._send({"op": "ack", "bytes": self._lanes.taken_bytes})
        elif event == "ack":
            self._outflow.acknowledged(header["bytes"])
        elif event == "samples":
            subscription = self._subscriptions.get(header["sub"])
            if subscription:
                subscription.arrived(cast("Samples", header), packet.body)
        elif event == "hello" and header["protocol"] != PROTOCOL:
            self._end(LinkError(f"The bridge speaks protocol {header['protocol']}, this server {PROTOCOL}."))
        elif event == "hello":
            self.hello = Hello(**{name: header[name] for name in Hello._fields})
            if self._heard_s or not self.carrier.is_remote:
                self._be_greeted()
        elif event in ("begun", "frame", "kept_out", "lapsed", "latched", "motion", "spent", "stopper"):
            self._hear(cast("Told", header))
        elif event == "failed":
            no_rclpy = header.get("kind") == "no_rclpy"
            what = "The Python of ROS cannot import rclpy" if no_rclpy else "ROS 2 did not start"
            self._end(LinkError(f"{what}: {header['message']}", "Run: ros2-mcp doctor"))

    def _be_greeted(self) -> None:
        """Record that the bridge is connected. The hello of a remote bridge may be old, so that the bridge would reject
        the first command as late. Therefore a ping must have been answered first.
        """
        if not self._greeted.done():
            self._ping()  # before any request: a new bridge learns which requests a stop has overtaken
            self._greeted.set_result(None)

    def _answered(self, packet: Packet) -> None:
        number = packet.header["id"]
        if number == _PING:
            ok = packet.header["ok"]
            self._clock.answered(int(ok["sent_ns"]), int(ok["now_ns"]))
            self._heard_s = max(self._heard_s, float(ok.get("steady_s", 0.0)))
            if self.hello:  # before the hello, ROS was starting
                self._heartbeat.ponged(float(ok["ros_idle_s"]))
                self._be_greeted()
            return
        if number == _POLICY:
            if error := packet.header.get("error"):
                self._end(LinkError(f"The bridge rejected the policy: {error['message']}", "Run: ros2-mcp doctor"))
            return
        request = self._open.pop(number, None)
        if not request:
            return
        if request.subscription and "ok" in packet.header:
            # Samples may follow in the same piece: register the subscription before its caller runs.
            number = request.subscription.number = packet.header["ok"]["sub"]
            self._subscriptions[number] = request.subscription
            if request.answer.done():
                self.dismiss(request.subscription)
        if not request.answer.done():
            error: Failure | None = packet.header.get("error")
            if error is not None:
                request.answer.set_exception(BridgeRefused(error["kind"], error["message"], error["hint"]))
                return
            if request.at_answer:
                request.at_answer(packet.header["ok"])
            request.answer.set_result(Reply(packet.header["ok"], packet.body))
        elif request.relay and "ok" in packet.header:
            self._relay_ended(request.relay, packet.header["ok"])


def _retrieve(answer: asyncio.Future[Reply]) -> None:
    """Retrieve the error of a request that nothing awaits any more: asyncio would log it otherwise."""
    if not answer.cancelled():
        answer.exception()


def _packed(header: Mapping[str, object], body: bytes) -> bytes:
    try:
        return pack(header, body)
    except PacketError as error:
        raise BadInput(f"This is too large for the stream: {error}.") from error
