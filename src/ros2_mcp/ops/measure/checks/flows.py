"""Topics that are silent, slow or interrupted, or have old stamps or values that are not finite.

The start of a chain is named: a topic may be silent because its publisher waits for another topic that is silent or has
no publisher.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ros2_mcp.model import names
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.model.text import listed
from ros2_mcp.model.times import both_times
from ros2_mcp.ops.graph.remaps import led_nowhere
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, Evidence, Flow, TopicRow, nodes_of, only, streams
from ros2_mcp.ops.measure.findings import Finding

_SILENT = ("SILENT", "STOPPED")


def _find(evidence: Evidence) -> Iterator[Finding]:
    waits = _waits(evidence)
    for row in evidence.rows:
        yield from _of(evidence, row, evidence.flows.get(row.topic_name), waits)


def _waits(evidence: Evidence) -> Mapping[str, str]:
    """Return, for each silent topic, the topic at the start of its chain: a topic that is silent too, or has no
    publisher.
    """
    silent = {row.topic_name for row in evidence.rows if row.state in _SILENT}
    topics = evidence.graph.topics
    heard: dict[str, list[str]] = {}
    for name, topic in topics.items():
        if name not in OF_EVERY_NODE and not names.is_hidden(name):
            for subscriber in topic.subscribers:
                heard.setdefault(subscriber.node, []).append(name)

    def first(name: str, seen: frozenset[str]) -> str:
        """Return the first topic of the chain; silent inputs precede inputs without a publisher, because the latter may
        be optional.
        """
        nodes = dict.fromkeys(one.node for one in topics[name].publishers)
        inputs = {node: [each for each in heard.get(node, ()) if each not in seen] for node in nodes}
        waits = {
            node: [each for each in of_node if each in silent or is_absent(each)] for node, of_node in inputs.items()
        }
        if not waits or not all(waits.values()):  # another node would publish it all the same
            return name
        missing = [each for of_node in waits.values() for each in of_node]
        for each in (one for one in missing if one in silent):
            return first(each, seen | {each})
        return missing[0]

    def is_absent(name: str) -> bool:
        return not topics[name].publishers and _is_needed(evidence, name)

    found = {name: first(name, frozenset((name,))) for name in silent if name in topics}
    return {name: cause for name, cause in found.items() if cause != name}


def _is_needed(evidence: Evidence, name: str) -> bool:
    """Return whether subscribers depend on the topic: a stream, or latched data such as a description or a map.

    Commands, goals and similar topics are silent unless in use.
    """
    topic = evidence.graph.topics[name]
    is_latched = all(one.qos.durability == "transient_local" for one in topic.subscribers)
    return streams(topic) or is_latched


def _of(evidence: Evidence, row: TopicRow, measured: Flow | None, waits: Mapping[str, str]) -> Iterator[Finding]:
    topic = evidence.graph.topics.get(row.topic_name)
    cause = only(sorted({one.node for one in topic.publishers})) if topic else ""
    severity = "critical" if row.expected else "warning"
    if measured and (finite := measured.finite) and finite.found:
        first = both_times(finite.first_ns, measured.zero_ns)
        bad = f"{finite.found} of {finite.looked_at} messages have NaN or infinite values"
        problem = f"{bad}, in {', '.join(finite.fields)}, first at {first}."
        advice = "Check its publisher's inputs and parameters; nodes that compute with these values produce NaN too."
        yield Finding(severity, row.topic_name, problem, advice, cause)
    if row.state == "SLOW":
        rate = "too few messages came to measure its rate" if row.rate_hz is None else f"{row.rate_hz:.2f} Hz"
        problem = f"Slow: {rate}, at least {evidence.expected.min_rate_hz:g} Hz expected."
        advice = "Check its publisher's load and rate parameter, or lower min_expected_rate_hz."
        yield Finding("warning", row.topic_name, problem, advice, cause)
    elif row.state == "OLD STAMPS" and measured and measured.ages:
        advice = "Compare the machines' clocks (chrony, NTP), and check its publisher's load and network."
        yield Finding("warning", row.topic_name, measured.ages.trouble, advice, cause)
    elif row.state in (*_SILENT, "INTERRUPTED") and topic:
        publishers = nodes_of(topic.publishers)
        problem, advice = _silence(publishers, measured), f"Check the device, parameters and log of {publishers}."
        root = evidence.graph.topics.get(waits.get(row.topic_name, ""))
        if root and not root.publishers:
            who = listed(sorted({one.node for one in root.subscribers}), MAX_NAMES)
            problem = f"{who} subscribes to {root.topic}, which has no publisher; so {row.topic_name} has no messages."
            advice = f"Start the node that publishes {root.topic}."
            if published := led_nowhere(evidence.graph.topics).get(root.topic):
                problem = f"So {row.topic_name} has no messages: its publisher waits for {root.topic}."
                advice = f"If they belong together, remap one: {published.topic}:={root.topic}."
            cause = only(evidence.graph.left.topics.get(root.topic, ())) if published else ""
            yield Finding(severity, root.topic, problem, advice, cause or root.topic)
            return
        if root:
            problem += f" The cause may be {root.topic}: {nodes_of(root.publishers)} sends no messages there either."
            advice = f"First find out why {root.topic} has no messages."
            cause = only(sorted({one.node for one in root.publishers})) or root.topic
        yield Finding(severity, row.topic_name, problem, advice, cause)


def _silence(publishers: str, measured: Flow | None) -> str:
    if measured and measured.from_before:
        return f"{publishers} publishes it, but nothing new came: {measured.from_before}."
    if not (measured and (silence := measured.silence)):
        return f"{publishers} publishes it, but no message came."
    since, for_s = f"from {both_times(silence.from_ns, measured.zero_ns)} on", f"{silence.duration_s:.1f} s"
    if silence.is_end:
        return f"It has stopped: no message in the last {for_s}, {since}."
    return f"It was interrupted: no message for {for_s} {since}."


CHECK = Check((), _find)
