"""What this server allows: one place that decides, and never acts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.commands import Command
from ros2_mcp.model.errors import BadValue, Refused


@dataclass(frozen=True, slots=True)
class Policy:
    """The rules that hold for every command. `recorded`: a recording stands for the robot."""

    read_only: bool = False
    recorded: bool = False

    def check(self, command: Command[Any]) -> None:
        """Decides about a command; called by `Robot.do` alone.

        Raises:
            Refused: when this server may only read.
        """
        if self.read_only:
            raise Refused(
                f"{command.act} is refused: this server is read-only.", "Start it without --read-only to allow it."
            )


def bounded(name: str, value: float, low: float, high: float, unit: str) -> float:
    """`value` if it lies within the limits, which end users can rely on.

    Raises:
        BadValue: naming the limits.
    """
    if not low <= value <= high:
        raise BadValue(name, f"{value:g} {unit} is out of range.", f"Give {low:g} to {high:g} {unit}.")
    return value
