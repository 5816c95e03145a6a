"""Typed access to parts of rclpy that have no types or lie below its public classes: only this module uses these parts
of rclpy.

The endpoints are those of rclpy's C++ part. They belong to no executor, so that publishing and receiving run no Python
code of rclpy; see decision 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakSet

from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import (
    deserialize_message,  # pyright: ignore[reportUnknownVariableType]
    serialize_message,  # pyright: ignore[reportUnknownVariableType]
)

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

RCLError: type[Exception] = rclpy_implementation.RCLError


class RawPublisher(Protocol):
    """A publisher of serialized messages."""

    def publish_raw(self, data: bytes) -> None:
        """Publish one serialized message."""
        ...

    def get_subscription_count(self) -> int:
        """Return the number of matched subscribers."""
        ...

    def wait_for_all_acked(self, timeout: object) -> bool:
        """Return whether every reliable subscriber has acknowledged everything within the timeout."""
        ...

    def destroy_when_not_in_use(self) -> None:
        """Destroy the publisher."""
        ...


class RawSubscription(Protocol):
    """A subscription that receives serialized messages."""

    def take_message(self, interface: Any, raw: bool) -> tuple[bytes, dict[str, Any]] | None:
        """Return the next message in the queue and its metadata, or None."""
        ...

    def destroy_when_not_in_use(self) -> None:
        """Destroy the subscription."""
        ...


# Each endpoint holds its node: as long as there is one, the node does not leave ROS, even after it was destroyed.
_endpoints: WeakSet[RawPublisher | RawSubscription] = WeakSet()


def publisher(node: Node, interface: Any, topic: str, profile: QoSProfile) -> RawPublisher:
    """Create a publisher of a node."""
    with node.handle:
        raw = rclpy_implementation.Publisher(node.handle, interface, topic, profile.get_c_qos_profile())
    _endpoints.add(raw)
    return raw


def subscription(node: Node, interface: Any, topic: str, profile: QoSProfile) -> RawSubscription:
    """Create a subscription of a node."""
    with node.handle:
        raw = rclpy_implementation.Subscription(node.handle, interface, topic, profile.get_c_qos_profile())
    _endpoints.add(raw)
    return raw


def destroy_endpoints() -> None:
    """Destroy all remaining publishers and subscriptions: those of work that was under way until the end."""
    for raw in list(_endpoints):
        raw.destroy_when_not_in_use()


def client(node: Node, interface: Any, service: str, profile: QoSProfile) -> Client:
    """Create a client of a node; it belongs to the node's executor."""
    return node.create_client(interface, service, qos_profile=profile)  # pyright: ignore[reportUnknownMemberType]


def count_publishers(node: Node, topic: str) -> int:
    """Return the number of publishers of a topic, given by its full name. rclpy's own method
    takes four times as long.
    """
    with node.handle:
        return node.handle.get_count_publishers(topic)


def count_subscribers(node: Node, topic: str) -> int:
    """Return the number of subscribers of a topic, given by its full name."""
    with node.handle:
        return node.handle.get_count_subscribers(topic)


def counts(node: Node, topics: Sequence[str]) -> list[tuple[int, int]]:
    """Return the numbers of publishers and subscribers of topics.

    Acquiring the node once for all of them halves the time.
    """
    with node.handle:
        publishers, subscribers = node.handle.get_count_publishers, node.handle.get_count_subscribers
        return [(publishers(topic), subscribers(topic)) for topic in topics]


def is_acknowledged(raw: RawPublisher) -> bool:
    """Return whether every reliable subscriber has acknowledged everything, without waiting."""
    return raw.wait_for_all_acked(Duration(seconds=0)._duration_handle)  # pyright: ignore[reportPrivateUsage]


def serialize(message: Any) -> bytes:
    """Return a message as CDR."""
    return serialize_message(message)


def deserialize(data: bytes, message_class: Any) -> Any:
    """Return the message of that class from its CDR; the middlewares raise errors of many kinds."""
    return deserialize_message(data, message_class)
