"""The result of a navigation: its goals, and what became of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from ros2_mcp.model.text import counted, named, quoted
from ros2_mcp.ops.navigation.explain import Explanation
from ros2_mcp.ops.navigation.targets import Target
from ros2_mcp.ops.results.results import SAID

LegState = Literal["under way", "paused", "reached", "failed", "rejected", "canceled", "not begun"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """One goal of a navigation, and its outcome.

    `place` is its name, if it has one; the pose is in `frame` (m, degrees). `duration_s` is the time taken so far.
    `away_m` and `heading_off_deg` are the robot's distance and heading difference from the goal, by its transforms
    (null: not known, or any heading). `recoveries` is the number of Nav2's recoveries, `recovered_by` names those that
    were seen, and `remaining_m` is the distance to a goal not reached, as Nav2 last reported it.
    """

    place: str
    frame: str
    x_m: float
    y_m: float
    yaw_deg: float | None
    outcome: LegState
    duration_s: float | None = None
    away_m: float | None = None
    heading_off_deg: float | None = None
    remaining_m: float | None = None
    recoveries: int = 0
    recovered_by: str = ""
    goal_id: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Navigated:
    """The state of a navigation. `job_id` is the job that continues while it is `under way`; `explanation` says why a
    goal failed.

    While it is under way, `health` has sentences on localisation, costmaps, sensors, servers, and what may keep the
    base from moving.
    """

    outcome: LegState = field(metadata=SAID)
    action_name: str
    job_id: str
    duration_s: float = field(metadata=SAID)
    legs: Sequence[Leg]
    explanation: Explanation | None = None
    health: Sequence[str] = field(default=(), metadata=SAID)
    note: str = ""

    @property
    def has_failed(self) -> bool:
        """Whether the goal was not reached. A navigation that is still running or was cancelled has not failed."""
        return self.outcome in ("failed", "rejected", "not begun")

    def summary(self) -> list[str]:
        """Return the outcome, one line per leg, and the cause of a failure."""
        why = self.explanation
        ended = f"{self.outcome} after {self.duration_s:.1f} s."
        if why is None:
            return [f"{ended} {self.note}".strip(), *map(line_of, self.legs), *self.health]
        note = "" if self.note.startswith(why.cause) or not self.note else f" {self.note}"
        lines = [f"{ended} Cause: {why.cause}{note}", f"What would help: {' '.join(why.helps)}"]
        lines += [f"Nav2 says: {why.error}"] if why.error else []
        return [*lines, *map(line_of, self.legs), *self.health]


def line_of(leg: Leg) -> str:
    """Return one line on a goal."""
    where = f"{quoted(leg.place)} " if leg.place else ""
    facing = "" if leg.yaw_deg is None else f" facing {leg.yaw_deg:.0f}°"
    told = f"{where}({leg.x_m:.2f}, {leg.y_m:.2f}){facing} in {named(leg.frame)}: {leg.outcome}"
    if leg.duration_s is not None:
        told += f" after {leg.duration_s:.1f} s"
    if leg.away_m is not None:
        turned = "" if leg.heading_off_deg is None else f" and {abs(leg.heading_off_deg):.0f}°"
        told += f", {leg.away_m:.2f} m{turned} from the goal"
    if leg.outcome == "under way" and leg.remaining_m is not None:
        told += f", {leg.remaining_m:.1f} m to go"
    if leg.recoveries:
        by = f" ({leg.recovered_by})" if leg.recovered_by else ""
        told += f", {counted(leg.recoveries, 'recovery', 'recoveries')}{by}"
    return f"{told}. {leg.note}".rstrip()


def not_begun(target: Target) -> Leg:
    """Return a goal that was not sent yet."""
    yaw = None if target.yaw_rad is None else round(math.degrees(target.yaw_rad), 1)
    return Leg(place=target.name, frame=target.frame, x_m=target.x_m, y_m=target.y_m, yaw_deg=yaw, outcome="not begun")
