"""What a bridge that has just begun has not heard yet: how long `ros2_robot` waits for it, and what it says then.

Most of what a robot is stands in the graph. Where it is, and what is wrong with it, comes in messages, of which
diagnostics are published once a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic

from ros2_mcp.model.text import named
from ros2_mcp.robot.transforms import TF, TransformListener
from ros2_mcp.world.transforms import FrameTree

YOUNG_S = 10.0
"""Of the bridge. Publishers and its first subscriptions find each other within 3 s, also on a slow network. What is
silent after that stays silent, and is not worth a wait in every call."""
FIRST_S = 4.0
"""So long a young bridge waits for the first message of what is published: four of what comes once a second."""
_USUALLY = {"diagnostics": "; usually one message a second: ask again in 2 s"}


async def frames_heard(listener: TransformListener, published: Sequence[str], deadline: float) -> None:
    """Returns when what is published of transforms was heard once, or at the deadline (monotonic, in s)."""
    while not _is_heard(listener.tree, published) and (left_s := deadline - monotonic()) > 0:
        await listener.news(left_s)


def _is_heard(tree: FrameTree, published: Sequence[str]) -> bool:
    """Where somebody publishes on /tf, what is latched on /tf_static is not all that there is."""
    if any(topic.endswith(TF) for topic in published):
        return any(edge.moving or edge.unstamped for edge in tree.edges.values())
    return bool(tree.edges) or not published


def not_heard_in_words(part: str, topics: Sequence[str], waited_s: float) -> str:
    """That a part was not heard: on which topics, for how long, and when to ask again."""
    return f"{', '.join(map(named, topics))} (no message in {waited_s:.1f} s{_USUALLY.get(part, '')})"
