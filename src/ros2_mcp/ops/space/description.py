"""The robot's description as it gives it: on a latched topic, or as a parameter of its state publisher."""

from __future__ import annotations

import asyncio

from ros2_mcp.model import names, parameters
from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.text import listed
from ros2_mcp.ops.nodes.own_services import ask_node
from ros2_mcp.robot import Robot
from ros2_mcp.world.urdf import Urdf, parse

_NAME, _TYPE = "robot_description", "std_msgs/msg/String"
_PUBLISHER = "robot_state_publisher"
_FIRST_S = 4.0
"""A latched message comes with the matching; a publisher that missed our announcement is discovered 3 s later."""
_ANSWER_S = 2.0
"""A node that spins answers within milliseconds."""
_MOST_BYTES = 16_000_000
"""One description with meshes inside; `codec.urdf` reads less."""


async def described(robot: Robot, topic: str = "") -> Urdf:
    """The URDF of the robot: that of the given topic, else of the only topic of that name, else of the parameter.

    Raises:
        NotFound: if none is there.
        BadInput: if there are several and none is given.
        BadData: if what is there is no URDF.
    """
    return parse(await description_text(robot, topic))


async def description_text(robot: Robot, topic: str = "") -> str:
    """The text of it; raises as `described`."""
    if not topic:
        rows = [row for row in await robot.graph.topics() if row.publishers and _TYPE in row.types]
        found = sorted(row.name for row in rows if row.name.rpartition("/")[2] == _NAME)
        if len(found) > 1 and f"/{_NAME}" not in found:
            raise BadInput(f"There are several robot descriptions: {listed(found, 6)}.", "Name one of them.")
        topic = (f"/{_NAME}" if f"/{_NAME}" in found else found[0]) if found else ""
    if topic:
        topic = names.absolute(topic)
        async with robot.listen(topic, _TYPE, keep="latest", max_bytes=_MOST_BYTES) as listening:
            if samples := await listening.take(_FIRST_S):
                return str((await robot.values.in_full(_TYPE, samples[-1].data))["data"])
    if text := await _parameter(robot):
        return text
    heard = f"no message came on {topic}" if topic else f"nobody publishes {_NAME}"
    raise NotFound(
        f"No robot description (URDF): {heard}, and no {_PUBLISHER} has it as a parameter.",
        "Start robot_state_publisher with the URDF.",
    )


async def _parameter(robot: Robot) -> str:
    """What the first state publisher has as its parameter; empty where there is none."""
    nodes = [row.name for row in await robot.graph.nodes() if row.name.rpartition("/")[2] == _PUBLISHER]
    found = await asyncio.gather(*(parameter_of(robot, node, _NAME) for node in nodes[:4]))
    return next((text for text in found if isinstance(text, str) and text), "")


async def parameter_of(robot: Robot, node: str, name: str) -> object:
    """One parameter of a node; None where it has none, or does not answer."""
    kind = "rcl_interfaces/srv/GetParameters"
    try:
        answer = await ask_node(robot, node, kind, {"names": [name]}, timeout_s=_ANSWER_S, wait_s=_ANSWER_S / 2)
        values = (await robot.fields_of(answer))["values"]
    except RobotError:
        return None
    return parameters.value_of(values[0]) if values else None
