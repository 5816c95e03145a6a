"""One subscription in the bridge for all equal subscriptions here, so that each sample crosses the stream once.

Otherwise thirty-two readers of one camera would store each image that often in the middleware, on the stream and here.
Not shared are: latched topics, because each subscriber must get the kept messages; subscriptions to the latest sample,
which take no space; and to every n-th sample, which each subscriber counts from its first.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from ros2_mcp.link.subscription import Subscription, samples_of
from ros2_mcp.model.errors import BridgeLost, LinkError
from ros2_mcp_common.wire.protocol import Counts, Samples

if TYPE_CHECKING:
    from ros2_mcp.link.connection import Connection

_Key = tuple[object, ...]
AtAnswer = Callable[[Mapping[str, Any]], None]
"""Called with a reply before later packets are processed."""
# The time limit for subscribing: creating an entity can block for up to 3 s inside Fast DDS after a peer was killed
# (decision 12).
_SUBSCRIBE_S = 5.0
# The time limit for samples in transit, of which there are 64 MB at most.
_COUNTS_S = 2.0


class Sharing:
    """The shared subscriptions of one bridge process."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._shared: dict[_Key, Shared] = {}

    async def subscribe(self, arguments: Mapping[str, Any]) -> Subscription:
        """Return a new subscription, or a share of an existing subscription; `arguments` are the arguments of the
        bridge's `subscribe`.

        Raises as `Bridge.request`.
        """
        bounds = arguments["keep"], arguments["max_samples"], arguments["max_bytes"]
        is_volatile = arguments["qos"].get("durability") == "volatile"
        if arguments["keep"] != "all" or not is_volatile or "every_n" in arguments:
            subscription = Subscription(*bounds, self._connection.unsubscribe)
            await self._connection.subscribe(subscription, _SUBSCRIBE_S, arguments)
            return subscription
        key = tuple(sorted((name, _frozen(value)) for name, value in arguments.items()))
        while shared := self._shared.get(key):
            if not shared.is_ready.done():
                await asyncio.wait({shared.is_ready})
                if lost := shared.is_ready.result():
                    raise BridgeLost(lost.message, lost.hint)
                continue  # it is ready, or its maker failed or was cancelled: look again
            subscription = Subscription(*bounds, shared.leave)
            await shared.join(subscription)
            return subscription

        def forget() -> None:
            if self._shared.get(key) is made:  # there may be a successor
                del self._shared[key]

        made = self._shared[key] = Shared(self._connection, forget)
        subscription = Subscription(*bounds, made.leave)
        await made.begin(subscription, arguments)
        return subscription


class Shared:
    """One subscription in the bridge and its listeners, each with the counts at which it joined.

    `is_ready` is done when subscribing has ended; its result is the error if the bridge was lost meanwhile. `forget` is
    called when no further listener may join.
    """

    def __init__(self, connection: Connection, forget: Callable[[], None]) -> None:
        self.number: int | None = None
        self.is_ready: asyncio.Future[BridgeLost | None] = asyncio.get_running_loop().create_future()
        self._connection = connection
        self._forget = forget
        self._listeners: dict[Subscription, Counts] = {}
        self._staying: set[Subscription] = set()
        self._totals: Counts = {"received": 0, "dropped": 0, "lost": 0}

    async def begin(self, first: Subscription, arguments: Mapping[str, Any]) -> None:
        """Subscribe in the bridge, for the first listener."""
        lost: BridgeLost | None = None
        self._staying.add(first)
        self._listeners[first] = self._totals
        try:
            await self._connection.subscribe(self, _SUBSCRIBE_S, arguments)
        except BaseException as error:
            lost = error if isinstance(error, BridgeLost) else None
            self._forget()
            raise
        finally:
            self.is_ready.set_result(lost)

    async def join(self, listener: Subscription) -> None:
        """Pass everything that arrives from now on to this listener."""
        self._staying.add(listener)

        def begins(counts: Mapping[str, Any]) -> None:
            self._listeners[listener] = _counts(counts)

        try:
            await self._ask_counts(_SUBSCRIBE_S, begins, after_samples=False)
        except BaseException:
            self._listeners.pop(listener, None)
            self._staying.discard(listener)
            if not self._staying:
                self._forget()
                self._connection.dismiss(self)
            raise

    async def leave(self, listener: Subscription) -> None:
        """Pass what has arrived to the listener, and nothing later. The subscription ends with its last listener.

        Over a network this does not wait for the samples in transit to the others.
        """
        if listener not in self._listeners:
            return
        self._staying.discard(listener)

        def ends(counts: Mapping[str, Any]) -> None:
            self._count(listener, _counts(counts))
            self._listeners.pop(listener, None)

        try:
            if self._staying and not self._connection.carrier.is_remote:
                await self._ask_counts(_COUNTS_S, ends, after_samples=True)
            elif not self._staying:
                self._forget()
                await self._connection.unsubscribe(self)
        except LinkError:
            return  # the bridge is gone, and the subscription with it
        finally:
            self._listeners.pop(listener, None)

    async def _ask_counts(self, timeout_s: float, at_answer: AtAnswer, *, after_samples: bool) -> None:
        question = {"sub": self.number, "after_samples": after_samples}
        await self._connection.request("counts", b"", timeout_s, question, at_answer=at_answer)

    # ── for the connection ─────────────────────────────────────────────────────────────────────────────────────

    def arrived(self, header: Samples, body: bytes) -> None:
        """Pass a packet of samples to all listeners, to each listener the samples after it joined."""
        self.count(header)
        samples = samples_of(header, body)
        before = header["received"] - len(samples)
        for listener, began_at in list(self._listeners.items()):
            listener.take_in(samples[max(0, began_at["received"] - before) :])

    def count(self, totals: Counts) -> None:
        """Take in the bridge's present totals."""
        self._totals = _counts(totals)
        for listener in self._listeners:
            self._count(listener, self._totals)

    def lose(self, error: LinkError) -> None:
        """Take note that the bridge is gone: nothing more will arrive."""
        self._forget()
        for listener in self._listeners:
            listener.lose(error)
        self._listeners.clear()
        self._staying.clear()

    def _count(self, listener: Subscription, totals: Counts) -> None:
        """Give a listener the counts since it joined. Messages that were dropped then may have arrived before."""
        began_at = self._listeners.get(listener)
        if began_at is None:
            return
        received = max(0, totals["received"] - began_at["received"])
        dropped = min(received, max(0, totals["dropped"] - began_at["dropped"]))
        is_known = totals["lost"] is not None and began_at["lost"] is not None
        lost = (totals["lost"] or 0) - (began_at["lost"] or 0) if is_known else None
        listener.count({"received": received, "dropped": dropped, "lost": lost})


def _counts(of: Mapping[str, Any] | Counts) -> Counts:
    return {"received": of["received"], "dropped": of["dropped"], "lost": of["lost"]}


def _frozen(value: Any) -> object:
    return tuple(sorted(value.items())) if isinstance(value, Mapping) else value  # pyright: ignore
