"""`ros2_nav_route`: places in order, in loops, with waits, and going on after a missed place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.nav2 import NAVIGATE
from ros2_mcp.model.text import counted, quoted
from ros2_mcp.ops.navigation.action_names import action_of
from ros2_mcp.ops.navigation.home import targets_in
from ros2_mcp.ops.navigation.navigate import Navigation, known_job, wait_for
from ros2_mcp.ops.navigation.navigated import Leg
from ros2_mcp.ops.navigation.route_plan import MOST_LOOPS, RoutePlan, Visits
from ros2_mcp.ops.results.results import SAID, Report, silent
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.wire.limits import MAX_DURATION_S

OnMissed = Literal["stop", "go_on"]
RouteState = Literal["under way", "paused", "done", "failed", "canceled"]
PlaceState = Literal["reached", "missed", "under way", "paused", "canceled", "not begun"]
_MOST_SAID = 12
"""Places in the first line; of a longer list it names only places with another result than reached."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutePlace:
    """One place of a route, with the outcome of its last visit; `reached` and `missed` count its visits.

    `cause` and `helps` belong to the last miss. `away_m` is the robot's distance from the place at the end of the last
    visit.
    """

    place: str
    x_m: float
    y_m: float
    yaw_deg: float | None
    frame: str
    state: PlaceState
    reached: int
    missed: int
    duration_s: float | None = None
    away_m: float | None = None
    remaining_m: float | None = None
    cause: str = ""
    helps: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Routed:
    """The state of a route: `done` once all places were tried, `failed` if it ended before that.

    `job_id` is the job that continues while it is `under way` or `paused`; `health` then has sentences on what was
    observed.
    """

    outcome: RouteState = field(metadata=SAID)
    action_name: str
    job_id: str
    duration_s: float = field(metadata=SAID)
    loop: int = field(metadata=SAID)
    loops: int = field(metadata=SAID)
    places: Sequence[RoutePlace]
    health: Sequence[str] = field(default=(), metadata=SAID)
    note: str = field(default="", metadata=SAID)

    @property
    def has_failed(self) -> bool:
        """Whether it ended before all places were tried, or none was reached."""
        reached = any(place.reached for place in self.places)
        return self.outcome == "failed" or (self.outcome == "done" and not reached)

    def summary(self) -> list[str]:
        """Return the outcome with each place in one line, and what is seen."""
        reached, missed = sum(one.reached for one in self.places), sum(one.missed for one in self.places)
        in_loop = f", loop {self.loop} of {self.loops}" if self.loops > 1 else ""
        numbered = list(enumerate(self.places, 1))
        told = [_told(number, place, self.loops) for number, place in numbered]
        if len(told) > _MOST_SAID:
            told = [_told(number, one, self.loops) for number, one in numbered if one.missed or one.state in _ON_WAY]
        of = len(self.places) * self.loops
        missing = f", {missed} MISSED" if missed else ""
        head = f"{self.outcome} after {self.duration_s:.1f} s{in_loop}: {reached} of {counted(of, 'place')} reached"
        each = f": {'; '.join(told)}" if told else ""
        helps = list(dict.fromkeys(place.helps for place in self.places if place.helps))
        return [
            f"{head}{missing}{each}. {self.note}".rstrip(),
            *([f"What would help: {' '.join(helps)}"] if helps else []),
            *self.health,
        ]


_ON_WAY = frozenset({"under way", "paused", "canceled"})


def _told(number: int, place: RoutePlace, loops: int) -> str:
    name = quoted(place.place) if place.place else f"({place.x_m:.2f}, {place.y_m:.2f})"
    times = f" {place.reached}×" if loops > 1 and place.reached else ""
    told: list[str] = [f"reached{times}"] if place.reached else []
    if place.missed:
        why = f" ({place.cause.rstrip('.')})" if place.cause else ""
        told.append(f"MISSED{f' {place.missed}×' if loops > 1 else ''}{why}")
    if place.state in _ON_WAY or not told:
        left = f", {place.remaining_m:.1f} m to go" if place.remaining_m is not None else ""
        told.append(f"{place.state}{left}")
    return f"{number} {name} {', '.join(told)}"


