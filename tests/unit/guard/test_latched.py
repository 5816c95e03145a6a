"""After a stop that latches nothing acts, on any server of the robot, until an operator resets it."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable
from pathlib import Path
from typing import cast

import pytest

from ros2_mcp.compose.robot import robot_for, store_for
from ros2_mcp.guard.chain import entries
from ros2_mcp.guard.consent import Auditing
from ros2_mcp.guard.guard import Guard
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.state import ServerLock, StateFolder, state_of
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import CancelGoals, Record
from ros2_mcp.model.errors import Latched
from ros2_mcp.ops.stop.stop import stop
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from ros2_mcp_common.policy.rules import Rules, RuleSet
from support.noting_bridge import EVERY, Noting

ACTING = [command for command in EVERY if not isinstance(command, CancelGoals | Record)]
CALLS = 1000
SENDING = {"publish", "repeat", "move", "relay", "relay_feed", "call"}
ANYTHING = Policy(rules=Rules("digest", (RuleSet("all", allows_all=True),)))
MakeServer = Callable[..., Robot]


@pytest.fixture
async def server(tmp_path: Path) -> AsyncGenerator[MakeServer, None]:
    """Make a server of the one robot, with its bridge."""
    folder, robots = StateFolder(tmp_path / "robot"), list[Robot]()

    def make(policy: Policy | None = None) -> Robot:
        guard = Guard(policy, latch=folder.latch(), server_lock=ServerLock(folder))
        robots.append(Robot(cast(Bridge, Noting()), guard))
        return robots[-1]

    yield make
    for robot in robots:
        await robot.jobs.close()
        robot.failsafes.close()
        robot.guard.server_lock.close()


def sent(robot: Robot) -> set[str]:
    return SENDING & set(cast(Noting, robot._bridge).sent)


@pytest.mark.promise("stopping", "nothing acts on the robot any more, on any server, until an operator resets it")
async def test_after_a_persons_stop_a_thousand_acting_calls_are_refused_by_every_server(server: MakeServer) -> None:
    first, second = server(), server()
    stopped = await stop(first, by="operator ann")
    assert stopped.latched and "The latch is set" in stopped.note
    for number in range(CALLS):
        robot = server() if number % 100 == 0 else (first, second)[number % 2]  # and one that was just started
        with pytest.raises(Latched, match=r"by «operator ann»: «a person stopped the robot».*Nothing was sent"):
            await robot.do(ACTING[number % len(ACTING)])
        assert sent(robot) == set()


async def test_who_ends_something_and_who_records_is_not_held(server: MakeServer) -> None:
    robot = server()
    await stop(robot, by="operator ann")
    for command in EVERY:
        if command not in ACTING:
            await robot.do(command)
    assert sent(robot) == {"call"}


@pytest.mark.promise("stopping", "a reset starts nothing")
async def test_a_reset_lets_act_again_and_begins_nothing(server: MakeServer) -> None:
    robot, other = server(), server()
    await stop(robot, by="operator ann")
    robot.guard.latch.reset(by="operator ann", seen=robot.guard.latch.look().count)
    assert sent(robot) == sent(other) == set()
    for one in (robot, other):
        await one.do(ACTING[0])
        assert sent(one) == {"publish"}


async def test_an_agents_stop_latches_under_a_policy_only(server: MakeServer) -> None:
    robot = server()
    assert not (await stop(robot)).latched
    await robot.do(ACTING[0])
    robot = server(ANYTHING)
    stopped = await stop(robot)
    assert stopped.latched and "Only an operator can reset it" in stopped.note
    with pytest.raises(Latched):
        await robot.do(ACTING[0])


async def test_a_latch_that_cannot_be_written_holds_in_this_server_and_the_stop_says_so(
    server: MakeServer, tmp_path: Path
) -> None:
    robot = server()
    (tmp_path / "robot").write_text("a file where the folder should be")
    stopped = await stop(robot, by="operator ann")
    assert "The latch could not be saved" in stopped.note and not stopped.confirmed
    with pytest.raises(Latched):
        await robot.do(ACTING[0])


def test_each_latch_is_written_down_once_however_many_bridges_tell_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    settings = Settings(domain_id=77)
    folder = state_of(settings, Policy())
    folder.make()
    latch = folder.latch()
    latch.set(by="watchdog", reason="before this server began")
    bridge = Bridge(lambda: pytest.fail("nothing is started"))
    robot = robot_for(settings, store_for(settings), bridge)
    bridge.on_latched("watchdog", "before this server began", False)
    latch.reset(by="operator", seen=latch.look().count)
    latch.set(by="stopper", reason="the bridge was silent")
    for _ in range(3):
        bridge.on_latched("stopper", "the bridge was silent", False)
    cast(Auditing, robot.guard.audit).log.close()
    assert [entry["by"] for entry in entries(folder.path / "audit") if entry["kind"] == "latched"] == ["stopper"]
