"""Several robots put together, without any of them: what a client sees, and that none waits for another."""

from __future__ import annotations

import json
import math
from collections.abc import AsyncGenerator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest
from mcp import Client

from ros2_mcp.compose.server import Assembly, assemble
from ros2_mcp.link.client import Bridge
from ros2_mcp.mcp.fleet import Member, about_all
from ros2_mcp.mcp.leases import Leases
from ros2_mcp.model.address import parse_address
from ros2_mcp.model.commands import Principal
from ros2_mcp.ops.stop import stop as stopping
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from support.noting_bridge import Noting
from support.structured import META

CLIENT = Principal(name="http_1", transport="http")


def several(*names: str, **more: Any) -> Assembly:
    robots = tuple(parse_address(f"{name}=local?domain_id={number}") for number, name in enumerate(names, start=1))
    return assemble(Settings(robots=robots, distro="foxy", ros_root=Path("/nowhere"), **more))


def test_one_robot_is_served_as_ever_whether_it_has_a_name_or_not() -> None:
    alone = [tool.model_dump() for tool in assemble(Settings(tools=("all",))).fleet.listed]
    named = assemble(Settings(tools=("all",), robots=(parse_address("lab=local"),)))
    assert [tool.model_dump() for tool in named.fleet.listed] == alone
    assert named.server.instructions == assemble(Settings(tools=("all",))).server.instructions


def test_beyond_fifteen_robots_the_names_are_no_longer_in_every_tool() -> None:
    few, many = (several(*(f"robot{number}" for number in range(most))) for most in (15, 16))
    argument = [fleet.fleet.input_schema("ros2_topic_list")["properties"]["robot"] for fleet in (few, many)]  # type: ignore[index]
    assert (len(argument[0]["enum"]), "enum" in argument[1]) == (15, False)
    assert "ros2_robots" in argument[1]["description"]


def test_a_second_robot_costs_little_in_the_list_of_tools() -> None:
    def taken(assembly: Assembly) -> int:
        return sum(len(json.dumps(tool.input_schema, separators=(",", ":"))) for tool in assembly.fleet.listed)

    two = several("lab", "yard")
    assert taken(two) - taken(assemble(Settings())) <= 70 * len(two.fleet.listed)


async def test_the_instructions_name_the_robots_and_those_under_a_policy(tmp_path: Path) -> None:
    file = tmp_path / "robots.yaml"
    entries = {"lab": {"at": "local?domain_id=1"}, "yard": {"at": "local?domain_id=2", "policy": "teleop-slow"}}
    file.write_text(json.dumps({"robots": entries}))
    said = assemble(Settings(robots_file=file)).server.instructions or ""
    assert "This server has 2 robots: lab, yard." in said
    assert "Robots under a policy: yard." in said and "A policy is in force" in said


async def test_robots_that_cannot_be_reached_are_shown_with_the_reason_and_a_stop_does_not_look_for_them() -> None:
    assembly = several("lab", "yard")
    async with assembly.running(), Client(assembly.server) as client:
        stopped = (await client.call_tool("ros2_stop", {}, meta=META)).structured_content or {}
        assert [one["robot"] for one in stopped["robots"]] == ["lab", "yard"]
        assert not stopped["confirmed"] and "has never reached it" in stopped["robots"][0]["stopped"]["note"]
        assert all(member.robot._bridge.generation == 0 for member in assembly.fleet.members.values())
        shown = (await client.call_tool("ros2_robots", {}, meta=META)).structured_content or {}
        assert [(robot["robot"], robot["state"]) for robot in shown["robots"]] == [("lab", "away"), ("yard", "away")]
        assert "foxy" in shown["robots"][0]["note"]
        refused = await client.call_tool("ros2_topic_list", {"robot": "yard"})
        assert refused.is_error and refused.content[0].text.startswith("Robot yard: RosNotFound: ")  # type: ignore[union-attr]


