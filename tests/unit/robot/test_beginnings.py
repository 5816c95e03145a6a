"""Stamps of trajectories are set to zero or refused; one that was of now when it was first given stays honest."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp.model.commands import LOCAL, SendGoal
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.beginnings import Beginnings

S = 1_000_000_000


class Robot:
    """As much of a robot as a stamp needs: a clock, and values that are JSON already."""

    def __init__(self) -> None:
        self.at_ns = 1_800_000_000 * S
        self.notes: list[str] = []
        self.values = SimpleNamespace(encode=self._same, in_full=self._same)

    def now_ns(self) -> int:
        return self.at_ns

    @staticmethod
    async def _same(_kind: str, value: Any) -> Any:
        return value


def goal(stamp_ns: int) -> SendGoal:
    stamp = {"sec": stamp_ns // S, "nanosec": stamp_ns % S}
    trajectory = {"header": {"stamp": stamp}, "joint_names": ["a"], "points": []}
    value = {"trajectory": trajectory}
    return SendGoal(principal=LOCAL, name="/arm", type="p/action/A", value=value, goal_id="0" * 31 + "1", timeout_s=1)


async def test_a_stamp_of_now_becomes_zero_and_stays_honest_while_a_person_thinks() -> None:
    robot, now = Robot(), [0.0]
    beginnings = Beginnings(lambda: now[0])
    sent = goal(robot.at_ns)
    first = await beginnings.settle(robot, sent)  # type: ignore[arg-type]
    assert first.value == {"trajectory": {"header": {}, "joint_names": ["a"], "points": []}}
    assert sent.value["trajectory"]["header"]["stamp"]["sec"]  # what the client gave is not changed
    assert robot.notes
    robot.at_ns += 300 * S
    now[0] += 300
    assert (await beginnings.settle(robot, sent)).value == first.value  # type: ignore[arg-type]
    now[0] += 700
    with pytest.raises(BadValue, match=r"trajectory\.header\.stamp is 300\.0 s ago"):
        await beginnings.settle(robot, sent)  # type: ignore[arg-type]


async def test_a_stamp_of_another_time_is_refused_and_zero_passes_untouched() -> None:
    robot, beginnings = Robot(), Beginnings()
    for away_s in (-20, 5):
        with pytest.raises(BadValue, match="a trajectory begins on arrival"):
            await beginnings.settle(robot, goal(robot.at_ns + away_s * S))  # type: ignore[arg-type]
    zero = goal(0)
    assert await beginnings.settle(robot, zero) is zero  # type: ignore[arg-type]
    assert robot.notes == []
