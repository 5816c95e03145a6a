"""The settings of the bridge's watchdog: the policies' feedback and pose, with the limits that they imply."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from ros2_mcp.guard.policy import Policy
from ros2_mcp_common.policy.feedback import PARTS
from ros2_mcp_common.policy.rules import Limit
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES


def watch_of(policy: Policy) -> Mapping[str, Any]:
    """Return the settings in the form that `feedback.rules_of` of the bridge reads. The first policy with a feedback,
    or with a pose, provides it.
    """
    watch: dict[str, Any] = {}
    if feedback := next((found.feedback for found in policy.documents if found.feedback), None):
        watch["feedback"] = {**asdict(feedback), "most": most_of(policy)}
    named = next(((found.pose, found.rules.zones) for found in policy.documents if found.pose), None)
    if named and named[0]:
        pose, zones = named
        watch["pose"] = {
            **asdict(pose),
            "zone": asdict(zones[pose.zone]) if pose.zone else None,
            "keep_out": [asdict(found.keep_out) for found in policy.documents if found.keep_out],
        }
    return watch


def most_of(policy: Policy) -> Mapping[str, float]:
    """Return the strictest limit on the length of each part of a velocity, in m/s and rad/s."""
    most: dict[str, float] = {}
    for limit in _limits(policy):
        for path, bound in limit.checks.norm.items():
            part = path.rpartition(".")[2]
            if part in PARTS:
                most[part] = min(bound, most.get(part, bound))
    return most


def _limits(policy: Policy) -> Iterator[Limit]:
    for document in policy.documents:
        for limit in document.rules.limits:
            if any(limit.covers("/cmd_vel", kind) or kind in limit.types for kind in VELOCITY_TYPES):
                yield limit
