"""A service or action with several servers: a request reaches all servers, or any of them."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model import names
from ros2_mcp.model.text import listed
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, Evidence
from ros2_mcp.ops.measure.findings import Finding

_SEND_GOAL = "/_action/send_goal"


def _find(evidence: Evidence) -> Iterator[Finding]:
    offered: dict[tuple[str, ...], tuple[list[str], list[str]]] = {}
    for service, nodes in (evidence.servers or {}).items():
        is_action = service.endswith(_SEND_GOAL)
        if len(set((evidence.graph.services or {}).get(service, ()))) > 1:
            continue  # a request has one type and reaches only servers of that type; the check `types` reports it
        if len(set(nodes)) < 2 or (names.is_hidden(service) and not is_action):
            continue
        services, actions = offered.setdefault(tuple(sorted(set(nodes))), ([], []))
        (actions if is_action else services).append(service.removesuffix(_SEND_GOAL))
    for nodes, (services, actions) in offered.items():  # a node started twice is one fault, not one for each service
        what = [
            f"the {kind}{'s' if len(found) > 1 else ''} {listed(found, MAX_NAMES)}"
            for kind, found in (("service", services), ("action", actions))
            if found
        ]
        problem = f"{listed(nodes, MAX_NAMES)} offer {' and '.join(what)}: every request reaches all of them."
        advice = "Stop all servers but one, or give each its own namespace."
        yield Finding("warning", (services or actions)[0], problem, advice)


CHECK = Check(("servers",), _find)