async def test_prompts_ask_which_robot_and_name_it_in_every_step() -> None:
    assembly = several("lab", "yard")
    async with Client(assembly.server) as client:
        listed = {prompt.name: prompt for prompt in (await client.list_prompts()).prompts}
        first = (listed["base.ros2-node-health-check"].arguments or [])[0]
        assert (first.name, first.required) == ("robot", True)
        got = await client.get_prompt("base.ros2-node-health-check", {"robot": "yard", "check_rates": "false"})
        text = got.messages[0].content.text  # type: ignore[union-attr]
        assert text.startswith('This is about the robot yard: pass "robot": "yard" to each tool.')
        assert '1. Call ros2_health_check with {"robot": "yard", "check_rates": false' in text
        relay = {"robot": "lab", "source_topic": "/a", "destination_topic": "/b"}
        text = (await client.get_prompt("base.ros2-topic-relay", relay)).messages[0].content.text  # type: ignore[union-attr]
        assert '3. Call ros2_relay_list with {"robot": "lab"}' in text
        for given, problem in (({}, "needs the argument robot: lab, yard"), ({"robot": "up"}, "one of lab, yard")):
            with pytest.raises(Exception, match=problem):
                await client.get_prompt("base.ros2-node-health-check", given)


async def test_the_name_of_a_robot_is_completed() -> None:
    assembly = several("lab", "yard")
    async with Client(assembly.server) as client:
        from mcp.types import PromptReference, ResourceTemplateReference

        prompt = PromptReference(type="ref/prompt", name="base.ros2-node-health-check")
        template = ResourceTemplateReference(type="ref/resource", uri="ros2://topic/{+name}{?robot}")
        for reference in (prompt, template):
            found = await client.complete(reference, {"name": "robot", "value": "ya"})
            assert found.completion.values == ["yard"]


@pytest.mark.parametrize("silent_s", [2.4, math.inf])
async def test_a_robot_that_is_out_of_reach_does_not_hold_up_the_answer_of_its_stop_which_goes_on(
    silent_s: float,
) -> None:
    """The only one of its server, and one of several that is named."""
    noting = Noting()
    noting.may_answer = anyio.Event()  # type: ignore[assignment]
    noting.is_remote, noting.nodes, noting.silent_s, noting.unheard_s = True, {"/bridge"}, silent_s, 2.4
    robot = Robot(cast(Bridge, noting))
    member = SimpleNamespace(name="lab", robot=robot)
    with anyio.fail_after(stopping._BRIDGE_S):  # after which it would have been given up
        alone = await stopping.stop_in_reach(robot)
        several = await about_all.stop([cast(Member, member)], "local")
    assert not alone.confirmed and "no data from it for 2.4 s" in alone.summary()
    assert [one.stopped.note for one in several.robots] == [alone.note] and not several.confirmed
    assert robot.stops.epoch == 2
    noting.may_answer.set()
    while stopping._going_on:
        await anyio.sleep(0.01)
    assert noting.sent.count("stop") == 2


async def test_a_robot_that_was_just_heard_of_is_waited_for() -> None:
    noting = Noting()
    noting.is_remote, noting.nodes = True, {"/bridge"}
    assert "in the background" not in (await stopping.stop_in_reach(Robot(cast(Bridge, noting)))).note


def test_the_robot_that_a_call_names_is_known_before_it_is_bound() -> None:
    fleet = several("lab", "yard").fleet
    named = [fleet.named_in(given) for given in ({"robot": "lab"}, {"robot": "up"}, {"robot": []}, {})]
    assert named == ["lab", "", "", ""]
    assert several("lab").fleet.named_in({"robot": "lab"}) == ""


@pytest.fixture
async def two() -> AsyncGenerator[tuple[Robot, Robot], None]:
    robots = Robot(cast(Bridge, Noting())), Robot(cast(Bridge, Noting()))
    yield robots
    for robot in robots:
        await robot.jobs.close()
        robot.failsafes.close()


async def test_a_client_that_goes_is_ended_on_one_robot_however_long_another_one_takes(
    two: tuple[Robot, Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of a client on a robot that is away takes its time: it may come and go again meanwhile."""
    away, present = two
    ended, released = list[str](), anyio.Event()

    async def waits(principal: Principal, reason: str = "") -> list[str]:
        await released.wait()
        return []

    async def notes(principal: Principal, reason: str = "") -> list[str]:
        ended.append(reason)
        return []

    monkeypatch.setattr(away, "stop_owned", waits)
    monkeypatch.setattr(present, "stop_owned", notes)
    leases = Leases(away, present)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(leases.keep)
        await anyio.lowlevel.checkpoint()
        with anyio.fail_after(5):  # it takes no time; this is for a fault
            for times in (1, 2):
                leases.asked(CLIENT)
                leases.left(CLIENT)
                while len(ended) < times:
                    await anyio.lowlevel.checkpoint()
        released.set()
        tasks.cancel_scope.cancel()
