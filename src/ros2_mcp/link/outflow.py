"""What leaves for the bridge: small packets at once, large ones in pieces as far as the bridge keeps up."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from ros2_mcp_common.wire.pieces import LANE_OF_REQUESTS, Credit, Cut


class Outflow:
    """Large requests one after the other, in pieces between which whatever is written otherwise passes.

    So a picture that is published over a slow link does not hold up a stop. At most `window_bytes` are under way.
    """

    def __init__(self, write: Callable[[bytes], None], window_bytes: int) -> None:
        self._write = write
        self._credit = Credit(window_bytes)
        self._waiting: deque[tuple[Cut, asyncio.Future[None]]] = deque()

    def send(self, packet: bytes) -> asyncio.Future[None]:
        """Lets a packet leave in its turn; done when all of it has left. Cancelling withdraws what has not."""
        sent: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((Cut("op", LANE_OF_REQUESTS, packet), sent))
        self._go_on()
        return sent

    def acknowledged(self, total: object) -> None:
        """The bridge has taken so many bytes of pieces.

        Raises:
            PacketError: if it cannot have.
        """
        self._credit.acknowledge(total)
        self._go_on()

    def _go_on(self) -> None:
        while self._waiting and self._credit.has_room:
            cut, sent = self._waiting[0]
            if sent.cancelled():
                self._waiting.popleft()
                continue
            piece, size = cut.take()
            self._credit.write(size)
            self._write(piece)
            if not cut.left_bytes:
                self._waiting.popleft()
                sent.set_result(None)
