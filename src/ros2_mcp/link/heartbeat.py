"""Decides whether the bridge still lives: by what it sends, and never because this process was late."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from ros2_mcp.link.carrier import Carrier

# Every answer is a sign of life. Chosen: twice within STOPPED_S, so that a healthy bridge is not silent for that long.
PING_S = 0.25
# While nobody waits for anything of the bridge: a ping and its answer take 0.7 ms of processor time. Chosen.
PING_AT_REST_S = 1.0
# A healthy bridge can be silent for 1 to 3 s while Fast DDS waits for a mutex in shared memory that a killed process
# left locked; with 2.5 s, three of about 1,500 kills cost a healthy bridge. See decision 12.
SILENCE_S = 4.0
# A stopped process does not go on by itself: nothing is gained by waiting longer (decision 12).
STOPPED_S = 0.5
# A machine that is short of processor time gets a second more (decision 12), not for ever.
STARVED_S = 5.0
# As SILENCE_S, for a bridge whose reading thread still answers while its ROS thread hangs in the middleware.
ROS_IDLE_S = 4.0
# When this process is woken this much too late, the time is not counted as silence of the bridge. Chosen.
_LATE_S = 0.05
# The shortest pause, where a limit is due at once. Chosen.
_PAUSE_S = 0.01


class Heartbeat:
    """Pings four times a second and says when the bridge is to be given up.

    At rest, where `is_at_rest` says that nobody waits for anything of the bridge, so that nothing moves either, it
    pings once a second. Whoever wants something of it calls `end_rest` first. `ping` is told in how many seconds the
    next one follows.
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
        """Any bytes of the bridge are a sign of life."""
        self._received_at = time.monotonic()

    @property
    def heard_at(self) -> float:
        """When the last bytes came (monotonic, in s); where this process was late, as much later."""
        return self._received_at

    def ponged(self, ros_idle_s: float) -> None:
        """The bridge's answer to a ping: how long ago its ROS thread went round its loop."""
        self._ros_idle_s = ros_idle_s

    async def until_silent(self) -> str:
        """Returns when the bridge no longer answers; says what was seen, as the rest of `The bridge …`."""
        self.received()
        while True:
            if time.monotonic() >= self._next_ping - _PAUSE_S:  # the event loop may wake up a little early
                is_at_rest = self._is_at_rest()
                self._send_ping(PING_AT_REST_S if is_at_rest else PING_S)
                self._rest = asyncio.get_running_loop().create_future() if is_at_rest else None
            await self._pause()
            verdict = self._verdict(time.monotonic() - self._received_at)
            if verdict:
                return verdict

    def end_rest(self) -> None:
        """Something is wanted of the bridge: it is pinged before it, and as often as while something goes on."""
        if self._rest and not self._rest.done():
            self._send_ping(PING_S)
            self._rest.set_result(None)

    def _send_ping(self, period_s: float) -> None:
        self._ping(period_s)
        self._next_ping = time.monotonic() + period_s

    async def _pause(self) -> None:
        """Sleeps until there is something to do; if woken late, the delay is not counted as silence."""
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
