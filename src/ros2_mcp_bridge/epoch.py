"""The stop epoch: what was accepted before the newest stop, or before the link lease lapsed, does not leave any more.

Nor does what comes so late that its server has given this bridge up: `is_late`.

Nor does anything while the latch is set, or what was accepted before it was set, whoever has reset it since.

The reading thread raises it as soon as it has read the packet, and the exits ask. So nothing overtakes a stop, however
many requests wait before it. See docs/decisions/0021-stop-means-stop.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from ros2_mcp_common.latch import Latch

if TYPE_CHECKING:
    from ros2_mcp_common.wire.protocol import EndedBy


class Overtaken(Protocol):
    """A request that a stop may keep back: what it is, when it was accepted, and its arguments."""

    op: str
    acceptance: Acceptance | None

    def text(self, name: str, default: str | None = None) -> str:
        """One of its arguments."""
        ...


class StopEpoch:
    """The newest epoch that was heard of, and how often the link lease has lapsed; only the reading thread changes it.

    `coming` are the acting requests that were accepted and have not come to the ROS thread. `overtaken` are those that
    were held back because of a stop: the stop itself, which comes to the ROS thread a little later, takes both over.
    """

    def __init__(self, latch: Latch | None = None) -> None:
        self.latch = latch or Latch()
        self.epoch = 0.0
        self.lapses = 0
        self.is_late = False
        self.coming: dict[Overtaken, None] = {}
        self.overtaken: list[Overtaken] = []

    def raise_to(self, epoch: float) -> None:
        """Stops that arrive late change nothing: the highest counts."""
        self.epoch = max(self.epoch, epoch)

    def take_overtaken(self) -> list[Overtaken]:
        """Those that a stop has kept from leaving before they were open; a second stop does not hear of them again."""
        overtaken, self.overtaken = self.overtaken, []
        for request in list(self.coming):
            if request.acceptance and request.acceptance.overtaken_by() == "stop":
                del self.coming[request]
                overtaken.append(request)
        return overtaken

    def lapse(self) -> None:
        """The link lease has lapsed, or the stream has ended."""
        self.lapses += 1

    def accept(self, epoch: float) -> Acceptance:
        """What a request that carries this epoch shows at the exits."""
        return Acceptance(self, epoch)


class Acceptance:
    """When a request was accepted: in which epoch of the server, after how many lapses of the lease and latchings."""

    def __init__(self, stops: StopEpoch, epoch: float) -> None:
        self._stops = stops
        self._epoch = epoch
        self._lapses = -1 if stops.is_late else stops.lapses  # what comes too late never leaves
        latch = stops.latch.look()
        self._latchings = -1 if latch.is_set else latch.count  # what comes while it is set never leaves

    def overtaken_by(self) -> EndedBy:
        """What came after it and keeps it from leaving; "" where nothing did."""
        if self._epoch < self._stops.epoch:
            return "stop"
        if self._lapses != self._stops.lapses:
            return "lease"
        latch = self._stops.latch.look()
        return "latch" if latch.is_set or latch.count != self._latchings else ""

    def hold_back(self, request: Overtaken) -> None:
        """Let the stop know of a request that an exit has held back."""
        self._stops.overtaken.append(request)
