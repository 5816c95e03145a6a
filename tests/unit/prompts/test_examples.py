"""The example prompts: without mistakes, and their calls fit the definitions of what they call."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jsonschema
import pytest
from generate import served_tools

from ros2_mcp.codec.check import check
from ros2_mcp.codec.definitions import Definitions, DefinitionText
from ros2_mcp.prompts.folder import PromptFolder
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.tools import TOOLS
from support.prompt_steps import steps_of

EXAMPLES = Path(__file__).parents[3] / "examples/prompts"
MAVROS = {
    "mavros_msgs/msg/Waypoint": "uint8 frame\nuint16 command\nbool is_current\nbool autocontinue\nfloat32 param1\n"
    "float32 param2\nfloat32 param3\nfloat32 param4\nfloat64 x_lat\nfloat64 y_long\nfloat64 z_alt\n",
    "mavros_msgs/srv/WaypointPush": "uint16 start_index\nWaypoint[] waypoints\n---\nbool success\n",
    "mavros_msgs/srv/CommandBool": "bool value\n---\nbool success\nuint8 result\n",
    "mavros_msgs/srv/SetMode": "uint8 base_mode\nstring custom_mode\n---\nbool mode_sent\n",
}
HOME = {"HOME_LAT": 47.4, "HOME_LON": 8.5, "DEST_LAT": 47.4001, "DEST_LON": 8.5002}


async def fetched(**given: str) -> list[tuple[str, dict[str, Any]]]:
    told: list[Mistake] = []
    folder = PromptFolder(EXAMPLES, told.append, tools=frozenset(tool.name for tool in TOOLS))
    mission = next(prompt for prompt in folder.prompts() if prompt.name == "drone-mission")
    assert told == []
    messages = await mission.messages({"dest_x": "20", "dest_y": "-10.5", "dest_z": "15", **given})
    return steps_of(messages[0].text, **HOME)


async def calls(**given: str) -> dict[str, dict[str, Any]]:
    return {step["service_name"]: step for tool, step in await fetched(**given) if tool == "ros2_service_call"}


async def test_every_call_of_the_mission_is_one_that_the_tool_accepts() -> None:
    schemas = {tool.name: tool.input_schema for tool in served_tools()}
    for tool, arguments in await fetched():
        jsonschema.validate(arguments, schemas[tool])


async def test_every_request_of_the_mission_fits_its_definition() -> None:
    definitions = Definitions()
    definitions.add({name: DefinitionText(name.split("/")[1], text) for name, text in MAVROS.items()})
    for call in (await calls()).values():
        check(definitions, f"{call['service_type']}_Request", call["fields"], partial=False)


async def test_the_mission_is_pushed_before_the_motors_are_armed_and_the_mode_is_set_last() -> None:
    assert list(await calls()) == ["/mavros/mission/push", "/mavros/cmd/arming", "/mavros/set_mode"]
    assert (await calls())["/mavros/set_mode"]["fields"] == {"base_mode": 0, "custom_mode": "AUTO"}


@pytest.mark.parametrize(
    ("back", "land", "commands"),
    [
        ("true", "true", [16, 22, 16, 16, 21]),
        ("true", "false", [16, 22, 16, 16]),
        ("false", "true", [16, 22, 16, 21]),
        ("false", "false", [16, 22, 16]),
    ],
)
async def test_the_waypoints_follow_the_flags(back: str, land: str, commands: list[int]) -> None:
    waypoints = (await calls(return_to_launch=back, land_at_launch=land))["/mavros/mission/push"]["fields"]["waypoints"]
    assert [waypoint["command"] for waypoint in waypoints] == commands
    assert {waypoint["frame"] for waypoint in waypoints} == {3}
    assert [waypoint["z_alt"] for waypoint in waypoints[:3]] == [0, 15, 15]
    assert (waypoints[2]["x_lat"], waypoints[2]["y_long"]) == (HOME["DEST_LAT"], HOME["DEST_LON"])
