"""Outgoing packets: small packets are sent at once, large packets in pieces as far as the bridge keeps up."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from ros2_mcp_common.wire.pieces import LANE_OF_REQUESTS, Credit, Cut


class Outflow:
    """The queue of large requests, sent one after the other in pieces, between which other packets pass.

    An image that is published over a slow link therefore does not delay a stop. How much may be
    unacknowledged is up to `Credit`.
    """

    def __init__(self, write: Callable[[bytes], None], window_bytes: int) -> None:
        self._write = write
        self._credit = Credit(window_bytes)
        self._waiting: deque[tuple[Cut, asyncio.Future[None]]] = deque()

    def send(self, packet: bytes) -> asyncio.Future[None]:
        """Queue a packet; the future is done when all of it is sent. Cancelling the future discards the pieces not sent
        yet.
        """
        sent: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((Cut("op", LANE_OF_REQUESTS, packet), sent))
        self._go_on()
        return sent

    def acknowledged(self, total: object) -> None:
        """Record that the bridge has received this many bytes of pieces in total.

        Raises:
            PacketError: if that is impossible.
        """
        self._credit.acknowledge(total)
        self._go_on()

    def _go_on(self) -> None:
        while self._waiting and self._credit.has_room:
            cut, sent = self._waiting[0]
            if sent.cancelled():
                self._waiting.popleft()
                continue
            piece, size = cut.take(self._credit.piece_bytes)
            self._credit.write(size)
            self._write(piece)
            if not cut.left_bytes:
                self._waiting.popleft()
                sent.set_result(None)
