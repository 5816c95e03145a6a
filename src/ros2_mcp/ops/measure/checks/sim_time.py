"""Nodes whose use_sim_time differs from that of the others, so that their stamps come from another clock."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.text import listed
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, Evidence
from ros2_mcp.ops.measure.findings import Finding

_CLOCK = "/clock"


def _find(evidence: Evidence) -> Iterator[Finding]:
    """Report nodes with a different use_sim_time. Publishers of /clock, such as the simulator, are not judged: they
    have a time of their own.
    """
    topic = evidence.graph.topics.get(_CLOCK)
    clocks = {one.node for one in topic.publishers} if topic else set[str]()
    simulated, by_wall = list[str](), list[str]()
    for node, parameters in (evidence.parameters or {}).items():
        value = next((one.value for one in parameters if one.name == "use_sim_time"), None)
        if node not in clocks and isinstance(value, bool):
            (simulated if value else by_wall).append(node)
    advice = "Give all nodes the same use_sim_time: true with a simulator or a bag that publishes /clock, else false."
    if simulated and not clocks:
        who = listed(simulated, MAX_NAMES)
        problem = f"use_sim_time is true, but /clock has no publisher: {who}. The clock of these nodes does not run."
        yield Finding("warning", simulated[0], problem, advice)
    elif simulated and by_wall:
        problem = f"use_sim_time is false, unlike that of {len(simulated)} others: {listed(by_wall, MAX_NAMES)}."
        if len(by_wall) > len(simulated):
            problem = f"use_sim_time is true, unlike that of {len(by_wall)} others: {listed(simulated, MAX_NAMES)}."
        yield Finding("warning", (by_wall if len(by_wall) <= len(simulated) else simulated)[0], problem, advice)


CHECK = Check(("parameters",), _find)
