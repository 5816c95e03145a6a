"""How much work that acts may be under way at once, for one principal and in total. Stopping counts nowhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import Refused

MOST_ACTS = 512
"""Commands of one principal that are under way. Chosen: twice as many as may be repeats (`Repetition.most_running`)."""
MOST_ACTS_IN_TOTAL = 1024
"""Of all of them. Chosen: two principals can take all that there is, and each of them leaves the other its half."""
MOST_HZ = 5_000.0
"""The sum of the rates of what one principal repeats and relays at a rate. The bridge publishes one message in about
0.05 ms, so that this keeps a quarter of its ROS thread busy."""
MOST_HZ_IN_TOTAL = 10_000.0
"""Of all of them: half of its ROS thread. Then a stop, which goes before all that waits, still has room."""


@dataclass(slots=True)
class Budgets:
    """What is under way now; bounds so that nobody can keep the bridge from stopping, or from others."""

    _acts: Counter[str] = field(default_factory=Counter[str])
    _hz: dict[str, float] = field(default_factory=dict[str, float])

    @contextmanager
    def work(self, principal: Principal, rate_hz: float = 0.0) -> Generator[None, None, None]:
        """Around one command, until it is answered.

        Raises:
            Refused: if it would be too much, for this principal or in total; nothing was sent.
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