async def route(
    robot: Robot,
    session: Session,
    to: object,
    *,
    loops: int = 1,
    wait_s: float = 0.0,
    on_missed: OnMissed = "stop",
    action: str = "",
    job_id: str = "",
    timeout_s: float = 45.0,
    stuck_s: float | None = None,
    report: Report = silent,
) -> Routed:
    """Drive to places in order, or wait for a running route; wait at most `timeout_s`, after which it continues.

    Each place may have a `wait_s` of its own. Cancelling this call ends the route.

    Raises:
        BadInput: for a malformed place, or neither places nor a job.
        NotFound: for an unknown place or job, or without Nav2.
        RobotError: what sending the first goal raises; nothing was sent then, unless the error says so.
    """
    bounded("timeout_s", timeout_s, 0.0, MAX_DURATION_S, "s")
    bounded("loops", loops, 1, MOST_LOOPS, "loops")
    if job_id or to is None:
        job = known_job(robot, to, job_id)
    else:
        places, waits_s = _with_waits(to, bounded("wait_s", wait_s, 0.0, MAX_DURATION_S, "s"))
        targets = targets_in(robot, places)
        plan = RoutePlan(loops, waits_s if any(waits_s) else (), on_missed == "go_on")
        job = Navigation(robot, session, await action_of(robot, NAVIGATE, action), targets, stuck_s, plan)
        job.tool = "ros2_nav_route"
        await robot.jobs.start(job)
    health = await wait_for(robot, job, timeout_s, report)
    return routed(job, health)


def _with_waits(to: object, wait_s: float) -> tuple[list[object], list[float]]:
    """Return the places without their waits, and the wait at each in s."""
    places: list[object] = []
    waits_s: list[float] = []
    for one in cast("list[object]", to) if isinstance(to, list) else [to]:
        place, own_s = one, wait_s
        if isinstance(one, Mapping) and "wait_s" in one:
            fields = dict(cast("Mapping[str, Any]", one))
            own_s = fields.pop("wait_s")
            place = fields
        if isinstance(own_s, bool) or not isinstance(own_s, (int, float)) or not math.isfinite(own_s):
            raise BadValue("to.wait_s", "a number of seconds is expected.", 'Write {"place": "door", "wait_s": 10}.')
        places.append(place)
        waits_s.append(bounded("to.wait_s", float(own_s), 0.0, MAX_DURATION_S, "s"))
    return places, waits_s


def routed(job: Navigation, health: Sequence[str] = ()) -> Routed:
    """Return the result of a route as it is known now."""
    now = job.so_far()
    was_all_tried = sum(visit.reached + visit.missed for visit in job.visits) == len(job.legs) * job.plan.loops
    outcome: RouteState = "failed"
    if now.outcome in ("under way", "paused", "canceled"):
        outcome = now.outcome
    elif was_all_tried and (now.outcome == "reached" or job.plan.goes_on):
        outcome = "done"
    last = job.legs[job.now]
    note = now.note or ("" if outcome in ("done", "under way") else last.note)
    return Routed(
        outcome=outcome,
        action_name=job.action,
        job_id=job.id,
        duration_s=now.duration_s,
        loop=job.loop,
        loops=job.plan.loops,
        places=[_place(leg, visit) for leg, visit in zip(now.legs, job.visits, strict=True)],
        health=health,
        note=note or ("It ended at a missed place." if outcome == "failed" else ""),
    )


def _place(leg: Leg, visit: Visits) -> RoutePlace:
    state: PlaceState = "missed" if leg.outcome in ("failed", "rejected") else leg.outcome
    return RoutePlace(
        place=leg.place,
        x_m=leg.x_m,
        y_m=leg.y_m,
        yaw_deg=leg.yaw_deg,
        frame=leg.frame,
        state=state,
        reached=visit.reached,
        missed=visit.missed,
        duration_s=leg.duration_s,
        away_m=leg.away_m,
        remaining_m=leg.remaining_m if leg.outcome == "under way" else None,
        cause=visit.cause,
        helps=visit.helps,
    )
