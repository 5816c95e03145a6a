"""A remapping that leads nowhere: a topic is published that nobody hears, and one of the same type and nearly the same
name is awaited that nobody publishes."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ros2_mcp.model import names
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.model.names import may_be_one
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import Evidence, nodes_of, only
from ros2_mcp.ops.measure.findings import Finding
from ros2_mcp.robot import TopicEndpoints

_LEAST_LETTERS = 3
"""Of a word that two names share."""


def _find(evidence: Evidence) -> Iterator[Finding]:
    topics = [
        topic
        for name, topic in evidence.graph.topics.items()
        if name not in OF_EVERY_NODE and not names.is_hidden(name)
    ]
    unheard = [topic for topic in topics if topic.publishers and not topic.subscribers]
    for awaited in (topic for topic in topics if topic.subscribers and not topic.publishers):
        near = [topic for topic in unheard if set(topic.types) & set(awaited.types) and _is_near(topic, awaited)]
        if len(near) != 1:  # of several none is the one that is meant
            continue
        who, by = nodes_of(awaited.subscribers), nodes_of(near[0].publishers)
        problem = f"{who} waits for it, and nobody publishes it; {by} publishes {near[0].topic}, which nobody hears."
        advice = f"If they belong together, remap one: {near[0].topic}:={awaited.topic}."
        yield Finding(
            "warning", awaited.topic, problem, advice, only(evidence.graph.left.topics.get(awaited.topic, ()))
        )


def _is_near(one: TopicEndpoints, other: TopicEndpoints) -> bool:
    """Whether they have the same last name, one name is the other with a word more, or they are misspelt."""
    if {each.node for each in one.publishers} & {each.node for each in other.subscribers}:
        return False  # a node that hears what it publishes itself is no case of a remapping
    last, other_last = one.topic.rpartition("/")[2], other.topic.rpartition("/")[2]
    if last == other_last:
        return True
    shorter, longer = sorted((last, other_last), key=len)
    words = re.split("_", longer)
    has_more = len(shorter) >= _LEAST_LETTERS and any(
        "_".join(words[: len(words) - count]) == shorter or "_".join(words[count:]) == shorter
        for count in range(1, len(words))
    )
    return has_more or may_be_one(last, other_last)


CHECK = Check((), _find)
