"""Received messages as they travel through the server: bytes with times, not yet values."""

from __future__ import annotations

import struct
from dataclasses import dataclass

STAMP_END = 12
"""Bytes up to the end of a header's stamp: 4 of the CDR encapsulation, 4 of seconds, 4 of nanoseconds."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One received message.

    `received_ns` and `source_ns` are Unix times in nanoseconds (receiver's and publisher's clock; `source_ns` is 0
    where the middleware gives none). `sequence` counts the publisher's messages, or is None where unknown.
    `data` is CDR with its four-byte encapsulation header; where only its head was asked for, `whole_bytes` is the size
    of all of it, else 0.
    """

    received_ns: int
    source_ns: int
    sequence: int | None
    data: bytes
    whole_bytes: int = 0

    @property
    def size(self) -> int:
        """Of the message in bytes, whether all of it is here or not."""
        return self.whole_bytes or len(self.data)


@dataclass(frozen=True, slots=True)
class Counts:
    """What became of a subscription's messages so far.

    `received` were taken from the middleware; of these `dropped` were discarded by our own bounds (oldest first).
    `lost` never reached us: gaps in the publishers' sequence numbers; None where that cannot be known.
    """

    received: int = 0
    dropped: int = 0
    lost: int | None = 0

    def __add__(self, other: Counts) -> Counts:
        """Those of two subscriptions to the same topic, one after the other."""
        lost = None if self.lost is None or other.lost is None else self.lost + other.lost
        return Counts(self.received + other.received, self.dropped + other.dropped, lost)


def header_stamp_ns(data: bytes) -> int:
    """The stamp of a message that starts with a std_msgs/msg/Header, from its CDR bytes."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds
