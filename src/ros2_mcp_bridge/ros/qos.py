"""Quality of service: conversions between the stream's JSON and rclpy's profiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, TypeVar

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

from ros2_mcp_bridge.request import OperationError
from ros2_mcp_common.wire.protocol import EndpointQoS

if TYPE_CHECKING:
    from rclpy.duration import Duration

P = TypeVar("P", bound=IntEnum)

INFINITE_NS = 2**63 - 1  # as rmw spells it
# More than any queue that fits into memory: no limit.
MAX_DEPTH = 1_000_000


def profile(qos: Mapping[str, object], min_depth: int = 1, max_depth: int = MAX_DEPTH) -> QoSProfile:
    """Return the rclpy profile for a request's `qos` object, its depth clamped to the limits.

    Raises:
        OperationError: of kind `bad_request`, if a policy is wrong.
    """
    depth = qos.get("depth", 10)
    if isinstance(depth, bool) or not isinstance(depth, int) or depth < 0:
        raise OperationError("bad_request", f"qos: depth is {depth!r}, expected a number that is not negative.")
    return QoSProfile(
        reliability=_policy(QoSReliabilityPolicy, qos, "reliability", "reliable", ("reliable", "best_effort")),
        durability=_policy(QoSDurabilityPolicy, qos, "durability", "volatile", ("volatile", "transient_local")),
        history=_policy(QoSHistoryPolicy, qos, "history", "keep_last", ("keep_last", "keep_all")),
        depth=min(max(depth, min_depth), max_depth),
    )


def describe(profile_found: QoSProfile) -> EndpointQoS:
    """Return the `qos` object of an endpoint: "unknown" for what the middleware does not report, None for infinity."""
    history = profile_found.history.name.lower()
    return {
        "reliability": profile_found.reliability.name.lower(),
        "durability": profile_found.durability.name.lower(),
        "history": history,
        "depth": "unknown" if history == "unknown" else profile_found.depth,
        "deadline_ns": _nanoseconds(profile_found.deadline),
        "lifespan_ns": _nanoseconds(profile_found.lifespan),
        "liveliness": profile_found.liveliness.name.lower(),
        "liveliness_lease_ns": _nanoseconds(profile_found.liveliness_lease_duration),
    }


def offers_enough(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Return whether a publisher with profile `offered` can match a subscriber with profile `requested`.

    Compares reliability and durability.
    """
    return not (
        (offered.reliability.name == "BEST_EFFORT" and requested.reliability.name == "RELIABLE")
        or (offered.durability.name == "VOLATILE" and requested.durability.name == "TRANSIENT_LOCAL")
    )


def _policy(policies: type[P], qos: Mapping[str, object], name: str, default: str, choices: Sequence[str]) -> P:
    value = qos.get(name, default)
    if not isinstance(value, str) or value not in choices:
        raise OperationError("bad_request", f"qos: {name} is {value!r}, expected one of {', '.join(choices)}.")
    return policies[value.upper()]


def _nanoseconds(duration: Duration) -> int | None:
    # 0 is how rmw spells "not specified", which means infinite for all three
    return None if duration.nanoseconds in (0, INFINITE_NS) else duration.nanoseconds
