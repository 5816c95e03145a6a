"""The present positions of joints: the newest position of each joint, from all topics with joint states at once."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from time import monotonic
from typing import NamedTuple

import anyio

from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.text import listed
from ros2_mcp.robot import Listening, Robot

JOINT_STATE = "sensor_msgs/msg/JointState"
_MOST_TOPICS = 8
"""Arm, gripper, wheels: as in the bridge (`joint_states.MOST_TOPICS`)."""
_TAKE_S = 1.0
_LOOK_S = 0.02
"""Seconds between two checks while waiting: joint states come at 10 to 1,000 Hz."""
FIRST_S = 4.0
"""Time for a first message: a publisher that missed our announcement is discovered with the next announcement, 3 s
later.
"""


class At(NamedTuple):
    """A joint's position, in rad or m, and when it was received (monotonic, s)."""

    position: float
    heard_at: float


@dataclass(slots=True)
class JointStates:
    """The newest position of each joint that was reported since the subscription began."""

    topics: Sequence[str] = ()
    positions: dict[str, At] = field(default_factory=dict[str, At])

    async def wait_for(self, joints: Sequence[str], within_s: float = FIRST_S) -> None:
        """Wait until all of these joints have been reported. Raises `NotFound`, with the
        joints that were, if some are not.
        """
        with anyio.move_on_after(within_s):
            while not self.positions.keys() >= set(joints):
                await anyio.sleep(_LOOK_S)
            return
        missing = [joint for joint in joints if joint not in self.positions]
        heard = f"only {listed(sorted(self.positions), 12)}" if self.positions else "no joint is reported"
        raise NotFound(
            f"No joint state reports {listed(missing, 6)}: {heard} on {listed(self.topics, 4) or 'no topic'}.",
            "Start the joint state broadcaster; ros2_topic_info shows who publishes.",
        )

    def age_s(self, joints: Sequence[str]) -> float:
        """Return the greatest age, in s, of the newest positions of these joints."""
        return monotonic() - min((self.positions[joint].heard_at for joint in joints), default=-math.inf)

    def of(self, joints: Sequence[str]) -> list[float]:
        """Return the newest positions of these joints."""
        return [self.positions[joint].position for joint in joints]


@asynccontextmanager
async def joint_states(robot: Robot) -> AsyncGenerator[JointStates, None]:
    """Subscribe to joint states inside the context. Raises `NotFound` if they have no publisher."""
    rows = await robot.graph.topics()
    topics = sorted(row.name for row in rows if JOINT_STATE in row.types and row.publishers)[:_MOST_TOPICS]
    if not topics:
        raise await robot.graph.missing(
            f"Joint states ({JOINT_STATE}) have no publisher: the joints' positions are unknown.",
            "Start the robot's joint state broadcaster.",
        )
    states = JointStates(topics)
    async with AsyncExitStack() as stack:
        heard = [await stack.enter_async_context(robot.listen(topic, JOINT_STATE, keep="latest")) for topic in topics]
        failure: Exception | None = None
        async with anyio.create_task_group() as group:
            for listening in heard:
                group.start_soon(_hear, robot, listening, states)
            try:
                yield states
            except Exception as error:  # noqa: BLE001 - raised below as itself, where the group would wrap it
                failure = error
            group.cancel_scope.cancel()
        if failure:
            raise failure


async def _hear(robot: Robot, listening: Listening, states: JointStates) -> None:
    while True:
        for sample in await listening.take(_TAKE_S):
            message = await robot.values.in_full(JOINT_STATE, sample.data)
            for name, position in zip(message["name"], message["position"], strict=False):
                if isinstance(position, (int, float)) and math.isfinite(position):
                    states.positions[str(name)] = At(float(position), monotonic())
