"""Decide whether the bridge is alive, by the bytes that it sends. A delay of this process never counts against the
bridge.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from ros2_mcp.link.carrier import Carrier

# The period of pings, whose replies are signs of life: twice within STOPPED_S, so that a healthy bridge is never silent
# for that long.
PING_S = 0.25
# The period while nothing waits for the bridge: a ping and its reply take 0.7 ms of processor time.
PING_AT_REST_S = 1.0
# The longest silence of a bridge. A healthy one can be silent for 1 to 3 s while Fast DDS waits for a mutex in shared
# memory that a killed process left locked; with 2.5 s, three of about 1,500 kills cost a healthy bridge (decision 12).
SILENCE_S = 4.0
# The limit for a suspended process, which does not resume on its own: a longer wait gains nothing (decision 12).
STOPPED_S = 0.5
# The limit on a machine that is short of processor time: a second more (decision 12).
STARVED_S = 5.0
# The same limit for the ROS thread, which may hang in the middleware while the reading thread still replies.
ROS_IDLE_S = 4.0
# If this process wakes up this much too late, the delay is not counted as silence of the bridge.
_LATE_S = 0.05
# The shortest pause, if a limit is due at once.
_PAUSE_S = 0.01


class Heartbeat:
    """Sends pings four times a second, and reports when the bridge is to be given up.

    At rest, when `is_at_rest` says that nothing waits for the bridge (so nothing moves either), it pings once a second.
    `end_rest` must be called before each request. The argument of `ping` is the time until the next ping, in s.
    """

    def __init__(self, carrier: Carrier, ping: Callable[[float], None], is_at_rest: Callable[[], bool]) -> None:
        self._carrier = carrier
        self._ping = ping
        self._is_at_rest = is_at_rest
        self._next_ping = 0.0
        self._rest: asyncio.Future[None] | None = None
        self._received_at = time.monotonic()
        self._ros_idle_s = 0.0

    def received(self) -> None:
        """Record that bytes arrived from the bridge: any bytes are a sign of life."""
        self._received_at = time.monotonic()

    @property
    def heard_at(self) -> float:
        """The arrival time of the last bytes (monotonic, in s), plus delays of this process since then."""
        return self._received_at

    def ponged(self, ros_idle_s: float) -> None:
        """Record the time since the last turn of the bridge's ROS thread, from its reply to a ping."""
        self._ros_idle_s = ros_idle_s

    async def until_silent(self) -> str:
        """Return once the bridge no longer replies, with what was observed, in words that follow `The bridge …`."""
        self.received()
        while True:
            if time.monotonic() >= self._next_ping - _PAUSE_S:  # the event loop may wake up slightly early
                is_at_rest = self._is_at_rest()
                self._send_ping(PING_AT_REST_S if is_at_rest else PING_S)
                self._rest = asyncio.get_running_loop().create_future() if is_at_rest else None
            await self._pause()
            verdict = self._verdict(time.monotonic() - self._received_at)
            if verdict:
                return verdict

    def end_rest(self) -> None:
        """End the rest before a request: send a ping, and continue with the short period."""
        if self._rest and not self._rest.done():
            self._send_ping(PING_S)
            self._rest.set_result(None)

    def _send_ping(self, period_s: float) -> None:
        self._ping(period_s)
        self._next_ping = time.monotonic() + period_s

    async def _pause(self) -> None:
        """Sleep until the next ping or limit. The delay of a late wake-up is not counted as silence."""
        before = time.monotonic()
        limits = (self._next_ping, *(self._received_at + limit for limit in (STOPPED_S, SILENCE_S)))
        wait_s = max(_PAUSE_S, min(limit - before for limit in limits if limit > before))
        if self._rest and not self._rest.done():
            wait_s = self._next_ping - before
            await asyncio.wait({self._rest}, timeout=wait_s)
        else:
            await asyncio.sleep(wait_s)
        lag_s = time.monotonic() - before - wait_s
        if lag_s > _LATE_S:
            self._received_at = min(time.monotonic(), self._received_at + lag_s)

    def _verdict(self, silent_s: float) -> str:
        if self._ros_idle_s > ROS_IDLE_S:
            return f"no longer responds (its ROS thread has hung for {self._ros_idle_s:.1f} s)"
        if silent_s < STOPPED_S + (PING_AT_REST_S if self._rest and not self._rest.done() else 0.0):
            return ""
        vitality = self._carrier.alive()
        if vitality == "stopped":
            return f"was stopped and has not answered for {silent_s:.1f} s"
        limit_s = STARVED_S if vitality == "starved" else SILENCE_S
        return f"stopped answering for {silent_s:.1f} s" if silent_s >= limit_s else ""
