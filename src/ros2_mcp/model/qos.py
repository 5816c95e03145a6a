"""Quality of service: policies of endpoints, our choice for our own endpoints, and reasons for a mismatch."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.names import full_node_name
from ros2_mcp.model.text import counted

if TYPE_CHECKING:
    from ros2_mcp_common.wire import protocol

_LIVELINESS_RANK = {"automatic": 0, "manual_by_topic": 1}


@dataclass(frozen=True, slots=True)
class QoS:
    """The policies of one endpoint; None is an infinite duration.

    A policy that the middleware does not report is `"unknown"`, an unknown depth is None.
    """

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int | None = 10
    deadline_ns: int | None = None
    lifespan_ns: int | None = None
    liveliness: str = "automatic"
    liveliness_lease_ns: int | None = None

    def request(self) -> dict[str, str | int | None]:
        """Return the policies that the bridge sets on an endpoint of this server."""
        return {
            "reliability": self.reliability,
            "durability": self.durability,
            "history": self.history,
            "depth": self.depth,
        }


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher or subscriber of a topic, as found by discovery; `ours` if it is this server's own."""

    node: str
    type: str
    hash: str
    gid: str
    qos: QoS
    ours: bool = False

    @property
    def who(self) -> str:
        """The name of its node, for people; it is marked if it is this server."""
        return f"{self.node} (this server)" if self.ours else self.node

    @classmethod
    def parse(cls, raw: protocol.Endpoint, own_nodes: Collection[str] = ()) -> Endpoint:
        """Parse one endpoint of the bridge's `endpoints` reply."""
        qos: dict[str, Any] = {**raw["qos"]}
        if qos["depth"] == "unknown":
            qos["depth"] = None
        name = full_node_name(raw["node"], raw["namespace"])
        ours = name in own_nodes
        return cls(node=name, type=raw["type"], hash=raw["hash"], gid=raw["gid"], qos=QoS(**qos), ours=ours)


@dataclass(frozen=True, slots=True)
class Choice:
    """The QoS for an endpoint of this server, and the reason in words."""

    qos: QoS
    reason: str


def for_subscribing(publishers: Sequence[Endpoint], depth: int = 100, *, is_volatile: bool = False) -> Choice:
    """Choose the QoS of a subscription that matches every publisher and loses as little as possible.

    With `is_volatile` it receives nothing that was published earlier.
    """
    if not publishers:
        return Choice(QoS("best_effort", "volatile", depth=depth), "no publisher is known; this QoS matches any")
    reliable = sum(publisher.qos.reliability == "reliable" for publisher in publishers)
    latched = sum(publisher.qos.durability == "transient_local" for publisher in publishers)
    return Choice(
        QoS(
            "reliable" if reliable == len(publishers) else "best_effort",
            "transient_local" if latched == len(publishers) and not is_volatile else "volatile",
            depth=depth,
        ),
        f"{counted(len(publishers), 'publisher')}: {reliable} reliable, {latched} transient_local",
    )


def still_fits(subscribed: QoS, publishers: Sequence[Endpoint]) -> bool:
    """Return whether a new subscription to these publishers would have the same QoS; true without publishers.

    This detects more than a mismatch: when a publisher has gone, the others may allow a stricter subscription.
    """
    now = for_subscribing(publishers).qos
    return not publishers or (now.reliability, now.durability) == (subscribed.reliability, subscribed.durability)


def for_publishing(subscribers: Sequence[Endpoint]) -> Choice:
    """Choose the QoS of a publisher that reaches every subscriber."""
    if not subscribers:
        return Choice(QoS(), "no subscriber is known; the defaults of ROS 2")
    latched = any(subscriber.qos.durability == "transient_local" for subscriber in subscribers)
    best_effort = all(subscriber.qos.reliability == "best_effort" for subscriber in subscribers)
    durability = (
        "transient_local, because a subscriber asks for it" if latched else "volatile, as no subscriber requests more"
    )
    reliability = (
        "best_effort, as no subscriber asks for more" if best_effort else "reliable, which every subscriber takes"
    )
    return Choice(
        QoS(
            "best_effort" if best_effort else "reliable",
            "transient_local" if latched else "volatile",
            depth=1 if latched else 100,
        ),
        f"{reliability}; {durability}",
    )


def mismatch(publisher: QoS, subscriber: QoS) -> str:
    """Explain why two endpoints do not match, by the request/offered rules of DDS; empty if they match."""
    reasons: list[str] = []
    if publisher.reliability == "best_effort" and subscriber.reliability == "reliable":
        reasons.append("the publisher offers best_effort, the subscriber asks for reliable")
    if publisher.durability == "volatile" and subscriber.durability == "transient_local":
        reasons.append("the publisher offers volatile, the subscriber asks for transient_local")
    if _is_longer(publisher.deadline_ns, subscriber.deadline_ns):
        reasons.append(_too_long("deadline", publisher.deadline_ns, subscriber.deadline_ns))
    if _LIVELINESS_RANK.get(publisher.liveliness, 0) < _LIVELINESS_RANK.get(subscriber.liveliness, 0):
        offered, asked = publisher.liveliness, subscriber.liveliness
        reasons.append(f"the publisher offers {offered} liveliness, the subscriber asks for {asked}")
    if _is_longer(publisher.liveliness_lease_ns, subscriber.liveliness_lease_ns):
        leases = publisher.liveliness_lease_ns, subscriber.liveliness_lease_ns
        reasons.append(_too_long("liveliness lease", *leases))
    return "; ".join(reasons)


def _too_long(what: str, offered_ns: int | None, asked_ns: int | None) -> str:
    """Describe the offered and the requested duration in seconds; None is infinite."""
    offered, asked = ("infinite" if ns is None else f"{ns / 1e9:g} s" for ns in (offered_ns, asked_ns))
    return f"the publisher's {what} ({offered}) is longer than the subscriber asks for ({asked})"


def _is_longer(offered_ns: int | None, asked_ns: int | None) -> bool:
    if asked_ns is None:
        return False
    return offered_ns is None or offered_ns > asked_ns
