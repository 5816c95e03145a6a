"""One life of the bridge, from its start to its end: requests out, replies and samples in."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.link.carrier import Carrier
from ros2_mcp.link.heartbeat import Heartbeat
from ros2_mcp.link.subscription import Subscription
from ros2_mcp.model.errors import BadInput, BridgeLost, BridgeRefused, LinkError, TimedOut
from ros2_mcp_bridge.packets import Packet, PacketError, PacketReader, pack
from ros2_mcp_bridge.protocol import PROTOCOL, Counts, Failure, FrameIdChanged, Hello, Lapsed, Samples

# Beyond the time that the bridge was given for an answer: for the way to it and back, and for its late rounds. Chosen.
MARGIN_S = 2.0
_PING = 0
_SHOWN_LINES = 5
_BOUNDED_BY_THE_BRIDGE = ("call", "wait_endpoints")
_NEVER_CANCELLED = ("unsubscribe", "stop", "zero")
# Such a request does not wait until the carrier has room, and overtakes large ones that do: the cancelling of a goal is
# one, and must not wait behind a picture. It is no more than the headers, which never wait. Chosen.
_SMALL_BODY = 1024


@dataclass(frozen=True, slots=True)
class Reply:
    """The bridge's answer to one request: named results, and bytes where the request has some."""

    ok: Mapping[str, Any]
    body: bytes


@dataclass(slots=True)
class _Open:
    """A request that is not answered yet. It stays here when its caller gives up: a late answer may need an undoing."""

    answer: asyncio.Future[Packet]
    subscription: Subscription | None = None


