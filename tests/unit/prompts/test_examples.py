"""The example prompts: without mistakes, and their calls fit the definitions of what they call."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jsonschema
import pytest
from generate import served_tools

from ros2_mcp.ops.measure.expression import condition
from ros2_mcp.prompts.folder import PromptFolder
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.tools import TOOLS
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions, DefinitionText
from support.prompt_steps import steps_of

EXAMPLES = Path(__file__).parents[3] / "src/ros2_mcp_demo/prompts"
MAVROS = {
    "mavros_msgs/msg/Waypoint": "uint8 frame\nuint16 command\nbool is_current\nbool autocontinue\nfloat32 param1\n"
    "float32 param2\nfloat32 param3\nfloat32 param4\nfloat64 x_lat\nfloat64 y_long\nfloat64 z_alt\n",
    "mavros_msgs/srv/WaypointPush": "uint16 start_index\nWaypoint[] waypoints\n---\nbool success\n",
    "mavros_msgs/srv/CommandBool": "bool value\n---\nbool success\nuint8 result\n",
    "mavros_msgs/srv/CommandLong": "bool broadcast\nuint16 command\nuint8 confirmation\n"
    + "".join(f"float32 param{number}\n" for number in range(1, 8))
    + "---\nbool success\nuint8 result\n",
    "mavros_msgs/msg/State": "bool connected\nbool armed\nbool guided\nstring mode\nuint8 system_status\n",
    "mavros_msgs/msg/WaypointList": "uint16 current_seq\nWaypoint[] waypoints\n",
    "mavros_msgs/srv/SetMode": "uint8 base_mode\nstring custom_mode\n---\nbool mode_sent\n",
}
TOPICS = {
    "/mavros/state": "mavros_msgs/msg/State",
    "/mavros/mission/waypoints": "mavros_msgs/msg/WaypointList",
}
HOME = {"HOME_LAT": 47.4, "HOME_LON": 8.5, "DEST_LAT": 47.4001, "DEST_LON": 8.5002}


async def fetched(**given: str) -> list[tuple[str, dict[str, Any]]]:
    told: list[Mistake] = []
    folder = PromptFolder(EXAMPLES, told.append, tools=frozenset(tool.name for tool in TOOLS))
    mission = next(prompt for prompt in folder.prompts() if prompt.name == "drone-mission")
    assert told == []
    messages = await mission.messages({"dest_x": "20", "dest_y": "-10.5", "dest_z": "15", **given})
    return steps_of(messages[0].text, **HOME)


async def calls(**given: str) -> list[tuple[str, dict[str, Any]]]:
    """Service and request of each service call, in order."""
    return [(step["service_name"], step) for tool, step in await fetched(**given) if tool == "ros2_service_call"]


async def waypoints_of(**given: str) -> list[dict[str, Any]]:
    return dict(await calls(**given))["/mavros/mission/push"]["fields"]["waypoints"]


def known() -> Definitions:
    definitions = Definitions()
    definitions.add({name: DefinitionText(name.split("/")[1], text) for name, text in MAVROS.items()})
    return definitions


async def test_every_call_of_the_mission_is_one_that_the_tool_accepts() -> None:
    schemas = {tool.name: tool.input_schema for tool in served_tools()}
    for tool, arguments in await fetched():
        jsonschema.validate(arguments, schemas[tool])


async def test_every_request_of_the_mission_fits_its_definition() -> None:
    for _, call in await calls():
        check(known(), f"{call['service_type']}_Request", call["fields"], partial=False)


async def test_every_condition_of_the_mission_fits_its_topic() -> None:
    waits = [arguments for tool, arguments in await fetched() if tool == "ros2_wait_until"]
    assert len(waits) == 5
    for wait in waits:
        condition(known(), TOPICS[wait["topic_name"]], wait["condition"])


class Copter:
    """What ArduCopter on the ground does with what MAVROS passes on, as far as a take-off depends on it.

    As in its sources: `mode_auto.cpp`, `handle_MAV_CMD_MISSION_START`.
    """

    def __init__(self) -> None:
        self.mode, self.armed, self.flies, self.mission = "STABILIZE", False, False, list[dict[str, Any]]()

    def serve(self, service: str, fields: dict[str, Any]) -> bool:
        return getattr(self, "_" + service.rpartition("/")[2])(**fields)

    def _push(self, start_index: int, waypoints: list[dict[str, Any]]) -> bool:
        self.mission = waypoints[start_index:]
        return True

    def _set_mode(self, base_mode: int, custom_mode: str) -> bool:
        if custom_mode == "AUTO" and self.armed and self.mission[1]["command"] != 22:
            return False  # "Auto: Missing Takeoff Cmd"; the item before it is home
        self.mode = custom_mode
        return base_mode == 0

    def _arming(self, value: bool) -> bool:
        if self.mode == "AUTO":  # unless AUTO_OPTIONS allows it
            return False
        self.armed = value
        return True

    def _command(self, command: int, param1: float, param2: float, **_: Any) -> bool:
        if command != 300 or param1 or param2 or not (self.armed and self._set_mode(0, "AUTO")):
            return False
        self.flies = True  # only now: AUTO alone waits for the throttle stick, and the drone disarms
        return True


async def test_the_mission_takes_off() -> None:
    copter = Copter()
    for service, call in await calls():
        assert copter.serve(service, call["fields"]), service
    assert copter.flies and copter.mode == "AUTO"


async def test_the_take_off_is_waited_for_once_the_mission_has_begun() -> None:
    steps = [arguments for _, arguments in await fetched()]
    began = next(index for index, step in enumerate(steps) if step.get("service_name") == "/mavros/cmd/command")
    wait = {"topic_name": "/mavros/mission/waypoints", "condition": "current_seq >= 2", "timeout_s": 120}
    assert wait in steps[began:]


async def test_the_mission_is_pushed_before_the_motors_are_armed_and_started_right_after() -> None:
    services = [service.removeprefix("/mavros/") for service, _ in await calls()]
    assert services == ["mission/push", "set_mode", "cmd/arming", "cmd/command", "set_mode"]
    assert (await calls())[-1][1]["fields"] == {"base_mode": 0, "custom_mode": "AUTO"}


@pytest.mark.parametrize(
    ("back", "land", "commands"),
    [
        ("true", "true", [16, 22, 16, 19, 16, 21]),
        ("true", "false", [16, 22, 16, 19, 16]),
        ("false", "true", [16, 22, 16, 19, 21]),
        ("false", "false", [16, 22, 16, 19]),
    ],
)
async def test_the_waypoints_follow_the_flags(back: str, land: str, commands: list[int]) -> None:
    waypoints = await waypoints_of(return_to_launch=back, land_at_launch=land)
    assert [waypoint["command"] for waypoint in waypoints] == commands
    assert {waypoint["frame"] for waypoint in waypoints} == {3}
    assert [waypoint["z_alt"] for waypoint in waypoints[:3]] == [0, 15, 15]
    assert (waypoints[2]["x_lat"], waypoints[2]["y_long"]) == (HOME["DEST_LAT"], HOME["DEST_LON"])
