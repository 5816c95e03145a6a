"""Waiting for the first messages of a bridge that has just started: how long `ros2_robot` waits, and what it then
reports.

Most of what describes a robot is found in the graph. Its pose and its faults arrive as messages; diagnostics are
published once a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic

from ros2_mcp.model.text import named
from ros2_mcp.robot.transforms import TF, TransformListener
from ros2_mcp.world.transforms import FrameTree

YOUNG_S = 10.0
"""Age of a bridge, in s, up to which a call waits for first messages. Publishers and the first subscriptions match
within 3 s, also on a slow network; a topic without messages after that is not worth a wait in every call."""
FIRST_S = 4.0
"""Time that a young bridge waits for the first message: four periods of a topic published once a second."""
_USUALLY = {"diagnostics": "; usually one message a second: ask again in 2 s"}


async def frames_heard(listener: TransformListener, published: Sequence[str], deadline: float) -> None:
    """Wait until a first transform of the `published` topics was received, or until the deadline (monotonic clock, in
    s).
    """
    while not _is_heard(listener.tree, published) and (left_s := deadline - monotonic()) > 0:
        await listener.news(left_s)


def _is_heard(tree: FrameTree, published: Sequence[str]) -> bool:
    """Return whether transforms were received, also such as are refused; if /tf has a publisher, the latched transforms
    of /tf_static are not enough.
    """
    if any(topic.endswith(TF) for topic in published):
        return tree.messages[TF] > 0
    return bool(tree.edges) or not published


def not_heard_in_words(part: str, topics: Sequence[str], waited_s: float) -> str:
    """Describe a part without messages: its topics, the time waited, and when to ask again."""
    return f"{', '.join(map(named, topics))} (no message in {waited_s:.1f} s{_USUALLY.get(part, '')})"
