"""The relays that this server runs, and the one rule about them: none may feed itself."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import RelayCounts

_KEPT = 20


@dataclass(slots=True)
class Relay:
    """What a relay was asked to do, and how it is.

    `qos` says in words what was chosen at its source and at its destination. `counts` are the bridge's last counts;
    `held_back` and `failed` count what the server itself did not pass on (`last_trouble` says why it failed last), and
    `dropped_here` what it had no time for, `lost_here` what never reached it.
    `work` is the task that keeps it alive.
    """

    relay_id: str
    source: str
    destination: str
    source_type: str
    destination_type: str
    transform: str
    rate_hz: float | None
    duration_s: float
    tolerances: Mapping[str, float]
    mapping: Mapping[str, str]
    in_server: bool
    qos: Sequence[str] = ()
    state: str = "starting"
    failure: RobotError | None = None
    last_trouble: str = ""
    counts: RelayCounts = field(default_factory=RelayCounts)
    held_back: int = 0
    failed: int = 0
    dropped_here: int = 0
    lost_here: int | None = 0
    work: asyncio.Task[None] | None = None

    @property
    def is_open(self) -> bool:
        """Whether it has not ended."""
        return self.state in ("starting", "running")


class Relays:
    """The relays by their ids: all that are open, and the last that ended."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._known: dict[str, Relay] = {}

    def new_id(self) -> str:
        """An id that no other relay of this server has or had."""
        return f"relay_{next(self._numbers)}"

    def add(self, relay: Relay) -> None:
        """Takes in a new one; the oldest that have ended are forgotten."""
        self._known[relay.relay_id] = relay
        ended = [relay_id for relay_id, known in self._known.items() if not known.is_open]
        for relay_id in ended[:-_KEPT]:
            del self._known[relay_id]

    @property
    def known(self) -> Mapping[str, Relay]:
        """All by their ids, in the order of their start."""
        return dict(self._known)

    @property
    def open(self) -> list[Relay]:
        """Those that have not ended."""
        return [relay for relay in self._known.values() if relay.is_open]

    def way(self, start: str, end: str) -> list[str]:
        """The topics on the way along open relays from one topic to another; empty if there is none."""
        ways = [[start]]
        seen = {start}
        for way in ways:  # grows while it is walked: breadth first
            if way[-1] == end:
                return way
            onward = [relay.destination for relay in self.open if relay.source == way[-1]]
            ways += [[*way, topic] for topic in onward if topic not in seen]
            seen.update(onward)
        return []
