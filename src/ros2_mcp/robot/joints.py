"""The measured states of the robot's joints, and the limits in its description (URDF)."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import asdict
from time import monotonic

from ros2_mcp.model.errors import BadData, RobotError
from ros2_mcp.robot.graph import REQUEST_S, Graph
from ros2_mcp.robot.kept import Kept
from ros2_mcp.robot.listening import Listening
from ros2_mcp.robot.values import Values
from ros2_mcp.world.urdf import Urdf, parse
from ros2_mcp_common.policy.curves import State
from ros2_mcp_common.policy.trajectory_limits import JointBounds, Joints, LookAtJoints
from ros2_mcp_common.wire.protocol import JointsReply

DESCRIPTION, TEXT = "robot_description", "std_msgs/msg/String"
MOST_DESCRIPTION_BYTES = 16_000_000
"""The largest description that is read, in bytes: the size of a description with embedded meshes; `world/urdf.py`
accepts less.
"""
_SAID_S = 4.0
"""The time limit for a description, in s. A latched message arrives on matching; a publisher that missed this
subscriber's announcement is discovered 3 s later."""
_KEPT_S = 10.0
"""The time for which a description is reused, in s. It rarely changes; reading takes some hundredths of a second, and
megabytes for a large one."""
_MEASURED_S = 3.5
"""The time limit for the first joint states, in s, as in the bridge (`joint_states.MEASURED_S`)."""

Listen = Callable[[str], AbstractAsyncContextManager[Listening]]


class RobotJoints(Kept):
    """Joint states and joint limits, by which trajectories are judged. `listen` subscribes to a topic with text
    messages.
    """

    def __init__(self, listen: Listen, graph: Graph, values: Values) -> None:
        self._listen = listen
        self._graph = graph
        self._values = values
        self._urdf: Urdf | None = None
        self._read_at = -math.inf

    async def urdf(self) -> Urdf | None:
        """Return the robot's description; None if no readable description was published.

        The description of a publisher that has gone is kept: its limits still hold.
        """
        if monotonic() - self._read_at > _KEPT_S and (topics := await self.description_topics()):
            self._urdf, self._read_at = await self._read(topics[0]) or self._urdf, monotonic()
        return self._urdf

    async def look(self, names: Sequence[str] = ()) -> LookAtJoints:
        """Measure these joints, and send the description's joint limits to the bridge, which judges trajectories as
        well.

        Raises as `Graph.ask`.
        """
        limits = limits_of(await self.urdf())
        body = json.dumps({name: asdict(bounds) for name, bounds in limits.items()}).encode()
        reply = await self._graph.query(
            JointsReply,
            "joint_states",
            body,
            joints=list(names),
            within_s=_MEASURED_S if names else 0.0,
            timeout_s=_MEASURED_S + REQUEST_S,
        )
        measured = {name: State(*told) for name, told in reply["joints"].items()}
        return known(Joints(measured, limits))

    async def description_topics(self) -> Sequence[str]:
        """Return the topics with descriptions, `/robot_description` first; empty until such a topic is discovered."""
        rows = [row for row in await self._graph.topics() if row.publishers and TEXT in row.types]
        found = [row.name for row in rows if row.name.rpartition("/")[2] == DESCRIPTION]
        return sorted(found, key=lambda name: (name.count("/"), name))

    async def description_on(self, topic: str) -> str:
        """Return the description on a topic; "" if no message arrives. Raises as `Robot.listen`."""
        async with self._listen(topic) as listening:
            samples = await listening.take(_SAID_S)
        return str((await self._values.in_full(TEXT, samples[-1].data))["data"]) if samples else ""

    async def _read(self, topic: str) -> Urdf | None:
        try:
            text = await self.description_on(topic)
            return parse(text) if text else None
        except (BadData, RobotError):
            return None


def limits_of(urdf: Urdf | None) -> Mapping[str, JointBounds]:
    """Return the limits of a description's joints, by name."""
    joints = urdf.joints.values() if urdf else ()
    return {
        joint.name: JointBounds(
            joint.limits.lower, joint.limits.upper, joint.limits.velocity or None, wraps=joint.kind == "continuous"
        )
        for joint in joints
        if joint.kind != "fixed"
    }


def known(joints: Joints) -> LookAtJoints:
    """Return a lookup function over these measured joints. It raises `ValueError` for a joint without a measurement."""

    def look(names: Sequence[str]) -> Joints:
        if missing := [name for name in names if name not in joints.measured]:
            raise ValueError(f"no joint states tell where {', '.join(map(ascii, missing))} is")
        return joints

    return look
