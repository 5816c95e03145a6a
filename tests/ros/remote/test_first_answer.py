"""How long the first answer takes: of a robot behind ssh hardly longer than of this machine's."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import pytest

from support.driver import Driver
from support.network_link import NetworkLink
from support.standstill import undisturbed

ROUNDS = 11
RTT_S = 0.02
ALLOWED_S = 0.5

pytestmark = [pytest.mark.full, pytest.mark.timeout(900)]


def test_the_first_answer_over_ssh_comes_within_half_a_second_of_the_local_one(
    laptop: Callable[..., Driver], link: NetworkLink, ros_environment: dict[str, str]
) -> None:
    link.delay_s = RTT_S / 2

    def took(begin: Callable[[], Driver]) -> float:
        begun = time.monotonic()
        server = begin()
        assert server.do("ros2_status")["domain_id"] is not None
        answered_s = time.monotonic() - begun
        server.end()
        return answered_s

    def measured() -> tuple[float, float]:
        return took(lambda: Driver(ros_environment, "--tools", "all")), took(laptop)

    rounds = [undisturbed(measured) for _ in range(ROUNDS)]
    here, there = [near for near, _ in rounds], [far for _, far in rounds]
    more = [far - near for near, far in rounds]
    print(f"here {statistics.median(here):.2f} s (at most {max(here):.2f});", end=" ")
    print(f"over ssh {statistics.median(there):.2f} s (at most {max(there):.2f});", end=" ")
    print(f"more: {statistics.median(more):.2f} s ({min(more):.2f} to {max(more):.2f})", flush=True)
    assert statistics.median(more) <= ALLOWED_S
