"""What the robot's nodes log on /rosout, kept as bytes in a bounded ring from its start on."""

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
"""Some minutes of a talkative robot; nobody reads more of them, and the robot's own log files have them all."""
MAX_BYTES = 2_000_000
"""What 5,000 lines of 400 bytes need; a node that logs whole messages is bounded by it."""
_LEVEL_AT = 12
"""Behind the 4 bytes of the CDR header and the 8 of the stamp, see rcl_interfaces/msg/Log."""
_QOS = QoS("reliable", "transient_local", depth=1000)
_CHECK_EVERY_S = 1.0
"""Whether there is a bridge again. Nobody waits for the log of a robot that cannot be reached."""
_logger = logging.getLogger(__name__)

LineListener = Callable[[int, Sample], None]
"""Called with each new line: its level (10 debug, 20 info, 30 warn, 40 error, 50 fatal), and the line as it came."""


class LogRing:
    """The newest lines of /rosout. After a lost bridge it subscribes again, and keeps no line twice.

    `since_ns` is the Unix time, by the robot's clock, at which it was first subscribed (0: not yet). Older lines may be
    in it: nodes send a new subscriber what they logged in the last ten seconds (by default). `dropped` counts the lines
    that were there and had to give way, `interruptions` how often the bridge was lost.
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
        """Begins to listen, in the running event loop, as soon as there is a bridge; whether this call began it."""
        if self._work is not None:
            return False
        self._work = asyncio.create_task(self._listen())
        return True

    async def wait_listening(self, timeout_s: float) -> bool:
        """Waits until it is subscribed; whether it is."""
        with anyio.move_on_after(timeout_s):
            await self._listening.wait()
        return self._listening.is_set()

    async def close(self) -> None:
        """Ends listening; what is kept stays."""
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait({self._work})
            self._work = None

    def on_line(self, listener: LineListener) -> Callable[[], None]:
        """Calls the listener with every new line from now on; returns what ends that. It must not block."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    @property
    def lines(self) -> list[Sample]:
        """The lines that are kept, in the order they came."""
        return list(self._kept.values())

    def add(self, sample: Sample) -> None:
        """Takes a line in, unless it is there already; the oldest give way."""
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
                while self._bridge.hello is None and not self._bridge.is_closed:  # the log is no reason to start one
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
    """The level of a line, from its bytes: it follows the stamp."""
    return data[_LEVEL_AT]
