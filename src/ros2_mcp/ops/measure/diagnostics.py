"""Diagnostics: what the components of a robot report of their health on /diagnostics."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

from ros2_mcp.model.samples import Sample
from ros2_mcp.model.times import recorded_time
from ros2_mcp.robot import Robot

DIAGNOSTICS = "/diagnostics"
LEVELS = ("OK", "WARN", "ERROR", "STALE")
# Components report once a second by convention (`diagnostic_updater`), and matching takes up to 0.2 s.
LISTEN_S = 1.5


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """What a component last reported of itself; `level` is OK, WARN, ERROR or STALE.

    Of a recording `received_at` also says how long after its beginning.
    """

    name: str
    hardware_id: str
    level: str
    message: str
    values: dict[str, Any]
    received_at: str


class DiagnosticTable:
    """The newest status of every component, and its worst one; of a recording that began at `began_ns`."""

    def __init__(self, began_ns: int | None = None) -> None:
        self._began_ns = began_ns
        self._newest: dict[tuple[str, str], tuple[int, Diagnostic]] = {}
        self._worst: dict[tuple[str, str], tuple[int, Diagnostic]] = {}

    def add_all(self, robot: Robot, type_name: str, samples: Sequence[Sample]) -> bool:
        """Takes samples of diagnostic_msgs/msg/DiagnosticArray in; true if a component got worse."""
        worse = [self.add(robot.values.decode(type_name, sample), sample.received_ns) for sample in samples]
        return any(worse)

    def add(self, message: Any, received_ns: int) -> bool:
        """Takes one message in; true if a component got worse than it was before."""
        is_worse = False
        for status in message.status:
            key, level = (status.name, status.hardware_id), int(status.level)
            is_worse |= level > (self._newest[key][0] if key in self._newest else 0)
            row = Diagnostic(
                status.name,
                status.hardware_id,
                LEVELS[level] if level < len(LEVELS) else str(level),
                status.message,
                {entry.key: entry.value for entry in status.values},
                recorded_time(received_ns, self._began_ns),
            )
            self._newest[key] = (level, row)
            if key not in self._worst or level > self._worst[key][0]:
                self._worst[key] = (level, row)
        return is_worse

    @property
    def rows(self) -> list[Diagnostic]:
        """All components, the worst first."""
        return [row for _, row in sorted(self._newest.values(), key=lambda entry: (-entry[0], entry[1].name))]

    @property
    def past(self) -> list[Diagnostic]:
        """The worst statuses of components that have become better since."""
        return [row for key, (level, row) in self._worst.items() if level > self._newest[key][0]]


async def read_diagnostics(robot: Robot) -> DiagnosticTable:
    """What the components report within `LISTEN_S`.

    Raises:
        NotFound: if nobody publishes diagnostics.
    """
    table = DiagnosticTable()
    end = monotonic() + LISTEN_S
    async with robot.listen(DIAGNOSTICS) as listening:
        while (left := end - monotonic()) > 0:
            samples = await listening.take(left)
            # a robot's may be of hundreds of statuses, each with many values: not on the event loop
            await asyncio.to_thread(table.add_all, robot, listening.type, samples)
    return table
