"""A navigation whose call is cancelled ends, at whatever moment that is."""

from __future__ import annotations

import asyncio

import pytest

from ros2_mcp.ops.navigation import navigate as module
from ros2_mcp.ops.navigation.navigate import Navigation, navigate
from ros2_mcp.ops.navigation.targets import Target
from ros2_mcp.robot import Robot


class Driving(Navigation):
    """One that goes on until somebody ends it."""

    async def run(self) -> None:
        self.begun()
        await asyncio.Event().wait()


async def test_a_call_that_is_cancelled_while_health_is_looked_at_ends_the_navigation(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    looking = asyncio.Event()

    async def endless(_robot: Robot, _action: str) -> list[str]:
        looking.set()
        await asyncio.Event().wait()
        return []

    monkeypatch.setattr(module, "health_of", endless)
    job = Driving(robot, robot.session(), "/navigate_to_pose", [Target("", "map", 1.0, 0.0, 0.0)])
    await robot.jobs.start(job)
    call = asyncio.create_task(navigate(robot, robot.session(), None, job_id=job.id, timeout_s=0.0))
    await looking.wait()
    call.cancel()
    with pytest.raises(asyncio.CancelledError):
        await call
    assert not job.is_running
