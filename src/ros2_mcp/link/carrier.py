"""What carries the stream to one bridge: the seam under the link.

`Connection`, `Heartbeat` and `Bridge` know a carrier and nothing below it: no process, no signals, no `/proc`. A new
kind of carrier is a module beside `local.py` and a line in `carriers.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, Protocol

from ros2_mcp.model.errors import LinkError

Vitality = Literal["running", "stopped", "starved", "unknown"]
"""What a carrier can see of the far end without asking it: `stopped` from outside (by a debugger), `starved` of
processor time (it wants to run and does not get round), `running`, or `unknown` where it cannot look there."""

SLOW_START = (
    "The next call tries again. If setup files take so long, find out which: time bash -c 'source FILE'. Else this "
    "machine is busy, or ROS waits for the network; ros2-mcp --debug shows the bridge's log."
)
"""The way out for a bridge that is slow to start."""


class Carrier(Protocol):
    """The bytes to and from one bridge, for one life of that bridge: made once, opened once, closed once.

    Whoever makes a carrier starts the far end at once and waits for nothing, so that it needs no event loop; all else
    is for the event loop that `open` was called in. Only `kill` and `close` may be called without `open`.
    """

    @property
    def origin(self) -> str:
        """For people: which ROS installation the bridge runs in, and why that one; empty where it is not known."""
        ...

    @property
    def is_remote(self) -> bool:
        """Whether a network lies between: the stream may be slow, or be cut without anybody being told."""
        ...

    @property
    def lease_s(self) -> float:
        """The link lease: after how long without a packet the bridge stops what this server keeps moving."""
        ...

    @property
    def start_s(self) -> float:
        """How long the bridge may take to say hello after `open`."""
        ...

    async def open(self, received: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        """Hands on what the bridge writes, in order and in pieces of any size, then its end, once."""
        ...

    def write(self, data: bytes) -> None:
        """Queues bytes for the bridge, in order; what can no longer reach it is discarded."""
        ...

    async def writable(self) -> None:
        """Waits while so much is queued that more would only wait; returns at once when the bridge is gone."""
        ...

    def alive(self) -> Vitality:
        """What can be seen of the bridge now; quick, for it is asked several times a second while it is silent."""
        ...

    async def ending(self) -> str:
        """How it ended, in words that follow "The bridge": `died with signal SIGKILL`, `closed its stream`.

        Asked after its end was reported; may wait for a moment to learn it.
        """
        ...

    async def failure(self) -> LinkError | None:
        """Why the far end was not reached, with the way out, for a bridge that never said hello; None where `ending`
        says it. Asked after its end was reported.
        """
        ...

    def log_tail(self) -> Sequence[str]:
        """The last lines that the bridge wrote to its log, the oldest first; empty where they do not come along."""
        ...

    def kill(self) -> None:
        """Ends the far end at once, as far as it is in reach; where it is not, the end of the stream must do."""
        ...

    async def close(self, grace_s: float) -> None:
        """Ends the stream, gives the bridge that long to stop the robot and leave, and leaves nothing behind."""
        ...

    def describe(self) -> str:
        """Which bridge this is, in a few words for error texts: `pid 4711`."""
        ...
