"""Probable missing remappings: a topic that is published but has no subscriber, and one of the same type and nearly the
same name that has a subscriber but no publisher.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from ros2_mcp.model import names
from ros2_mcp.model.graph import OF_EVERY_NODE, TopicEndpoints
from ros2_mcp.model.names import may_be_one

_LEAST_LETTERS = 3
"""Of a word that two names share."""


def led_nowhere(topics: Mapping[str, TopicEndpoints]) -> Mapping[str, TopicEndpoints]:
    """Return, for each topic with subscribers but no publisher, the topic that was probably meant: the only similar one
    of the same type with publishers but no subscriber. Topics with several such candidates are absent.
    """
    seen = [one for name, one in topics.items() if name not in OF_EVERY_NODE and not names.is_hidden(name)]
    unheard = [topic for topic in seen if topic.publishers and not topic.subscribers]
    found: dict[str, TopicEndpoints] = {}
    for awaited in (topic for topic in seen if topic.subscribers and not topic.publishers):
        near = [topic for topic in unheard if set(topic.types) & set(awaited.types) and _is_near(topic, awaited)]
        if len(near) == 1:
            found[awaited.topic] = near[0]
    return found


def _is_near(one: TopicEndpoints, other: TopicEndpoints) -> bool:
    """Return whether two topics have the same last name or the same words, or last names that differ by added words or
    a misspelling. False if one node publishes the one and subscribes to the other.
    """
    if {each.node for each in one.publishers} & {each.node for each in other.subscribers}:
        return False  # a node that hears what it publishes itself is no case of a remapping
    last, other_last = one.topic.rpartition("/")[2], other.topic.rpartition("/")[2]
    if last == other_last or sorted(_words(one.topic)) == sorted(_words(other.topic)):
        return True
    shorter, longer = sorted((last, other_last), key=len)
    words = re.split("_", longer)
    has_more = len(shorter) >= _LEAST_LETTERS and any(
        "_".join(words[: len(words) - count]) == shorter or "_".join(words[count:]) == shorter
        for count in range(1, len(words))
    )
    return has_more or may_be_one(last, other_last)


def _words(topic: str) -> list[str]:
    return re.split("[/_]", topic.strip("/"))
