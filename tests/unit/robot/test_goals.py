"""The goals of this server are jobs that the robot carries out: they are asked to end, and known until they have."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from typing import Any

import pytest

from ros2_mcp.model.commands import LOCAL, Principal
from ros2_mcp.robot.goals import UNKNOWN_GOAL, Goal
from ros2_mcp.robot.jobs import Jobs
from support.tasks import soon

pytestmark = pytest.mark.anyio
OTHER = Principal(name="session 2", transport="http")


class Server:
    """What an action server is asked."""

    def __init__(self) -> None:
        self.cancelled: list[str] = []
        self.return_code = 0

    def goal(self, goal_id: str, owner: Principal = LOCAL) -> Goal:
        async def cancel() -> Mapping[str, Any]:
            self.cancelled.append(goal_id)
            return {"return_code": self.return_code}

        return Goal(owner=owner, goal_id=goal_id, action="/go", action_type="pkg/action/Go", ask_to_cancel=cancel)


@pytest.fixture
async def jobs() -> AsyncGenerator[Jobs, None]:
    jobs = Jobs()
    yield jobs
    await jobs.close()


@pytest.fixture
def server() -> Server:
    return Server()


async def test_a_goal_that_ended_is_still_ours_but_no_longer_open(jobs: Jobs, server: Server) -> None:
    await jobs.start(goal := server.goal("a"))
    assert jobs.get(Goal, "a") is goal and [known.action for known in jobs.running(Goal)] == ["/go"]
    goal.has_been_seen_to_end()
    assert (jobs.all(Goal), jobs.running(Goal)) == ([goal], [])  # at once, and not only when its task has run
    await goal.stop()
    assert await goal.wait(20.0) and goal.state == "ended" and server.cancelled == []


async def test_of_the_goals_sent_the_oldest_are_given_up_and_in_the_end_forgotten(jobs: Jobs, server: Server) -> None:
    for number in range(2 * Goal.most_running + 2):
        await jobs.start(server.goal(str(number)))
    assert jobs.get(Goal, "0") is None and len(jobs.running(Goal)) == Goal.most_running
    assert server.cancelled == []


async def test_a_goal_is_open_until_it_is_seen_to_end_however_often_it_is_stopped(jobs: Jobs, server: Server) -> None:
    await jobs.start(goal := server.goal("a"))
    await goal.stop()
    await goal.stop()
    assert goal.is_running and server.cancelled == ["a", "a"]


async def test_the_end_of_a_client_cancels_its_goals_and_no_others(jobs: Jobs, server: Server) -> None:
    for goal in (server.goal("a"), server.goal("b", OTHER)):
        await jobs.start(goal)
    await jobs.stop_owned(OTHER)
    assert server.cancelled == ["b"]


async def test_the_end_of_the_server_leaves_the_goals_to_the_fail_safes(jobs: Jobs, server: Server) -> None:
    await jobs.start(goal := server.goal("a"))
    await jobs.close()
    assert server.cancelled == [] and not goal.is_running


async def test_a_goal_that_its_server_has_yet_to_accept_is_asked_to_be_cancelled_until_it_knows_it(
    jobs: Jobs, server: Server
) -> None:
    await jobs.start(goal := server.goal("a"))
    server.return_code = UNKNOWN_GOAL
    stopping = asyncio.ensure_future(goal.stop())
    await soon(lambda: len(server.cancelled) > 2)
    server.return_code = 0
    await stopping
    asked = len(server.cancelled)
    goal.is_accepted, server.return_code = True, UNKNOWN_GOAL
    await goal.stop()
    assert len(server.cancelled) == asked + 1
