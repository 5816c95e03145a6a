"""What stands in Nav2's way where none of its servers says so: who else commands the base, and limits that are 0."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.model import parameters
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.nav2 import NAVIGATION_NODES
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.nodes.own_services import ask_node
from ros2_mcp.robot import Robot

_VELOCITIES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_LIST, _GET = "rcl_interfaces/srv/ListParameters", "rcl_interfaces/srv/GetParameters"
_ANSWER_S = 1.0
"""A node that spins answers within milliseconds; one that hangs is not to hold up an explanation."""
_MOST_NODES, _MOST_TOPICS, _MOST_NAMES = 6, 12, 40
_MOST_HEARD, _HEARD_S = 3, 0.6
"""Who drives by hand or by a program sends ten velocities a second; of more inputs an explanation is not longer."""
_STAGES = 3
"""From Nav2 to the wheels: a smoother or collision monitor, a multiplexer, the driver."""
_FASTEST = re.compile(
    r"max\w*[._](lin|ang|vel|speed|v_|rot)|(vel|speed|velocity)\w*[._]max|desired_linear_vel|vx_max|wz_max"
)
"""As DWB, MPPI, Regulated Pure Pursuit, Nav2's velocity smoother, ros2_control's base and many drivers call them."""
_NO_LIMIT = re.compile(r"accel|decel|jerk|_y\b|\.y\b|\.y\.|vy_|lateral|(^|[._])min")
"""Names of parameters that are 0 on robots that drive: other kinds of limits, and sideways, which most bases cannot."""


@dataclass(frozen=True, slots=True)
class Base:
    """Sentences: `sends` on who else does send velocities to what Nav2 drives by, `others` on who may, and `limits` on
    what holds it at 0."""

    sends: Sequence[str] = ()
    others: Sequence[str] = ()
    limits: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Other:
    """Nodes that publish velocities for a node of the chain, and are none of it; `is_own` where nobody else does so on
    that topic, so that what comes there is theirs."""

    nodes: Sequence[str]
    topic: str
    heard_by: str
    is_own: bool

    def sentence(self, *, sends: bool) -> str:
        """In words; that it sends was heard, else it only may."""
        beside = f"to which {named(self.heard_by)} listens beside Nav2" if self.is_own else "as Nav2 does"
        verb = ("sends" if len(self.nodes) == 1 else "send") if sends else "may send"
        return f"{listed(self.nodes, 3)} {verb} velocities on {named(self.topic)}, {beside}."


async def base_of(robot: Robot) -> Base:
    """What is known of it now; what cannot be had is left out. Raises no `RobotError`."""
    try:
        rows = [row.name for row in await robot.graph.topics() if not set(_VELOCITIES).isdisjoint(row.types)]
        present = await asyncio.gather(*map(robot.graph.endpoints, rows[:_MOST_TOPICS]))
        nodes = [row.name for row in await robot.graph.nodes()]
    except RobotError:
        return Base()
    topics, chain = chain_of(present)
    servers = [name for name in nodes if name.rpartition("/")[2] in ("controller_server", "velocity_smoother")]
    asked = [*sorted(chain - set(servers)), *servers] if topics else servers
    others = others_of(present, topics, chain)
    checked = [other for other in others if other.is_own][:_MOST_HEARD]
    heard, found = await asyncio.gather(
        asyncio.gather(*(_hears(robot, other.topic) for other in checked)),
        asyncio.gather(*(zero_limits(robot, node) for node in asked[:_MOST_NODES])),
    )
    sending = [other for other, comes in zip(checked, heard, strict=True) if comes]
    return Base(
        [other.sentence(sends=True) for other in sending],
        [other.sentence(sends=False) for other in others if other not in sending],
        [line for lines in found for line in lines],
    )


def chain_of(present: Sequence[TopicEndpoints]) -> tuple[set[str], set[str]]:
    """The velocity topics from Nav2 to the base, and the nodes that pass them on or follow them, Nav2's among them."""
    chain = {one.node for topic in present for one in topic.publishers if _is_of_nav2(one.node)}
    if not chain:
        return set(), set()
    topics = set[str]()
    for _ in range(_STAGES):
        topics |= {topic.topic for topic in present if any(one.node in chain for one in topic.publishers)}
        chain |= {
            one.node for topic in present if topic.topic in topics for one in topic.subscribers if not one.ours
        }  # fmt: skip
    return topics, chain


def others_of(present: Sequence[TopicEndpoints], topics: set[str], chain: set[str]) -> list[Other]:
    """Who publishes velocities for a node of the chain and is none of it."""
    found: list[Other] = []
    for topic in present:
        heard_by = sorted({one.node for one in topic.subscribers if one.node in chain})
        others = sorted({one.node for one in topic.publishers if one.node not in chain and not one.ours})
        if others and heard_by:
            found.append(Other(others, topic.topic, heard_by[0], topic.topic not in topics))
    return found


def _is_of_nav2(node: str) -> bool:
    return node.rpartition("/")[2] in NAVIGATION_NODES


async def _hears(robot: Robot, topic: str) -> bool:
    with suppress(RobotError):
        async with robot.listen(topic, keep="latest", head_bytes=16) as listening:
            return bool(await listening.take(_HEARD_S))
    return False


async def zero_limits(robot: Robot, node: str) -> list[str]:
    """The greatest speeds among a node's parameters that are 0."""
    with suppress(RobotError, asyncio.TimeoutError):
        return await asyncio.wait_for(_asked_limits(robot, node), _ANSWER_S)
    return []


async def _asked_limits(robot: Robot, node: str) -> list[str]:
    request: Mapping[str, Any] = {"prefixes": [], "depth": 0}
    answer = await ask_node(robot, node, _LIST, request, timeout_s=_ANSWER_S, wait_s=0.0)
    known: Sequence[str] = (await robot.fields_of(answer))["result"]["names"]
    asked = [name for name in sorted(known) if is_greatest_speed(name)][:_MOST_NAMES]
    if not asked:
        return []
    unlimited = [name for name in known if name.endswith(".has_velocity_limits")]
    answer = await ask_node(robot, node, _GET, {"names": [*asked, *unlimited]}, timeout_s=_ANSWER_S, wait_s=0.0)
    values = [parameters.value_of(value) for value in (await robot.fields_of(answer))["values"]]
    told = dict(zip([*asked, *unlimited], values, strict=False))
    without = tuple(name.rpartition(".")[0] + "." for name in unlimited if told.get(name) is False)
    return [
        f"{named(node)} has the limit {named(name)} = {told[name]}."
        for name in asked
        if name in told and is_zero(told[name]) and not name.startswith(without or ("\0",))
    ]


def is_greatest_speed(name: str) -> bool:
    """Whether a parameter of that name is how fast something may go ahead or turn."""
    return bool(_FASTEST.search(name)) and not _NO_LIMIT.search(name)


def is_zero(value: object) -> bool:
    """Whether a greatest speed, or of several axes the first, which is ahead, is 0."""
    if isinstance(value, (list, tuple)):
        several = cast("Sequence[object]", value)
        return bool(several) and is_zero(several[0])
    return not isinstance(value, bool) and isinstance(value, (int, float)) and math.isclose(value, 0.0, abs_tol=1e-9)
