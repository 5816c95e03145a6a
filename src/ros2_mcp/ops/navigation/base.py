"""Causes of a blocked base that no Nav2 server reports: other nodes that command the base, and speed limits of 0."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.nav2 import NAVIGATION_NODES
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.nodes.own_services import ask_node, parameter_values
from ros2_mcp.robot import Robot

_VELOCITIES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_LIST = "rcl_interfaces/srv/ListParameters"
_ANSWER_S = 1.0
"""A node that spins answers within milliseconds; a node that hangs must not delay an explanation."""
_MOST_NODES, _MOST_TOPICS, _MOST_NAMES = 6, 12, 40
_MOST_HEARD, _HEARD_S = 3, 0.6
"""A teleoperation node or a program publishes about ten velocities a second, so 0.6 s is enough. The number of topics
is bounded so that an explanation does not take longer with many inputs."""
_STAGES = 3
"""Stages from Nav2 to the wheels: smoother or collision monitor, multiplexer, driver."""
_FASTEST = re.compile(
    r"max\w*[._](lin|ang|vel|speed|v_|rot)|(vel|speed|velocity)\w*[._]max|desired_linear_vel|vx_max|wz_max"
)
"""Parameter names of maximum speeds in DWB, MPPI, Regulated Pure Pursuit, Nav2's velocity smoother, ros2_control's base
controllers and many drivers."""
_NO_LIMIT = re.compile(r"accel|decel|jerk|_y\b|\.y\b|\.y\.|vy_|lateral|(^|[._])min")
"""Parameter names that `_FASTEST` also matches but that are 0 on robots that can drive: other kinds of limits, and
limits of sideways motion, which most bases cannot perform."""


@dataclass(frozen=True, slots=True)
class Base:
    """Sentences about the base: `sends` on other nodes that publish velocities to the nodes Nav2 commands, `others` on
    nodes that might, `limits` on speed limits of 0."""

    sends: Sequence[str] = ()
    others: Sequence[str] = ()
    limits: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Other:
    """Nodes outside Nav2's chain that publish velocities on `topic`, to which `heard_by`, a node of the chain,
    subscribes. `is_own`: the chain itself does not publish on `topic`, so every message on it comes from `nodes`."""

    nodes: Sequence[str]
    topic: str
    heard_by: str
    is_own: bool

    def sentence(self, *, sends: bool) -> str:
        """Return the finding as a sentence. `sends`: messages were received on the topic; otherwise the sentence says
        "may send"."""
        beside = f"to which {named(self.heard_by)} listens beside Nav2" if self.is_own else "as Nav2 does"
        verb = ("sends" if len(self.nodes) == 1 else "send") if sends else "may send"
        return f"{listed(self.nodes, 3)} {verb} velocities on {named(self.topic)}, {beside}."


async def base_of(robot: Robot) -> Base:
    """Read which other nodes command the base, and which speed limits are 0. Parts that cannot be read are empty;
    raises no `RobotError`."""
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
    """Return the velocity topics from Nav2 to the base, and the nodes that publish or subscribe to them, Nav2's
    included."""
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
    """Find nodes outside the chain that publish velocities to a node of the chain."""
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
    """Return a sentence for each maximum speed among a node's parameters that is 0; none if the node does not
    answer."""
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
    told = await parameter_values(robot, node, [*asked, *unlimited], timeout_s=_ANSWER_S, wait_s=0.0)
    without = tuple(name.rpartition(".")[0] + "." for name in unlimited if told.get(name) is False)
    return [
        f"{named(node)} has the limit {named(name)} = {told[name]}."
        for name in asked
        if name in told and is_zero(told[name]) and not name.startswith(without or ("\0",))
    ]


def is_greatest_speed(name: str) -> bool:
    """Whether a parameter of this name limits the speed ahead or of turning."""
    return bool(_FASTEST.search(name)) and not _NO_LIMIT.search(name)


def is_zero(value: object) -> bool:
    """Whether a maximum speed is 0; of a list with one value per axis, the first counts (ahead)."""
    if isinstance(value, (list, tuple)):
        several = cast("Sequence[object]", value)
        return bool(several) and is_zero(several[0])
    return not isinstance(value, bool) and isinstance(value, (int, float)) and math.isclose(value, 0.0, abs_tol=1e-9)
