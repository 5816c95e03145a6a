"""The robot's description (URDF): from a latched topic, or from a parameter of robot_state_publisher."""

from __future__ import annotations

import asyncio

from ros2_mcp.model import names, parameters
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.text import listed
from ros2_mcp.ops.nodes.own_services import ask_node
from ros2_mcp.robot import Robot
from ros2_mcp.robot.joints import DESCRIPTION, RobotJoints
from ros2_mcp.world.urdf import Urdf, parse

_PUBLISHER = "robot_state_publisher"
_ANSWER_S = 2.0
"""Time-out of a call: a node that spins answers within milliseconds."""


async def described(robot: Robot, topic: str = "") -> Urdf:
    """Return the parsed URDF of the robot: from the given topic, else from the only topic of that name, else from the
    parameter of a state publisher.

    Raises:
        NotFound: if no description is found.
        BadInput: if there are several topics and none is given.
        BadData: if the text is no valid URDF.
    """
    return parse(await description_text(robot, topic))


async def description_text(robot: Robot, topic: str = "") -> str:
    """Return the text of the robot's description; raises NotFound and BadInput as `described` does."""
    if not topic:
        found = await robot.kept.of(RobotJoints).description_topics()
        if len(found) > 1 and found[0] != f"/{DESCRIPTION}":
            raise BadInput(f"There are several robot descriptions: {listed(found, 6)}.", "Name one of them.")
        topic = found[0] if found else ""
    topic = names.absolute(topic) if topic else ""
    if topic and (text := await robot.kept.of(RobotJoints).description_on(topic)):
        return text
    if text := await _parameter(robot):
        return text
    heard = f"no message came on {topic}" if topic else f"{DESCRIPTION} has no publisher"
    raise await robot.graph.missing(
        f"No robot description (URDF): {heard}, and no {_PUBLISHER} has it as a parameter.",
        "Start robot_state_publisher with the URDF.",
    )


async def _parameter(robot: Robot) -> str:
    """Return the description held as a parameter by the first state publisher that has a description; empty if none
    has.
    """
    nodes = [row.name for row in await robot.graph.nodes() if row.name.rpartition("/")[2] == _PUBLISHER]
    found = await asyncio.gather(*(parameter_of(robot, node, DESCRIPTION) for node in nodes[:4]))
    return next((text for text in found if isinstance(text, str) and text), "")


async def parameter_of(robot: Robot, node: str, name: str) -> object:
    """Return the value of a node's parameter; None if the node has no such parameter or does not answer."""
    kind = "rcl_interfaces/srv/GetParameters"
    try:
        answer = await ask_node(robot, node, kind, {"names": [name]}, timeout_s=_ANSWER_S, wait_s=_ANSWER_S / 2)
        values = (await robot.fields_of(answer))["values"]
    except RobotError:
        return None
    return parameters.value_of(values[0]) if values else None
