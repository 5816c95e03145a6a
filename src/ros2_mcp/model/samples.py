"""Received messages inside the server: bytes with times, not yet decoded."""

from __future__ import annotations

import struct
from dataclasses import dataclass

STAMP_END = 12
"""Bytes up to the end of a header's stamp: 4 of the CDR encapsulation, 4 of seconds, 4 of nanoseconds."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One received message.

    `received_ns` and `source_ns` are Unix times in nanoseconds (receiver's and publisher's clock; `source_ns` is 0 if
    the middleware gives none). `sequence` is the publisher's number of the message, or None if unknown. `data` is CDR
    with its four-byte encapsulation header; if only its head was requested, `whole_bytes` is the size of the whole
    message, else 0.
    """

    received_ns: int
    source_ns: int
    sequence: int | None
    data: bytes
    whole_bytes: int = 0

    @property
    def size(self) -> int:
        """The size of the whole message in bytes, even if only its head is here."""
        return self.whole_bytes or len(self.data)


@dataclass(frozen=True, slots=True)
class Counts:
    """The outcome of a subscription's messages so far.

    `received` were taken from the middleware; `dropped` of these were discarded by our own bounds (oldest first).
    `lost` never arrived: gaps in the publishers' sequence numbers; None if that cannot be known.
    """

    received: int = 0
    dropped: int = 0
    lost: int | None = 0

    def __add__(self, other: Counts) -> Counts:
        """Add the counts of two successive subscriptions to the same topic."""
        lost = None if self.lost is None or other.lost is None else self.lost + other.lost
        return Counts(self.received + other.received, self.dropped + other.dropped, lost)


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp (ns) of a message that begins with a std_msgs/msg/Header, from its CDR bytes."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds
