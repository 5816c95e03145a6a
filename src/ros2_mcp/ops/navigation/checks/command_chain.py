"""The chain of velocity commands from the controller to the wheels: where it breaks before the base, and why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from ros2_mcp.model import qos
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import CHAIN, NavCheck
from ros2_mcp.ops.navigation.evidence import (
    ODOMETRY,
    VELOCITIES,
    NavEvidence,
    NavFinding,
    is_of_role,
    is_tool,
    nodes_of,
)
from ros2_mcp.robot import TopicEndpoints

_STAMPED = "enable_stamped_cmd_vel"
_BESIDE = ("docking_server", "behavior_server")
"""Nodes that publish velocities only while they are used; their topics may have no subscriber."""
_SETS_STAMPED = ("controller_server", "velocity_smoother", "collision_monitor", *_BESIDE)
_MOST_NAMES = 4


@dataclass(slots=True)
class Chain:
    """The path of the velocity commands: `nodes` in order, and the `topics` between them. `ends` are outputs without a
    matching subscriber, each as topic and publisher; `base` are nodes that publish no velocity, where a chain should
    end."""

    nodes: list[str] = field(default_factory=list[str])
    topics: list[str] = field(default_factory=list[str])
    ends: list[tuple[TopicEndpoints, Endpoint]] = field(default_factory=list[tuple[TopicEndpoints, Endpoint]])
    base: list[str] = field(default_factory=list[str])


def chain_of(evidence: NavEvidence, controller: str = "") -> Chain:
    """Follow the velocity commands from Nav2's controllers, or from one `controller`, by endpoints whose types and QoS
    match."""
    chain = Chain()
    topics = evidence.topics(*VELOCITIES)
    waiting = [controller] if controller else evidence.of_role("controller_server")
    while waiting:
        node = waiting.pop(0)
        if node in chain.nodes:
            continue
        chain.nodes.append(node)
        outputs = [
            (topic, one) for topic in topics for one in topic.publishers if one.node == node and one.type in VELOCITIES
        ]
        if not outputs:
            chain.base.append(node)
        for topic, publisher in outputs:
            takers = [one for one in topic.subscribers if _takes(publisher, one) and one.node != node]
            takers = [one for one in takers if not is_tool(one.node)]
            chain.topics.append(topic.topic)
            if not takers:
                chain.ends.append((topic, publisher))
            waiting += [one.node for one in takers if one.node not in waiting]
    return chain


def bases_of(evidence: NavEvidence) -> list[str]:
    """Return the nodes that drive the wheels: they subscribe to velocities, publish none, and publish odometry."""
    odometry = {one.node for topic in evidence.topics(ODOMETRY) for one in topic.publishers}
    heard = {one.node for topic in evidence.topics(*VELOCITIES) for one in topic.subscribers}
    sent = {one.node for topic in evidence.topics(*VELOCITIES) for one in topic.publishers}
    return sorted(node for node in odometry & heard - sent if not is_of_role(node, "velocity_smoother", "bt_navigator"))


def _takes(publisher: Endpoint, subscriber: Endpoint) -> bool:
    return publisher.type == subscriber.type and not qos.mismatch(publisher.qos, subscriber.qos) and not subscriber.ours


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    bases = bases_of(evidence)
    for controller in evidence.of_role("controller_server"):
        chain = chain_of(evidence, controller)
        if any(not bases or node in bases for node in chain.base):
            continue
        for topic, publisher in chain.ends:
            yield from _end(evidence, topic, publisher, chain)


def _end(evidence: NavEvidence, topic: TopicEndpoints, publisher: Endpoint, chain: Chain) -> Iterator[NavFinding]:
    others = [one for one in topic.subscribers if not one.ours and not is_tool(one.node) and one.node != publisher.node]
    where = named(topic.topic)
    way = " → ".join(named(node) for node in chain.nodes)
    other_type = [one for one in others if one.type != publisher.type and one.type in VELOCITIES]
    if other_type:
        sent, heard = (kind.rpartition("/")[2] for kind in (publisher.type, other_type[0].type))
        yield NavFinding(
            rank="stops everything",
            subject=topic.topic,
            cause=f"On {where} {named(publisher.node)} sends {sent}, and {listed(nodes_of(other_type), _MOST_NAMES)} "
            f"listens for {heard}: they never meet.",
            proof=f"One topic with two types, each end alone. {_stamped(evidence)}".rstrip(),
            remedy=f"Set {_STAMPED} alike at all nodes of Nav2, to {str(heard == 'TwistStamped').lower()} for this "
            "receiver, or change the receiver."
            if is_of_role(publisher.node, *_SETS_STAMPED)
            else f"Let {named(publisher.node)} send {heard}, or change the receiver.",
        )
        return
    if others:
        why = qos.mismatch(publisher.qos, others[0].qos)
        yield NavFinding(
            rank="stops everything",
            subject=topic.topic,
            cause=f"On {where} nothing passes from {named(publisher.node)} to {listed(nodes_of(others), _MOST_NAMES)}.",
            proof=f"{why[:1].upper()}{why[1:]}.",
            remedy="Give both compatible QoS.",
        )
        return
    waiting = _waiting(evidence, chain)
    cause = f"{named(publisher.node)} publishes {where}, which no node subscribes to"
    if waiting:
        node = nodes_of(waiting[0].subscribers)[0]
        free = [one.topic for one in waiting if not one.publishers and node in nodes_of(one.subscribers)]
        cause += f"; {named(node)} listens on {listed(free or [waiting[0].topic], _MOST_NAMES)}, where"
        cause += " no node publishes" if free else " Nav2 does not send"
    to = named(waiting[0].topic) if waiting else "the topic of the base"
    sends = {one.node for other in evidence.topics(*VELOCITIES) for one in other.publishers}
    is_mux = bool(waiting) and any(one.node in sends for one in waiting[0].subscribers)
    yield NavFinding(
        rank="stops everything",
        subject=topic.topic,
        cause=f"{cause}.",
        proof=f"The chain by endpoints: {way}, then {where}, which has 0 subscribers.",
        remedy=f"Remap {where} to {to}{', or make it an input of the multiplexer' if is_mux else ''}.",
    )


def _waiting(evidence: NavEvidence, chain: Chain) -> Sequence[TopicEndpoints]:
    """Return velocity topics outside the chain that have subscribers: first topics without a publisher, then topics of
    bases.
    """
    bases = bases_of(evidence)
    found = [
        topic
        for topic in evidence.topics(*VELOCITIES)
        if topic.topic not in chain.topics
        and any(not one.ours and not is_tool(one.node) and one.node not in chain.nodes[:1] for one in topic.subscribers)
    ]
    return sorted(
        found,
        key=lambda topic: (
            bool(topic.publishers),
            not any(one.node in chain.nodes or one.node in bases for one in topic.subscribers),
            "nav" not in topic.topic,
            topic.topic,
        ),
    )


def _stamped(evidence: NavEvidence) -> str:
    values = evidence.values(_STAMPED, *_SETS_STAMPED)
    if len(set(values.values())) < 2:
        return ""
    return f"{_STAMPED} is {', '.join(f'{str(value).lower()} at {named(node)}' for node, value in values.items())}."


CHECK = NavCheck((), _find, CHAIN)
