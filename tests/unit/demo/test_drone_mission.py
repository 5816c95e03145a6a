"""The drone flies missions that the prompt alone gives, stepped without ROS: a few here, many in full."""

from __future__ import annotations

import ast
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.commands.prompted import PROMPTS, Followed, follow_mission
from ros2_mcp.prompts.folder import PromptFolder
from ros2_mcp.tools import TOOLS
from ros2_mcp_demo.drone import mission as plans
from ros2_mcp_demo.drone.autopilot import ACCEPTED
from ros2_mcp_demo.drone.simulation import DroneSimulation
from support.agent import FULL

DT = 0.02
MISSIONS = 100 if FULL else 6


class Stepped:
    """The tools that the prompt names, on a drone whose time passes only while something is waited for."""

    def __init__(self, seed: int) -> None:
        self.drone = DroneSimulation(seed)
        self.pilot = self.drone.autopilot
        self.highest = 0.0
        self.nearest = float("inf")
        self.target = (0.0, 0.0, 0.0)

    async def call(self, tool: str, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        if tool == "ros2_service_call":
            return self._serve(arguments["service_name"].removeprefix("/mavros/"), arguments["fields"])
        if tool == "ros2_wait_until":
            return self._wait(arguments)
        message = self._message(arguments["topic_name"])
        return {"messages": [message]} if tool == "ros2_topic_subscribe" else {"message": message}

    def _serve(self, service: str, fields: Mapping[str, Any]) -> Mapping[str, Any]:
        pilot = self.pilot
        if service == "set_mode":
            pilot.set_mode(fields["custom_mode"])
            return {"result": {"mode_sent": True}}
        if service == "mission/push":
            items = [
                plans.item_of(
                    each["command"],
                    each["frame"],
                    [each[f"param{number}"] for number in range(1, 5)],
                    each["x_lat"],
                    each["y_long"],
                    each["z_alt"],
                )
                for each in fields["waypoints"]
            ]
            taken = pilot.push(items) is None
            return {"result": {"success": taken, "wp_transfered": len(items)}, "note": str(pilot.texts[-1])}
        if service == "cmd/arming":
            result = pilot.arm(fields["value"])
        else:
            result = pilot.command(fields["command"], [fields[f"param{number}"] for number in range(1, 8)])
        return {"result": {"success": result == ACCEPTED}, "note": str(pilot.texts[-1])}

    def _message(self, topic: str) -> Mapping[str, Any]:
        if topic.endswith("/home"):
            return {"geo": {"latitude": plans.HOME_LATITUDE, "longitude": plans.HOME_LONGITUDE}}
        if topic.endswith("/rel_alt"):
            return {"data": self.pilot.altitude}
        return {
            "connected": True,
            "armed": self.pilot.armed,
            "mode": self.pilot.mode,
            "current_seq": self.pilot.current,
        }

    def _wait(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        for _ in range(round(arguments["timeout_s"] / DT)):
            if _holds(arguments["condition"], self._message(arguments["topic_name"])):
                return {"met": True}
            self.drone.step(DT)
            self.highest = max(self.highest, self.pilot.altitude)
            offset = self.drone.frame.position - self.target
            self.nearest = min(self.nearest, float((offset**2).sum() ** 0.5))
        return {"met": False, "values": self._message(arguments["topic_name"])}


def _holds(condition: str, message: Mapping[str, Any]) -> bool:
    """The few conditions of the prompt are Python's own, too."""
    return bool(eval(compile(ast.parse(condition, mode="eval"), "prompt", "eval"), {}, dict(message)))


async def fly(seed: int, x: float, y: float, z: float, back: bool, land: bool) -> tuple[Stepped, Followed]:
    folder = PromptFolder(Path(PROMPTS), print, tools=frozenset(tool.name for tool in TOOLS))
    prompt = next(prompt for prompt in folder.prompts() if prompt.name == "drone-mission")
    given = {"dest_x": x, "dest_y": y, "dest_z": z, "return_to_launch": back, "land_at_launch": land}
    messages = await prompt.messages({name: str(value).lower() for name, value in given.items()})
    stepped = Stepped(seed)
    stepped.target = (x, y, z)
    return stepped, await follow_mission(stepped.call, messages[0].text, dest_x=x, dest_y=y)


@pytest.mark.parametrize("seed", range(MISSIONS))
async def test_a_mission_is_flown_from_the_prompt_to_the_landing(seed: int) -> None:
    chosen = random.Random(seed)
    x, y, z = chosen.uniform(-40, 40), chosen.uniform(-40, 40), chosen.uniform(2, 25)
    stepped, followed = await fly(seed, x, y, z, back=chosen.random() < 0.5, land=True)
    assert followed.failed == ""
    assert stepped.nearest < 1.0
    assert z - 0.5 < stepped.highest < z + 1.0
    assert not stepped.pilot.armed
    assert stepped.drone.frame.is_on_ground
    assert float((stepped.drone.frame.position[:2] ** 2).sum() ** 0.5) < 1.0


async def test_without_return_and_landing_it_stays_at_the_point() -> None:
    stepped, followed = await fly(1, 12.0, 3.0, 6.0, back=False, land=False)
    assert followed.failed == ""
    assert stepped.pilot.armed
    assert stepped.nearest < 1.0


async def test_a_mission_above_the_ceiling_ends_at_the_push_and_says_why() -> None:
    stepped, followed = await fly(1, 5.0, 5.0, 110.0, back=True, land=True)
    assert "mission/push" in followed.failed
    assert "above the ceiling of 100 m" in followed.failed
    assert not stepped.pilot.armed
