"""Publishers of frames that tf2 listeners do not receive, and topics of frames without a publisher."""

from __future__ import annotations

from collections.abc import Sequence

from ros2_mcp.model.qos import mismatch
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot.transforms import LISTENS, TF, TF_STATIC, TF_TYPE
from ros2_mcp.world.transforms import FrameTree


async def unheard_publishers(source: Source) -> Sequence[str]:
    """Return the problems in sentences; empty for a recording, or if there are none."""
    if (listener := source.transforms) is None:
        return ()
    found: list[str] = []
    for topic in (TF, TF_STATIC):
        name = listener.namespace + topic
        for one in await listener.publishers(topic):
            if one.type != TF_TYPE:
                found.append(f"{named(one.node)} publishes {name} as {named(one.type)}, not as {TF_TYPE}.")
            elif why := mismatch(one.qos, LISTENS[topic]):
                found.append(f"Messages of {named(one.node)} on {name} do not reach tf2 listeners: {why}.")
    if not await listener.publishers(TF) and not await listener.publishers(TF_STATIC):
        found.append(f"{TF} and {TF_STATIC} have no publisher.{_elsewhere(await listener.other_topics())}")
    return found


def _elsewhere(topics: Sequence[str]) -> str:
    """Name the namespaced topics that do have frames, and suggest a remedy; a single namespace is followed
    automatically.
    """
    if not topics:
        return ""
    spaces = {one.removesuffix(topic): None for one in topics for topic in (TF, TF_STATIC) if one.endswith(topic)}
    there = f" There is {', '.join(map(named, topics))}"
    if len(spaces) < 2:
        return f"{there}: a namespace?"
    return (
        f"{there}: frames of {len(spaces)} robots, each in its namespace ({', '.join(map(named, spaces))}). No "
        f"argument chooses one of them: give each robot its own ROS domain, or remap one robot's topics to {TF} and "
        f"{TF_STATIC}."
    )


def followed_in_words(source: Source, tree: FrameTree) -> list[str]:
    """Report that the frames come from a namespace; empty if they do not."""
    if not tree.namespace:
        return []
    where = f"{named(tree.namespace + TF)} and {named(tree.namespace + TF_STATIC)}"
    why = f"{TF} has no publisher" if source.is_live else f"the recording has no {TF}"
    return [f"These frames are published on {where}: {why}."]
