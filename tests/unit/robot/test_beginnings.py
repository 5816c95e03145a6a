"""Stamps of trajectories are set to zero or refused; one that was of now when it was first given stays honest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import pytest

from ros2_mcp.model.commands import LOCAL, SendGoal
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.beginnings import Beginnings
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp.robot.session import Session
from ros2_mcp.robot.stops import Accepted
from ros2_mcp.robot.values import Values

S = 1_000_000_000


class Json:
    """Values that are JSON already."""

    async def encode(self, _kind: str, value: Any) -> Any:
        return value

    async def in_full(self, _kind: str, body: Any) -> Any:
        return body


@dataclass
class Clock:
    at_ns: int = 1_800_000_000 * S

    def now_ns(self) -> int:
        return self.at_ns


def prepared(command: SendGoal) -> Prepared[SendGoal]:
    session = Session(principal=LOCAL, accepted=Accepted(0, 0))
    return Prepared(cast(Values, Json()), session, command)


def goal(stamp_ns: int) -> SendGoal:
    stamp = {"sec": stamp_ns // S, "nanosec": stamp_ns % S}
    trajectory = {"header": {"stamp": stamp}, "joint_names": ["a"], "points": []}
    value = {"trajectory": trajectory}
    return SendGoal(principal=LOCAL, name="/arm", type="p/action/A", value=value, goal_id="0" * 31 + "1", timeout_s=1)


async def test_a_stamp_of_now_becomes_zero_and_stays_honest_while_a_person_thinks() -> None:
    clock, now = Clock(), [0.0]
    beginnings = Beginnings(lambda: now[0])
    sent = goal(clock.at_ns)
    first = await beginnings.settle(prepared(sent), clock.now_ns)
    assert first.command.value == {"trajectory": {"header": {}, "joint_names": ["a"], "points": []}}
    assert cast(Any, sent.value)["trajectory"]["header"]["stamp"]["sec"]  # what the client gave is not changed
    assert first.session.notes
    clock.at_ns += 300 * S
    now[0] += 300
    assert (await beginnings.settle(prepared(sent), clock.now_ns)).command.value == first.command.value
    now[0] += 700
    with pytest.raises(BadValue, match=r"trajectory\.header\.stamp is 300\.0 s ago"):
        await beginnings.settle(prepared(sent), clock.now_ns)


async def test_a_stamp_of_another_time_is_refused_and_zero_passes_untouched() -> None:
    clock, beginnings = Clock(), Beginnings()
    for away_s in (-20, 5):
        with pytest.raises(BadValue, match="a trajectory begins on arrival"):
            await beginnings.settle(prepared(goal(clock.at_ns + away_s * S)), clock.now_ns)
    zero = prepared(goal(0))
    assert await beginnings.settle(zero, clock.now_ns) is zero
    assert zero.session.notes == []
