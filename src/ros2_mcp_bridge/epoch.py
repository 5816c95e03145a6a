"""The stop epoch: requests accepted before the newest stop, or before the link lease lapsed, are not sent any more.

Nor are requests that arrive so late that their server has given up this bridge (`is_late`). Nor are requests accepted
while the latch is set, or before it was set, even if it has been reset since.

The reading thread raises the epoch as soon as it has read the packet, and the exits check it. So no request overtakes a
stop, however many are queued before it. See docs/decisions/0021-stop-means-stop.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from ros2_mcp_common.latch import Latch

if TYPE_CHECKING:
    from ros2_mcp_common.wire.protocol import EndedBy


class Overtaken(Protocol):
    """A request that a stop may hold back: its operation, its acceptance, and its arguments."""

    op: str
    acceptance: Acceptance | None

    def text(self, name: str, default: str | None = None) -> str:
        """Return one of its arguments."""
        ...


class StopEpoch:
    """The newest known epoch, and how often the link lease has lapsed. Only the reading thread changes them.

    `coming` are accepted requests that act and have not reached the ROS thread. `overtaken` are requests that were held
    back because of a stop. The stop itself, which reaches the ROS thread a little later, takes over both.
    """

    def __init__(self, latch: Latch | None = None) -> None:
        self.latch = latch or Latch()
        self.epoch = 0.0
        self.lapses = 0
        self.is_late = False
        self.coming: dict[Overtaken, None] = {}
        self.overtaken: list[Overtaken] = []

    def raise_to(self, epoch: float) -> None:
        """Raise the epoch. A stop that arrives late changes nothing: the highest epoch counts."""
        self.epoch = max(self.epoch, epoch)

    def take_overtaken(self) -> list[Overtaken]:
        """Return, and forget, the requests that a stop kept from being sent before they were started.

        A second stop does not get them again.
        """
        overtaken, self.overtaken = self.overtaken, []
        for request in list(self.coming):
            if request.acceptance and request.acceptance.overtaken_by() == "stop":
                del self.coming[request]
                overtaken.append(request)
        return overtaken

    def lapse(self) -> None:
        """Record that the link lease has lapsed, or that the stream has ended."""
        self.lapses += 1

    def accept(self, epoch: float) -> Acceptance:
        """Return the acceptance of a request that carries this epoch; the exits check the acceptance."""
        return Acceptance(self, epoch)


class Acceptance:
    """The time at which a request was accepted: the server's epoch, and the numbers of lease lapses and latch settings
    by then.
    """

    def __init__(self, stops: StopEpoch, epoch: float) -> None:
        self._stops = stops
        self._epoch = epoch
        self._lapses = -1 if stops.is_late else stops.lapses  # a late request is never sent
        latch = stops.latch.look()
        self._latchings = -1 if latch.is_set else latch.count  # a request that comes while it is set is never sent

    def overtaken_by(self) -> EndedBy:
        """Return what came after the acceptance and keeps the request from being sent; "" if nothing did."""
        if self._epoch < self._stops.epoch:
            return "stop"
        if self._lapses != self._stops.lapses:
            return "lease"
        latch = self._stops.latch.look()
        return "latch" if latch.is_set or latch.count != self._latchings else ""

    def hold_back(self, request: Overtaken) -> None:
        """Report to the stop a request that an exit has held back."""
        self._stops.overtaken.append(request)
