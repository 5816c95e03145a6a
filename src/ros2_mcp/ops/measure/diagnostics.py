"""Diagnostics: the status of a robot's components as published on /diagnostics."""

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
# By convention (`diagnostic_updater`) components publish once a second; matching takes up to 0.2 s.
LISTEN_S = 1.5


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """The latest status of a component; `level` is OK, WARN, ERROR or STALE.

    For a recording, `received_at` also gives the offset from its start.
    """

    name: str
    hardware_id: str
    level: str
    message: str
    values: dict[str, Any]
    received_at: str


class DiagnosticTable:
    """The latest and the worst status of every component; for a recording, `began_ns` is its start."""

    def __init__(self, began_ns: int | None = None) -> None:
        self._began_ns = began_ns
        self._newest: dict[tuple[str, str], tuple[int, Diagnostic]] = {}
        self._worst: dict[tuple[str, str], tuple[int, Diagnostic]] = {}

    def add_all(self, robot: Robot, type_name: str, samples: Sequence[Sample]) -> bool:
        """Add messages of diagnostic_msgs/msg/DiagnosticArray; return whether a component's level got worse."""
        worse = [self.add(robot.values.decode(type_name, sample), sample.received_ns) for sample in samples]
        return any(worse)

    def add(self, message: Any, received_ns: int) -> bool:
        """Add one message; return whether a component's level got worse."""
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
        """The latest status of all components, the worst first."""
        return [row for _, row in sorted(self._newest.values(), key=lambda entry: (-entry[0], entry[1].name))]

    @property
    def past(self) -> list[Diagnostic]:
        """The worst status of each component that has improved since."""
        return [row for key, (level, row) in self._worst.items() if level > self._newest[key][0]]


async def read_diagnostics(robot: Robot) -> DiagnosticTable:
    """Return the statuses published within `LISTEN_S`.

    Raises:
        NotFound: if /diagnostics has no publisher.
    """
    table = DiagnosticTable()
    end = monotonic() + LISTEN_S
    async with robot.listen(DIAGNOSTICS) as listening:
        while (left := end - monotonic()) > 0:
            samples = await listening.take(left)
            # decoded in a thread: a message may hold hundreds of statuses, each with many values
            await asyncio.to_thread(table.add_all, robot, listening.type, samples)
    return table
