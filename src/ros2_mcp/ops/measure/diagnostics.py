"""Diagnostics: what the components of a robot say of their health."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.results import iso_time
from ros2_mcp.robot import Robot

DIAGNOSTICS = "/diagnostics"
LEVELS = ("OK", "WARN", "ERROR", "STALE")


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """What a component last said of itself; `level` is OK, WARN, ERROR or STALE."""

    name: str
    hardware_id: str
    level: str
    message: str
    values: dict[str, Any]
    received_at: str


@dataclass(slots=True)
class DiagnosticTable:
    """The newest word of every component, and its worst one."""

    _newest: dict[tuple[str, str], tuple[int, Diagnostic]] = field(
        default_factory=dict[tuple[str, str], tuple[int, Diagnostic]]
    )
    _worst: dict[tuple[str, str], tuple[int, Diagnostic]] = field(
        default_factory=dict[tuple[str, str], tuple[int, Diagnostic]]
    )

    def take_all(self, robot: Robot, type_name: str, samples: Sequence[Sample]) -> bool:
        """Takes samples of diagnostic_msgs/msg/DiagnosticArray in; true if a component got worse."""
        worse = [self.take(robot.values.decode(type_name, sample), sample.received_ns) for sample in samples]
        return any(worse)

    def take(self, message: Any, received_ns: int) -> bool:
        """Takes one message in; true if a component got worse."""
        worse = [self._take_one(status, received_ns) for status in message.status]
        return any(worse)

    @property
    def rows(self) -> list[Diagnostic]:
        """All components, the worst first."""
        return [row for _, row in sorted(self._newest.values(), key=lambda entry: (-entry[0], entry[1].name))]

    @property
    def past(self) -> list[Diagnostic]:
        """The worst words of components that have become better since."""
        return [row for key, (level, row) in self._worst.items() if level > self._newest[key][0]]

    def _take_one(self, status: Any, received_ns: int) -> bool:
        key, level = (status.name, status.hardware_id), int(status.level)
        before = self._newest[key][0] if key in self._newest else 0
        values = {entry.key: entry.value for entry in status.values}
        label = LEVELS[level] if level < len(LEVELS) else str(level)
        row = Diagnostic(status.name, status.hardware_id, label, status.message, values, iso_time(received_ns))
        self._newest[key] = (level, row)
        if key not in self._worst or level > self._worst[key][0]:
            self._worst[key] = (level, row)
        return level > before


async def read_diagnostics(robot: Robot, listen_s: float = 1.5) -> DiagnosticTable:
    """What the components say within a while; most say it once a second.

    Raises:
        NotFound: if nobody publishes diagnostics.
    """
    table = DiagnosticTable()
    end = asyncio.get_running_loop().time() + listen_s
    async with robot.listen(DIAGNOSTICS) as heard:
        while (left := end - asyncio.get_running_loop().time()) > 0:
            table.take_all(robot, heard.type, await heard.take(left))
    return table
