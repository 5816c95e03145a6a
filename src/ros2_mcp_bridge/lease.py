"""The link lease: the time that the bridge continues without a sign of life from its server."""

from __future__ import annotations

import select
import time
from collections.abc import Callable

from ros2_mcp_common.wire.packets import PacketError

# The period at which it is checked whether this machine has slept while something moved: ten checks a second cost 0.2 %
# of a core. At rest, a sleep is noticed when the lease lapses, or with the next bytes.
LOOK_EVERY_S = 0.1
# Two clocks are compared only if they were read within this time; otherwise the lateness of this thread would look like
# sleep.
READ_AT_ONCE_S = 0.01


def _slept_s() -> float:
    """Return how long this machine has slept since it was started, in s: the steady clock does not run meanwhile."""
    boot_time = getattr(time, "CLOCK_BOOTTIME", None)
    while boot_time is not None:
        before = time.monotonic()
        slept_s = time.clock_gettime(boot_time) - before
        if time.monotonic() - before < READ_AT_ONCE_S:
            return slept_s
    return 0.0


class LinkLease:
    """Waits for the server's bytes, on the reading thread, and reports when none have come for too long.

    Only the kernel knows whether the server was silent: bytes that wait unread, because this process was late, are a
    sign of life. There is no lease before the server has sent its length, and none between its lapse and a new ping.
    `is_at_rest` returns whether nothing moves that a lapse would end. After `orphan_s` without a byte, from the start
    on, the server counts as gone; 0: never.
    """

    def __init__(
        self,
        descriptor: int,
        lapsed: Callable[[float], None],
        *,
        orphan_s: float = 0.0,
        is_at_rest: Callable[[], bool] = lambda: False,
        now: Callable[[], float] = time.monotonic,
        slept_s: Callable[[], float] = _slept_s,
    ) -> None:
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)
        self._lapsed = lapsed
        self._orphan_s = orphan_s
        self._is_at_rest = is_at_rest
        self._now = now
        self._slept_s = slept_s
        self._lease_s = 0.0
        self._heard_at = now()
        self._slept_before_s = slept_s()
        self._is_in_force = False

    def renew(self, lease_s: float) -> None:
        """Renew the lease after a ping: from now on, data must arrive at least this often."""
        if not self._is_in_force:
            self._slept_before_s = self._slept_s()
        self._lease_s = lease_s
        self._is_in_force = lease_s > 0

    def wait_readable(self) -> None:
        """Wait until bytes of the server, or the end of its stream, can be read. Call `lapsed`
        once if the lease lapses.

        Raises:
            PacketError: if nothing came for `orphan_s`, so that the server counts as gone.
        """
        while True:
            is_readable = self._has_bytes(self._look_s())
            now = self._now()
            if self._is_in_force:
                self._check(now, is_readable)
            elif self._orphan_s and now - self._heard_at > self._orphan_s and not (is_readable or self._has_bytes(0.0)):
                raise PacketError(f"nothing came for {self._orphan_s:.0f} s")
            if is_readable:
                self._heard_at = now
                return

    def _look_s(self) -> float | None:
        """Return how long to wait for bytes before the next look at the clock; None for ever."""
        if self._is_in_force:
            left_s = max(self._heard_at + self._lease_s - self._now(), 0.0)
            return left_s if self._is_at_rest() else min(left_s, LOOK_EVERY_S)
        return max(self._heard_at + self._orphan_s - self._now(), 0.0) + LOOK_EVERY_S if self._orphan_s else None

    def _check(self, now: float, is_readable: bool) -> None:
        """End the lease if it has lapsed.

        A look for bytes after `now` was taken shows whether they were really missing.
        """
        slept_s = self._slept_s()
        asleep_s, self._slept_before_s = slept_s - self._slept_before_s, slept_s
        silent_s = now - self._heard_at
        is_silent = silent_s > self._lease_s and not is_readable and not self._has_bytes(0.0)
        if is_silent or asleep_s > self._lease_s:
            self._is_in_force = False
            self._lapsed(silent_s + max(0.0, asleep_s))

    def _has_bytes(self, wait_s: float | None) -> bool:
        return bool(self._poll.poll(None if wait_s is None else wait_s * 1000))
