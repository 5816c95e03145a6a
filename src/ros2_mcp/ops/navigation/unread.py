"""What a verdict on navigation needs and was not read: without it, that nothing was found says nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ros2_mcp.model.text import listed
from ros2_mcp.ops.navigation.checks.command_chain import chain_of
from ros2_mcp.ops.navigation.evidence import CLOUD, ODOMETRY, SCAN, NavEvidence

_GET = "get_parameters"
_GET_STATE = "get_state"
_MOST_NAMES = 4
_LATE = "no answer in time"


def unread_in(evidence: NavEvidence, why: Mapping[str, str] | None = None) -> list[str]:
    """Return what was not read, each part with the reason; `why` has the reasons for whole parts."""
    reasons = why or {}
    found = [*_states(evidence, reasons), *_parameters(evidence, reasons)]
    if evidence.frames is None:
        found.append(f"the transforms ({reasons.get('frames', _LATE)})")
    if evidence.heard is None:
        found.append(f"scans, odometry and commands ({reasons.get('heard', _LATE)})")
    else:
        heard = {one.type for one in evidence.heard.values()}
        for what, types in (("the sensors", (SCAN, CLOUD)), ("odometry", (ODOMETRY,))):
            published = [topic.topic for topic in evidence.topics(*types) if topic.publishers]
            if published and heard.isdisjoint(types):
                found.append(f"{what} ({listed(published, _MOST_NAMES)} could not be listened to)")
    if not chain_of(evidence).nodes:
        found.append("the command chain (no controller_server is seen)")
    return found


def servers_of(evidence: NavEvidence) -> list[str]:
    """Nav2's servers that are there: servers that a manager brings up, and servers that report their state."""
    managed = [node for supervisor in evidence.supervisors for node in evidence.managed(supervisor)]
    known = [*managed, *(node for node in evidence.robots_nodes if _offers(evidence, node, _GET_STATE))]
    return [node for node in dict.fromkeys(known) if node in evidence.nodes]


def _offers(evidence: NavEvidence, node: str, service: str) -> bool:
    return f"{node}/{service}" in (evidence.graph.services or {})


def _states(evidence: NavEvidence, reasons: Mapping[str, str]) -> Sequence[str]:
    if not evidence.states:
        return [f"the states of Nav2's servers ({reasons.get('states', 'nobody answered')})"]
    servers = servers_of(evidence)
    silent = [node for node in servers if not evidence.states.get(node)]
    if silent:
        return [f"the states of {len(silent)} of {len(servers)} servers ({listed(silent, _MOST_NAMES)}: {_LATE})"]
    return ()


def _parameters(evidence: NavEvidence, reasons: Mapping[str, str]) -> Sequence[str]:
    if evidence.parameters is None:
        return [f"the parameters ({reasons.get('parameters', _LATE)})"]
    nodes = [node for node in evidence.robots_nodes if _offers(evidence, node, _GET)]
    silent = [node for node in dict.fromkeys(nodes) if not evidence.parameters.get(node)]
    if silent:
        return [f"the parameters of {len(silent)} of {len(nodes)} nodes ({listed(silent, _MOST_NAMES)}: {_LATE})"]
    return ()