class Connection:
    """Talks with one bridge; `run` returns why it ended.

    Each ping tells the bridge the link lease and what `stop_epoch` gives; `hear` is told of its events.
    """

    def __init__(
        self,
        carrier: Carrier,
        stop_epoch: Callable[[], int] = lambda: 0,
        hear: Callable[[FrameIdChanged | Lapsed], None] = lambda _: None,
    ) -> None:
        loop = asyncio.get_running_loop()
        self.carrier = carrier
        self._stop_epoch = stop_epoch
        self._hear = hear
        self.hello: Hello | None = None
        self._greeted: asyncio.Future[None] = loop.create_future()
        self._ended: asyncio.Future[LinkError | None] = loop.create_future()
        self._reader = PacketReader()
        self._heartbeat = Heartbeat(carrier, self._ping)
        self._numbers = itertools.count(1)
        self._open: dict[int, _Open] = {}
        self._subscriptions: dict[int, Subscription] = {}
        self._writing = asyncio.Lock()

    # ── its life ───────────────────────────────────────────────────────────────────────────────────────────────

    async def greet(self) -> LinkError | None:
        """Opens the carrier and waits for its hello; returns what went wrong instead, if something did."""
        await self.carrier.open(self._received, lambda: self._end(None))
        start_s = self.carrier.start_s
        await asyncio.wait({self._greeted, self._ended}, timeout=start_s, return_when=asyncio.FIRST_COMPLETED)
        if self._greeted.done():
            return None
        if not self._ended.done():
            self._end(LinkError(f"{self._name} was not ready after {start_s:.0f} s.{self._last_words()}"))
        return await self._reason()

    async def run(self) -> LinkError:
        """Watches over a bridge that has said hello; returns why it was lost, after all who wait got that error."""
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
        """Everyone who waits for the bridge gets this error."""
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
        return reason or self._lost(await self.carrier.ending(), has_ended=True)

    def _lost(self, what: str, *, has_ended: bool = False) -> LinkError:
        if not self.hello:
            return LinkError(f"{self._name} {what} before it was ready.{self._last_words()}", "Run: ros2-mcp doctor")
        last_words = self._last_words() if has_ended else ""
        return BridgeLost(
            f"{self._name} {what} and is started again.{last_words}",
            "What was under way may or may not have happened, and what this server drove is being stopped: look at the "
            "robot's state, then call again.",
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

    def _ping(self) -> None:
        self._send({"id": _PING, "op": "ping", "lease_s": self.carrier.lease_s, "epoch": self._stop_epoch()})

    # ── requests ───────────────────────────────────────────────────────────────────────────────────────────────

    async def request(
        self,
        op: str,
        body: bytes,
        timeout_s: float,
        arguments: Mapping[str, object],
        subscription: Subscription | None = None,
    ) -> Reply:
        """Sends one request and waits for its answer; a caller that is cancelled or gives up cancels it."""
        number = next(self._numbers)
        header = {**arguments, "id": number, "op": op}
        if op in _BOUNDED_BY_THE_BRIDGE:
            header["timeout_s"] = timeout_s
        wait_s = arguments.get("wait_s")  # for the server of a service, before its answer is waited for
        limit_s = timeout_s + MARGIN_S + (wait_s if op == "call" and isinstance(wait_s, (int, float)) else 0.0)
        request = _Open(asyncio.get_running_loop().create_future(), subscription)
        self._open[number] = request
        try:
            if len(body) > _SMALL_BODY:
                # One after the other, each when the carrier has room: what waits to be written stays bounded.
                async with self._writing:
                    await self.carrier.writable()
                    self._send(header, body)
            else:
                self._send(header, body)
            await asyncio.wait({request.answer}, timeout=limit_s)
            if not request.answer.done():
                raise TimedOut(f"The bridge gave no answer to {op} within {limit_s:.1f} s.")
            answer = request.answer.result()
            error: Failure | None = answer.header.get("error")
            if error is not None:
                raise BridgeRefused(error["kind"], error["message"], error["hint"])
            return Reply(answer.header["ok"], answer.body)
        finally:
            if not request.answer.done():
                request.answer.cancel()
                if op not in _NEVER_CANCELLED:
                    self._send({"id": next(self._numbers), "op": "cancel", "request": number})

    def _send(self, header: Mapping[str, object], body: bytes = b"") -> None:
        if self._ended.done():
            return
        try:
            self.carrier.write(pack(header, body))
        except PacketError as error:
            raise BadInput(f"This is too large for the stream: {error}.") from error

    # ── subscriptions ──────────────────────────────────────────────────────────────────────────────────────────

    async def subscribe(self, subscription: Subscription, timeout_s: float, arguments: Mapping[str, object]) -> None:
        """Lets the samples of a new subscription flow; if the caller is cancelled meanwhile, none is left behind."""
        try:
            await self.request("subscribe", b"", timeout_s, arguments, subscription)
        except BaseException:
            self._dismiss(subscription)
            raise

    async def unsubscribe(self, subscription: Subscription) -> None:
        """Ends a subscription; takes in the samples still under way and the final counts."""
        number = subscription.number
        if number is None or number not in self._subscriptions:
            return
        try:
            reply = await self.request("unsubscribe", b"", MARGIN_S, {"sub": number})
            subscription.count(cast("Counts", reply.ok))
        except LinkError:
            return  # the bridge is gone, and the subscription with it
        finally:
            self._subscriptions.pop(number, None)

    def _dismiss(self, subscription: Subscription) -> None:
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
        elif event == "samples":
            subscription = self._subscriptions.get(header["sub"])
            if subscription:
                subscription.arrived(cast("Samples", header), packet.body)
        elif event == "hello" and header["protocol"] != PROTOCOL:
            self._end(LinkError(f"The bridge speaks protocol {header['protocol']}, this server {PROTOCOL}."))
        elif event == "hello":
            self.hello = Hello(**{name: header[name] for name in Hello._fields})
            self._ping()  # before any request: a new bridge learns which of them a stop has overtaken
            if not self._greeted.done():
                self._greeted.set_result(None)
        elif event in ("frame", "lapsed"):
            self._hear(cast("FrameIdChanged | Lapsed", header))
        elif event == "failed":
            no_rclpy = header.get("kind") == "no_rclpy"
            what = "The Python of ROS cannot import rclpy" if no_rclpy else "ROS 2 did not start"
            self._end(LinkError(f"{what}: {header['message']}", "Run: ros2-mcp doctor"))

    def _answered(self, packet: Packet) -> None:
        number = packet.header["id"]
        if number == _PING:
            self._heartbeat.ponged(float(packet.header["ok"]["ros_idle_s"]))
            return
        request = self._open.pop(number, None)
        if not request:
            return
        if request.subscription and "ok" in packet.header:
            # Samples may follow in the same piece: the subscription is registered before its caller runs.
            number = request.subscription.number = packet.header["ok"]["sub"]
            self._subscriptions[number] = request.subscription
            if request.answer.done():
                self._dismiss(request.subscription)
        if not request.answer.done():
            request.answer.set_result(packet)
