"""The messages that the robot's nodes log on /rosout, kept as bytes in a ring of bounded size."""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING

import anyio

from ros2_mcp.model.errors import BridgeLost, RobotError
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp_common.wire.limits import NO_HURRY_S

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge

TOPIC = "/rosout"
LOG_TYPE = "rcl_interfaces/msg/Log"
MAX_LINES = 5000
"""Some minutes of a talkative robot: more is rarely read, and the robot's own log files have everything."""
MAX_BYTES = 2_000_000
"""The size of 5,000 lines of 400 bytes; bounds nodes that log whole messages."""
_LEVEL_AT = 12
"""The offset of the level in rcl_interfaces/msg/Log: after 4 bytes of CDR header and 8 bytes of stamp."""
_QOS = QoS("reliable", "transient_local", depth=1000)
_CHECK_EVERY_S = 1.0
"""The period of checks whether a bridge is connected again, in s: the log of an unreachable robot is not urgent."""
_logger = logging.getLogger(__name__)

LineListener = Callable[[int, Sample], None]
"""Called with each new line: its level (10 debug, 20 info, 30 warn, 40 error, 50 fatal), and its sample."""


class LogRing:
    """The newest lines of /rosout. After a lost bridge it subscribes again, without storing a line twice.

    `since_ns` is the time of the first subscription, in ns of Unix time by the robot's clock (0: not subscribed yet).
    Older lines may be present: nodes send a new subscriber their lines of the last ten seconds (by default). `dropped`
    counts lines that were discarded for newer ones, `interruptions` the losses of the bridge.
    """

    def __init__(self, bridge: Bridge, max_lines: int = MAX_LINES, max_bytes: int = MAX_BYTES) -> None:
        self._bridge = bridge
        self._max_lines = max_lines
        self._max_bytes = max_bytes
        self._kept: OrderedDict[bytes, Sample] = OrderedDict()
        self._bytes = 0
        self._listeners: list[LineListener] = []
        self._work: asyncio.Task[None] | None = None
        self._listening = asyncio.Event()
        self.since_ns = 0
        self.dropped = 0
        self.interruptions = 0

    def start(self) -> bool:
        """Subscribe, in the running event loop, as soon as there is a bridge; return whether this call began it."""
        if self._work is not None:
            return False
        self._work = asyncio.create_task(self._listen())
        return True

    async def wait_listening(self, timeout_s: float) -> bool:
        """Wait for the subscription; return whether it exists."""
        with anyio.move_on_after(timeout_s):
            await self._listening.wait()
        return self._listening.is_set()

    async def close(self) -> None:
        """Unsubscribe; the stored lines remain."""
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait({self._work})
            self._work = None

    def on_line(self, listener: LineListener) -> Callable[[], None]:
        """Call the listener with every new line from now on; return a function that ends this. The listener must not
        block.
        """
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    @property
    def lines(self) -> list[Sample]:
        """The stored lines, in order of arrival."""
        return list(self._kept.values())

    def add(self, sample: Sample) -> None:
        """Store a line, unless it is stored already; discard the oldest lines beyond the bounds."""
        if sample.data in self._kept:
            return
        self._kept[sample.data] = sample
        self._bytes += len(sample.data)
        while len(self._kept) > self._max_lines or (self._bytes > self._max_bytes and len(self._kept) > 1):
            self._bytes -= len(self._kept.popitem(last=False)[0])
            self.dropped += 1
        for listener in list(self._listeners):
            listener(level_of(sample.data), sample)

    async def _listen(self) -> None:
        while not self._bridge.is_closed:
            try:
                await self._listen_once()
            except BridgeLost:
                self.interruptions += 1
            except RobotError as error:
                _logger.info("the log of the robot is not kept: %s", error)
                while self._bridge.hello is None and not self._bridge.is_closed:  # the log alone starts no bridge
                    await asyncio.sleep(_CHECK_EVERY_S)
            finally:
                self._listening.clear()

    async def _listen_once(self) -> None:
        async with await self._bridge.subscribe(
            TOPIC,
            LOG_TYPE,
            _QOS.request(),
            keep="all",
            max_samples=self._max_lines,
            max_bytes=self._max_bytes,
            drain_s=NO_HURRY_S,
        ) as subscription:
            self.since_ns = self.since_ns or self._bridge.clock.now_ns()
            self._listening.set()
            dropped_waiting = 0
            while True:
                for sample in await subscription.take(60.0):
                    self.add(sample)
                self.dropped += subscription.counts.dropped - dropped_waiting
                dropped_waiting = subscription.counts.dropped


def level_of(data: bytes) -> int:
    """Return the level of a line, from its bytes."""
    return data[_LEVEL_AT]
