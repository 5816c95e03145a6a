"""Limits on the commands in progress at once, for each principal and in total. A stop is never counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import Refused

MOST_ACTS = 512
"""The most commands in progress of one principal: twice as many as the most repeats (`Repetition.most_running`)."""
MOST_ACTS_IN_TOTAL = 1024
"""The most commands in progress in total: two principals can use all of it, and each leaves half to the other."""
MOST_HZ = 5_000.0
"""The largest sum of the rates of one principal's repeats, motions and relays, in Hz. The bridge publishes a message in
about 0.05 ms, so this occupies a quarter of its ROS thread."""
MOST_HZ_IN_TOTAL = 10_000.0
"""The largest sum of rates of all principals, in Hz: half of what the bridge's ROS thread can do, so that a stop has
time. A stop also precedes everything that waits.
"""


@dataclass(slots=True)
class Budgets:
    """The commands in progress, and limits: no principal can keep the bridge from stopping, or block the others."""

    _acts: Counter[str] = field(default_factory=Counter[str])
    _hz: dict[str, float] = field(default_factory=dict[str, float])

    @contextmanager
    def work(self, principal: Principal, rate_hz: float = 0.0) -> Generator[None, None, None]:
        """Count one command while it is in progress.

        Raises:
            Refused: if a limit of this principal or of all would be exceeded; nothing was sent.
        """
        owner = principal.counted_as
        self._check("commands", self._acts[owner], self._acts.total(), (MOST_ACTS, MOST_ACTS_IN_TOTAL), 1)
        own_hz, total_hz = self._hz.get(owner, 0.0), sum(self._hz.values())
        if rate_hz:
            self._check("messages a second", own_hz, total_hz, (MOST_HZ, MOST_HZ_IN_TOTAL), rate_hz)
        self._acts[owner] += 1
        self._hz[owner] = own_hz + rate_hz
        try:
            yield
        finally:
            self._acts[owner] -= 1
            self._hz[owner] -= rate_hz
            if not self._acts[owner]:
                del self._acts[owner], self._hz[owner]

    @staticmethod
    def _check(what: str, own: float, total: float, most: tuple[float, float], more: float) -> None:
        for used, limit, whose in ((own, most[0], "of yours"), (total, most[1], "of all clients")):
            if used + more > limit:
                raise Refused(
                    f"{used:g} {what} {whose} are under way already; at most {limit:g} are allowed. Nothing was sent.",
                    "Wait for some of them to end, or call ros2_stop, which is never refused.",
                )
