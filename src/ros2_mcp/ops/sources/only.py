"""Choose the topic if a caller names none: the only topic of a type."""

from __future__ import annotations

from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.sources.source import Source

_MAX_NAMED = 8
"""The most topics in a sentence."""


async def only_topic(source: Source, topic: str, type_name: str, argument: str = "topic_name") -> tuple[str, str]:
    """Return the topic, or, if it is empty, the only published topic of that type; and a sentence on the choice.

    Of several, the only one that is not a costmap is chosen: costmaps have the type of maps, and are requested by name.

    Raises:
        NotFound: if there is none.
        BadInput: if there are several.
    """
    if topic.strip():
        return topic, ""
    found = await source.publishing(type_name)
    maps = [name for name in found if "costmap" not in name]
    if not found and (absence := await source.absence()):
        raise NotFound(absence, "ros2_status shows domain and middleware.")
    if not found:
        raise NotFound(
            f"No topic of type {type_name} has a publisher ({source.words}).", "ros2_topic_list lists the topics."
        )
    if len(found) > 1 and len(maps) != 1:
        raise BadInput(
            f"{len(found)} topics are {type_name}: {listed(found, _MAX_NAMED)}.", f"Name one of them: {argument}."
        )
    if len(found) == 1:
        return found[0], f"{named(found[0])} is the only topic of type {type_name}."
    others = [name for name in found if name != maps[0]]
    return maps[0], f"{named(maps[0])} was used; other topics of this type: {listed(others, _MAX_NAMED)}."
