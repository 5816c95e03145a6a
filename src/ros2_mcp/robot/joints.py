"""How the robot's joints move now, as its bridge measures it, and what its description (URDF) lets them do."""

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
"""One description with meshes inside; `world/urdf.py` reads less."""
_SAID_S = 4.0
"""A latched message comes with the matching; a publisher that missed our announcement is discovered 3 s later."""
_KEPT_S = 10.0
"""A description hardly ever changes; reading it takes some hundredths of a second, and MB of a large one."""
_MEASURED_S = 3.5
"""For the first joint states: as in the bridge (`joint_states.MEASURED_S`)."""

Listen = Callable[[str], AbstractAsyncContextManager[Listening]]


class RobotJoints(Kept):
    """What trajectories are judged by. `listen` subscribes to a topic with texts."""

    def __init__(self, listen: Listen, graph: Graph, values: Values) -> None:
        self._listen = listen
        self._graph = graph
        self._values = values
        self._urdf: Urdf | None = None
        self._read_at = -math.inf

    async def urdf(self) -> Urdf | None:
        """The robot's description, also of a publisher that has gone: its limits do not go with it. None where nobody
        has published one that can be read.
        """
        if monotonic() - self._read_at > _KEPT_S and (topics := await self.description_topics()):
            self._urdf, self._read_at = await self._read(topics[0]) or self._urdf, monotonic()
        return self._urdf

    async def look(self, names: Sequence[str] = ()) -> LookAtJoints:
        """Measures these joints, and tells the bridge what the description lets joints do, by which it judges, too.

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
        """Where descriptions are published, `/robot_description` first; none while none is discovered."""
        rows = [row for row in await self._graph.topics() if row.publishers and TEXT in row.types]
        found = [row.name for row in rows if row.name.rpartition("/")[2] == DESCRIPTION]
        return sorted(found, key=lambda name: (name.count("/"), name))

    async def description_on(self, topic: str) -> str:
        """The description that a topic has; empty where no message comes. Raises as `Robot.listen`."""
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
    """What a description lets its joints do, by name."""
    joints = urdf.joints.values() if urdf else ()
    return {
        joint.name: JointBounds(
            joint.limits.lower, joint.limits.upper, joint.limits.velocity or None, wraps=joint.kind == "continuous"
        )
        for joint in joints
        if joint.kind != "fixed"
    }


def known(joints: Joints) -> LookAtJoints:
    """Looks at joints that were measured before."""

    def look(names: Sequence[str]) -> Joints:
        if missing := [name for name in names if name not in joints.measured]:
            raise ValueError(f"no joint states tell where {', '.join(map(ascii, missing))} is")
        return joints

    return look
