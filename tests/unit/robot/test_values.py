"""Types that are not installed where the bridge runs."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any, cast

import pytest

from ros2_mcp.link.client import Bridge, Reply
from ros2_mcp.robot import Robot
from support.noting_bridge import TWIST, Noting

pytestmark = pytest.mark.anyio
TF = "tf2_msgs/msg/TFMessage"
OTHERS = ["made_msgs/msg/One", "made_msgs/msg/Two"]


class Lacking(Noting):
    """Of an installation without some packages."""

    async def request(self, op: str, _body: bytes = b"", *, timeout_s: float, **arguments: Any) -> Reply:
        if op == "definitions" and (missing := [name for name in arguments["types"] if name in (TF, *OTHERS)]):
            return Reply({"missing": missing, "definitions": {}}, b"")
        if op == "interfaces":
            return Reply({"interfaces": [TWIST]}, b"")
        return await super().request(op, _body, timeout_s=timeout_s, **arguments)


@pytest.fixture
async def robot() -> AsyncGenerator[Robot, None]:
    robot = Robot(cast(Bridge, Lacking()))
    yield robot
    await robot.jobs.close()


async def test_where_fields_are_missing_the_note_says_why_and_what_cures_it(robot: Robot) -> None:
    fields, note = await robot.values.fields_of([TWIST, TF])
    assert (list(fields[TWIST]), fields[TF]) == (["linear", "angular"], {})
    assert note.startswith(f"Fields are missing: No definition of {TF} is installed where the bridge runs")
    assert "With ROS 2 from wheels run: ros2-mcp interfaces build /" in note
    assert "/ros2_mcp_demo/interfaces/tf2_msgs; with any other, install it or source its workspace" in note


async def test_further_types_without_a_definition_are_named(robot: Robot) -> None:
    _, note = await robot.values.fields_of(OTHERS)
    assert f"No definition of {OTHERS[0]}" in note and note.endswith(f"Also unknown: {OTHERS[1]}.")


async def test_where_no_field_is_missing_there_is_no_note(robot: Robot) -> None:
    assert await robot.values.fields_of([TWIST]) == ({TWIST: robot.values.field_types(TWIST)}, "")
