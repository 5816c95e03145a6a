"""What of rclpy has no types, or lies below its public classes, typed here: the only place that knows those parts.

The endpoints are those of rclpy's C++ part. No executor knows them, so that publishing and receiving cost no Python of
rclpy's; see decision 7.
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
    """Publishes serialized messages."""

    def publish_raw(self, data: bytes) -> None:
        """Hand one message to the middleware."""
        ...

    def get_subscription_count(self) -> int:
        """The number of matched subscribers."""
        ...

    def wait_for_all_acked(self, timeout: object) -> bool:
        """Whether every reliable subscriber has acknowledged everything within the time."""
        ...

    def destroy_when_not_in_use(self) -> None:
        """End it."""
        ...


class RawSubscription(Protocol):
    """Receives serialized messages."""

    def take_message(self, interface: Any, raw: bool) -> tuple[bytes, dict[str, Any]] | None:
        """The next message that waits, with what the middleware tells of it."""
        ...

    def destroy_when_not_in_use(self) -> None:
        """End it."""
        ...


# Each holds its node: as long as there is one, the node does not leave ROS, though it has been destroyed.
_endpoints: WeakSet[RawPublisher | RawSubscription] = WeakSet()


def publisher(node: Node, interface: Any, topic: str, profile: QoSProfile) -> RawPublisher:
    """A new publisher of a node."""
    with node.handle:
        raw = rclpy_implementation.Publisher(node.handle, interface, topic, profile.get_c_qos_profile())
    _endpoints.add(raw)
    return raw


def subscription(node: Node, interface: Any, topic: str, profile: QoSProfile) -> RawSubscription:
    """A new subscription of a node."""
    with node.handle:
        raw = rclpy_implementation.Subscription(node.handle, interface, topic, profile.get_c_qos_profile())
    _endpoints.add(raw)
    return raw


def destroy_endpoints() -> None:
    """End all publishers and subscriptions that are left: those of work that was under way to the end."""
    for raw in list(_endpoints):
        raw.destroy_when_not_in_use()


def client(node: Node, interface: Any, service: str, profile: QoSProfile) -> Client:
    """A new client of a node, which its executor knows."""
    return node.create_client(interface, service, qos_profile=profile)  # pyright: ignore[reportUnknownMemberType]


def count_publishers(node: Node, topic: str) -> int:
    """How many publish on a topic, by its full name: rclpy's own counting takes four times as long, to look at it."""
    with node.handle:
        return node.handle.get_count_publishers(topic)


def count_subscribers(node: Node, topic: str) -> int:
    """The number of its subscribers."""
    with node.handle:
        return node.handle.get_count_subscribers(topic)


def counts(node: Node, topics: Sequence[str]) -> list[tuple[int, int]]:
    """The numbers of publishers and subscribers of topics: to hold the node once for all of them halves the time."""
    with node.handle:
        publishers, subscribers = node.handle.get_count_publishers, node.handle.get_count_subscribers
        return [(publishers(topic), subscribers(topic)) for topic in topics]


def is_acknowledged(raw: RawPublisher) -> bool:
    """Whether every reliable subscriber has acknowledged everything; waits for nothing."""
    return raw.wait_for_all_acked(Duration(seconds=0)._duration_handle)  # pyright: ignore[reportPrivateUsage]


def serialize(message: Any) -> bytes:
    """The CDR of a message."""
    return serialize_message(message)


def deserialize(data: bytes, message_class: Any) -> Any:
    """The message of that class in CDR; the middlewares raise errors of many kinds."""
    return deserialize_message(data, message_class)
