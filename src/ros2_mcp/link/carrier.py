"""The interface of carriers. A carrier transports the stream to one bridge.

`Connection`, `Heartbeat` and `Bridge` use a carrier and nothing below it: no process, signals or `/proc`. A new kind of
carrier is a module next to `local.py` and a line in `carriers.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, Protocol

from ros2_mcp.model.errors import LinkError

Vitality = Literal["running", "stopped", "starved", "unknown"]
"""The observable state of the far end: `stopped` (suspended, for example by a debugger), `starved` (it wants processor
time and gets none), `running`, or `unknown` if the carrier cannot observe it."""

SLOW_START = (
    "The next call tries again. If setup files take so long, find out which: time bash -c 'source FILE'. Else this "
    "machine is busy, or ROS waits for the network; ros2-mcp --debug shows the bridge's log."
)
"""The hint for a bridge that starts slowly."""


class Carrier(Protocol):
    """The bytes to and from one bridge process: created, opened and closed once.

    Creating a carrier starts the far end without waiting, so no event loop is needed; everything else belongs to the
    event loop of `open`. Only `kill` and `close` may be called without `open`.
    """

    @property
    def origin(self) -> str:
        """The ROS installation of the bridge and why it was chosen, for people; "" if unknown."""
        ...

    @property
    def is_remote(self) -> bool:
        """Whether a network lies between: the stream may be slow, or be cut without notice."""
        ...

    @property
    def lease_s(self) -> float:
        """The link lease, in s: after this time without a packet the bridge stops what this server keeps moving."""
        ...

    @property
    def start_s(self) -> float:
        """The time limit for the bridge's hello after `open`, in s."""
        ...

    async def open(self, received: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        """Pass the bridge's output to `received`, in order and in pieces of any size, and call `ended` once at
        its end.
        """
        ...

    def write(self, data: bytes) -> None:
        """Queue bytes for the bridge, in order. Bytes that can no longer reach it are discarded."""
        ...

    async def writable(self) -> None:
        """Wait until the queue has room. Returns at once if the bridge is gone."""
        ...

    def alive(self) -> Vitality:
        """Return the observable state of the bridge now. Must be fast: it is called several times per second of
        silence.
        """
        ...

    async def ending(self) -> str:
        """Return how the bridge ended, in words that follow "The bridge": `died with signal SIGKILL`, `closed its
        stream`.

        Called after `ended`; may wait a moment for the reason.
        """
        ...

    async def failure(self) -> LinkError | None:
        """Return why the far end was not reached, with a hint, for a bridge that never sent a hello; None if `ending`
        says it.

        Called after `ended`.
        """
        ...

    def log_tail(self) -> Sequence[str]:
        """Return the last lines of the bridge's log, oldest first; empty if the carrier does not transport them."""
        ...

    def kill(self) -> None:
        """Kill the far end at once if it can be reached; otherwise it ends with the stream."""
        ...

    async def close(self, grace_s: float) -> None:
        """End the stream, wait up to `grace_s` seconds for the bridge to stop the robot and exit, and clean up."""
        ...

    def describe(self) -> str:
        """Return a short description of the bridge for error messages: `pid 4711`."""
        ...
