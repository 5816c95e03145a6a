"""Messages whose definition has changed: recordings that carry none are read as the distribution that wrote them does.

Range, Marker and SolidPrimitive have more fields since Humble or Iron; the definitions are those of `rosbags`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from ros2_mcp.bags.schema import definitions_in
from ros2_mcp.bags.stored import Span, StoredTopic
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.interfaces import DefinitionText
from ros2_mcp.ops.memory.bag_store import OpenedBag

if TYPE_CHECKING:
    from ros2_mcp.values.cdr import Codec

_TRIED = 5
"""Messages of a topic without a definition: they tell whether the newest definition of its type fits."""

_OLDER = ("jazzy", "iron", "humble", "galactic", "foxy", "eloquent", "dashing")
"""The newest first: what fits several of them is most likely of the newest."""


def take(opened: OpenedBag, codec: Codec, topic: StoredTopic) -> None:
    """Takes the newest older definition that fits the first messages of a topic where that of the newest distribution
    does not; nothing where none does, or its type never changed.
    """
    from ros2_mcp.values.cdr import Codec  # with numpy: not before it is needed
    from ros2_mcp.values.definitions import Definitions

    if not codec.definitions.is_cdr(topic.type):
        return
    with opened.reading() as bag:
        first = [sample.data for _, sample in islice(bag.messages(Span(frozenset((topic.name,)))), _TRIED)]
    if _fits(codec, topic.type, first):
        return
    for distro, found in _definitions(topic.type):
        definitions = Definitions()
        definitions.add(found)
        if _fits(Codec(definitions), topic.type, first):
            codec.definitions.add(found)
            opened.read_as[topic.type] = distro
            return


def told(opened: OpenedBag, type_name: str) -> str:
    """What is to be said of messages that are read by an older definition; empty for others."""
    distro = opened.read_as.get(type_name)
    return f"Read as ROS 2 {distro.capitalize()} defines {type_name}; the newest does not fit." if distro else ""


def _fits(codec: Codec, type_name: str, messages: Sequence[bytes]) -> bool:
    try:
        for data in messages:
            codec.decode(type_name, data)
    except BadData:
        return False
    return True


def _definitions(type_name: str) -> Iterator[tuple[str, dict[str, DefinitionText]]]:
    """Each distribution whose definition differs from that of the next one."""
    from rosbags.typesys import Stores, TypesysError, get_typestore

    last = ""
    for distro in _OLDER:
        try:
            text, _ = get_typestore(Stores(f"ros2_{distro}")).generate_msgdef(type_name, ros_version=2)
        except (TypesysError, KeyError):
            continue
        if text != last:
            last = text
            yield distro, definitions_in(type_name, "ros2msg", text)
