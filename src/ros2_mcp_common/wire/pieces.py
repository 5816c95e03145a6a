"""Pieces and credit: how large packets share a slow link with small packets. Both sides of the stream use this module.

A large packet is cut into pieces, and only a limited number of bytes may be under way without being acknowledged. So
only little data waits in the link itself, however slow it is, and a small packet that is written next arrives soon.
Pieces belong to a *lane*: the packets of one lane are sent one after the other, those of different lanes in turns.
"""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from ros2_mcp_common.wire.limits import (
    FIRST_PIECE_BYTES,
    FIRST_WINDOW_BYTES,
    LEAST_PIECE_BYTES,
    MOST_WINDOW_BYTES,
    PIECE_BYTES,
    PIECE_S,
    WINDOW_S,
)
from ros2_mcp_common.wire.packets import PacketError, PacketReader, pack

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from typing import Any

    from ros2_mcp_common.wire.packets import Packet

# The lane of everything but samples: replies of the bridge, requests of the server. Samples use the number of their
# subscription, which begins at 1.
LANE_OF_REQUESTS = 0


# The window exceeds what the link carries in one round trip by this factor and by a spare, which shows whether the link
# can carry more; the window grows by as much each time. So a quarter of a round trip waits in the link, plus the spare:
# what the link carries in WINDOW_S, between LEAST_PIECE_BYTES and PIECE_BYTES.
GAIN = 1.25
# The capacity of the link is the highest rate of this last period: longer than the pause between two images, and short
# enough that a radio link that has become slow is noticed.
RATE_KEPT_S = 5.0
# A piece that is acknowledged so much later than in the shortest round trip, in s, shows that the link carries less
# than that by now, or that what is sent compresses less (ssh -C). Retransmissions alone take less.
SLOWED_S = 0.5


class Credit:
    """The bytes of pieces that may still be written: only a limited number may be unacknowledged.

    The limit is what the link carries in WINDOW_S, but no more than `enough_bytes`; or, if that is more, a little more
    than it carried in its shortest round trip. With less, a fast link with a long round trip would idle; with more,
    small packets would wait behind large ones.
    """

    def __init__(self, enough_bytes: int, now: Callable[[], float] = time.monotonic) -> None:
        self._enough_bytes = enough_bytes
        self._now = now
        self._written = 0
        self._acknowledged = 0
        # For each piece under way: the bytes up to its end, when it was written, and the bytes acknowledged by then.
        self._under_way: deque[tuple[int, float, int]] = deque()
        self._rtt_s = 0.0
        self._rates: deque[tuple[float, float]] = deque()  # (time, bytes per s), rates descending

    @property
    def window_bytes(self) -> int:
        """The maximum number of unacknowledged bytes."""
        if not self._rates:
            return min(FIRST_WINDOW_BYTES, self._enough_bytes)
        rate = self._rates[0][1]
        short = min(rate * WINDOW_S, self._enough_bytes)
        spare = max(LEAST_PIECE_BYTES, min(rate * WINDOW_S, PIECE_BYTES))
        return int(min(max(short, GAIN * rate * self._rtt_s + spare), MOST_WINDOW_BYTES))

    @property
    def piece_bytes(self) -> int:
        """How large the next piece may be."""
        if not self._rates:
            return FIRST_PIECE_BYTES
        return int(max(LEAST_PIECE_BYTES, min(self._rates[0][1] * PIECE_S, PIECE_BYTES)))

    @property
    def has_room(self) -> bool:
        """Whether another piece may be written."""
        return self._written - self._acknowledged + self.piece_bytes <= self.window_bytes

    def write(self, size: int) -> None:
        """Record that a piece of `size` bytes is written."""
        self._written += size
        self._under_way.append((self._written, self._now(), self._acknowledged))

    def acknowledge(self, total: object) -> None:
        """Record that the other side has taken `total` bytes of pieces in all.

        Raise `PacketError` for an impossible number.
        """
        if not isinstance(total, int) or not self._acknowledged <= total <= self._written:
            raise PacketError(f"{total!r} bytes were acknowledged, of {self._written} that were written")
        self._acknowledged = total
        taken = None
        while self._under_way and self._under_way[0][0] <= total:
            taken = self._under_way.popleft()
        if taken:
            self._learn(*taken)

    def _learn(self, end: int, left_s: float, acknowledged: int) -> None:
        """Update the shortest round trip and the rates from one acknowledged piece."""
        now = self._now()
        took_s = max(now - left_s, 1e-6)  # the clock's resolution
        self._rtt_s = min(self._rtt_s or took_s, took_s)
        rate = (end - acknowledged) / took_s
        if took_s > self._rtt_s + SLOWED_S:
            self._rates.clear()
        while self._rates and self._rates[-1][1] <= rate:
            self._rates.pop()
        while self._rates and self._rates[0][0] < now - RATE_KEPT_S:
            self._rates.popleft()
        self._rates.append((now, rate))


class Cut:
    """A packet that is sent in pieces; `kind` is the key that marks them: `op` for `{"op": "piece"}`, or `event`."""

    def __init__(self, kind: str, lane: int, packet: bytes) -> None:
        self._kind = kind
        self._lane = lane
        self._rest = memoryview(packet)
        self._begins = True

    @property
    def left_bytes(self) -> int:
        """The number of bytes not sent yet."""
        return len(self._rest)

    def take(self, most_bytes: int = PIECE_BYTES) -> tuple[bytes, int]:
        """Return the next piece as a packet, and the number of bytes of the whole in it."""
        body, self._rest = bytes(self._rest[:most_bytes]), self._rest[most_bytes:]
        header = {self._kind: "piece", "lane": self._lane, **({"begins": True} if self._begins else {})}
        self._begins = False
        return pack(header, body), len(body)


class Lanes:
    """Reassembles packets from pieces. `taken_bytes` is the total to be acknowledged to the other side."""

    def __init__(self) -> None:
        self.taken_bytes = 0
        self._readers: dict[int, PacketReader] = {}

    def feed(self, header: Mapping[str, Any], body: bytes) -> Iterator[Packet]:
        """Yield the packet that this piece completes, if any.

        If another packet begins on a lane, the sender has given up the unfinished one before. Pieces on a lane that
        was closed here are ignored.

        Raises:
            PacketError: if it is no piece of a packet.
        """
        lane = header.get("lane")
        if not isinstance(lane, int):
            raise PacketError(f"a piece is of the lane {lane!r}")
        self.taken_bytes += len(body)
        if header.get("begins"):
            self._readers[lane] = PacketReader()
        reader = self._readers.get(lane)
        if reader is None:
            return
        for packet in reader.feed(body):
            if "piece" in (packet.header.get("op"), packet.header.get("event")):
                raise PacketError("a piece is cut into pieces")
            yield packet
        if not reader.is_inside_packet:
            self.close(lane)

    def close(self, lane: int) -> None:
        """Forget the unfinished packet of a lane that has ended."""
        self._readers.pop(lane, None)
