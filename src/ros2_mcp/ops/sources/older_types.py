"""Read messages whose definition has changed: a recording without definitions is read with the definitions of the
distribution that wrote it.

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
"""How many messages of a topic without a definition are decoded, to see whether the
newest definition of its type fits."""

_OLDER = ("jazzy", "iron", "humble", "galactic", "foxy", "eloquent", "dashing")
"""The newest first: if several definitions fit, the newest is the most likely."""


def take(opened: OpenedBag, codec: Codec, topic: StoredTopic) -> None:
    """If the newest distribution's definition does not fit the first messages of a topic, take the newest older
    definition that fits. Do nothing if no definition fits, or the type never changed.
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
    """Return the sentence on messages that are read by an older definition; empty for others."""
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
    """Yield each distribution whose definition differs from the next newer distribution's."""
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
