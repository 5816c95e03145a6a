"""Commands without effect: another node commands the base, it does not move, a limit is 0, or a component has a
fault."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from ros2_mcp.model.text import listed, named, quoted
from ros2_mcp.ops.navigation.base import is_greatest_speed
from ros2_mcp.ops.navigation.base import is_zero as is_zero_limit
from ros2_mcp.ops.navigation.checks.check import CHAIN, NavCheck
from ros2_mcp.ops.navigation.checks.command_chain import Chain, chain_of
from ros2_mcp.ops.navigation.evidence import (
    ODOMETRY,
    VELOCITIES,
    Heard,
    NavEvidence,
    NavFinding,
    is_of_role,
    is_tool,
    is_zero,
    nodes_of,
    speed_of,
)

_LEAST = 5
"""Least number of commands within two seconds: a node that drives the robot sends ten a second, and a single press of a
button is no conflict."""
_MOVES_M_S, _TURNS_RAD_S = 0.02, 0.05
_LEAST_COMMANDED = 0.6
"""Least share of the commands that ask for motion."""
_FAULT = re.compile(r"motor|disabled|e-?stop|emergency|brake|idle|fault|protective|undervoltage|blocked", re.IGNORECASE)
_RELEASES = re.compile(r"motor|enable|e_?stop|emergency|brake|release|reset_fault|clear_fault", re.IGNORECASE)
_SWITCHES = {"std_srvs/srv/SetBool", "std_srvs/srv/Trigger", "std_srvs/srv/Empty"}
_MOST_NAMES = 4


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    chain = chain_of(evidence)
    if not chain.nodes:
        return
    faults, rivals = list(_faults(evidence, chain)), list(_rivals(evidence, chain))
    yield from (finding for finding, _ in rivals)
    yield from _limits(evidence, chain)
    yield from faults
    if not faults and not any(are_zeros for _, are_zeros in rivals):
        yield from _stands(evidence, chain)


def _is_nav2(node: str, chain: Chain) -> bool:
    roles = ("controller_server", "behavior_server", "docking_server", "velocity_smoother", "collision_monitor")
    return node in chain.nodes or is_of_role(node, *roles)


def _rivals(evidence: NavEvidence, chain: Chain) -> Iterator[tuple[NavFinding, bool]]:
    """Find nodes outside Nav2 that publish velocities to a node of the chain, each with whether they are mostly zeros.
    A publisher that sends nothing does not count."""
    for heard in evidence.of(*VELOCITIES):
        topic = evidence.topic(heard.topic)
        if not any(one.node in chain.nodes for one in topic.subscribers) or heard.count < _LEAST:
            continue
        foreign = [node for node in nodes_of(topic.publishers) if not _is_nav2(node, chain)]
        foreign = [node for node in foreign if not any(one.node == node and one.ours for one in topic.publishers)]
        ours = [node for node in nodes_of(topic.publishers) if _is_nav2(node, chain)]
        writers = {writer for _, _, writer in heard.messages if writer}
        if not foreign or (ours and len(writers) < 2 and (evidence.goal_runs or _comes_before(evidence, ours, heard))):
            continue
        zeros = sum(is_zero(message) for _, message, _ in heard.messages)
        are_zeros = zeros > heard.count / 2
        what = "zeros" if are_zeros else "velocities"
        rates = [sum(one == writer for _, _, one in heard.messages) for writer in writers] or [heard.count]
        rate_hz = max(rates) / heard.duration_s if heard.duration_s else 0.0
        beside = (
            " over Nav2's commands" if ours else f", to which {listed(_takers(topic, chain), 2)} listens beside Nav2's"
        )
        finding = NavFinding(
            rank="stops everything",
            subject=heard.topic,
            cause=f"{listed(foreign, _MOST_NAMES)} sends {what} on {named(heard.topic)}{beside}.",
            proof=f"{heard.count} commands in {heard.duration_s:.1f} s, {zeros} of them zero; the most frequent "
            f"publisher sends {rate_hz:.0f} Hz{', while no goal runs' if not evidence.goal_runs else ''}.",
            remedy="Stop it, or put both behind a multiplexer with priorities (twist_mux).",
        )
        yield finding, are_zeros


def _takers(topic: Any, chain: Chain) -> list[str]:
    return [node for node in nodes_of(topic.subscribers) if node in chain.nodes]


def _comes_before(evidence: NavEvidence, ours: list[str], heard: Heard) -> bool:
    """Whether the messages on a topic may come from Nav2's own nodes: one of their inputs has messages."""
    inputs = [
        one
        for one in evidence.of(*VELOCITIES)
        if one.topic != heard.topic and any(end.node in ours for end in evidence.topic(one.topic).subscribers)
    ]
    return any(one.count for one in inputs)


def _limits(evidence: NavEvidence, chain: Chain) -> Iterator[NavFinding]:
    """Find maximum speeds of 0 among the parameters of the chain's nodes."""
    for node in chain.nodes:
        values: Mapping[str, Any] = (evidence.parameters or {}).get(node, {})
        off = [
            f"{name} = {value}"
            for name, value in values.items()
            if is_greatest_speed(name) and is_zero_limit(value) and not _is_unlimited(values, name)
        ]
        if off:
            yield NavFinding(
                rank="stops everything",
                subject=node,
                cause=f"{named(node)} has the limit {off[0]}: nothing gets through.",
                proof=f"{len(off)} of its greatest speeds {'is' if len(off) == 1 else 'are'} 0.",
                remedy="Set it to more than 0: ros2_parameter_set.",
            )


def _is_unlimited(values: Mapping[str, Any], name: str) -> bool:
    return values.get(f"{name.rpartition('.')[0]}.has_velocity_limits") is False


def _faults(evidence: NavEvidence, chain: Chain) -> Iterator[NavFinding]:
    """Find faults that the base or a node of the chain reports on /diagnostics."""
    for row in evidence.diagnostics or ():
        if row.level in ("OK", "STALE") or not _FAULT.search(row.message):
            continue
        name = row.name.partition(":")[0].strip("/ ")
        is_of_chain = any(node.strip("/").endswith(name) for node in chain.nodes)
        if not is_of_chain and not re.search(r"base|motor|drive|wheel|e-?stop|safety", row.name, re.IGNORECASE):
            continue
        yield NavFinding(
            rank="stops everything",
            subject=row.name,
            cause=f"{quoted(row.name)} reports {row.level}: {quoted(row.message)}.",
            proof="On /diagnostics, now.",
            remedy=f"Release it (motors, emergency stop, mode){_may_release(evidence)}.",
        )


def _may_release(evidence: NavEvidence) -> str:
    """Name services that look as if they switch motors on, or release an emergency stop; "" if there are none."""
    found = [
        name
        for name, types in (evidence.graph.services or {}).items()
        if _RELEASES.search(name.rpartition("/")[2]) and not _SWITCHES.isdisjoint(types)
    ]
    return f"; {listed(sorted(found), 3)} may do it" if found else ""


def _stands(evidence: NavEvidence, chain: Chain) -> Iterator[NavFinding]:
    """Find a robot that does not move although it is commanded: the last topic of the chain with commands asks for
    motion, and odometry reports none."""
    moving = [one for one in evidence.of(ODOMETRY) if one.count >= _LEAST]
    if not moving or any(_moves(message) for one in moving for _, message, _ in one.messages[-_LEAST:]):
        return
    commanded: list[Heard] = []
    for one in evidence.of(*VELOCITIES):
        asks = [message for _, message, _ in one.messages if not is_zero(message)]
        is_of_chain = one.topic in chain.topics
        if is_of_chain and one.count >= _LEAST and len(asks) >= _LEAST_COMMANDED * one.count:
            commanded.append(one)
    if not commanded:
        return
    order = {topic: place for place, topic in enumerate(chain.topics)}
    last = max(commanded, key=lambda one: order[one.topic])
    takers = [node for node in nodes_of(evidence.topic(last.topic).subscribers) if not is_tool(node)]
    dead = [
        one.topic
        for one in evidence.of(*VELOCITIES)
        if one.topic in order
        and order[one.topic] > order[last.topic]
        and (not one.count or all(is_zero(m) for _, m, _ in one.messages))
    ]
    ahead, _, turning = speed_of([message for _, message, _ in last.messages if not is_zero(message)][-1])
    between = f"; {listed(takers, 2)} passes on nothing but zeros on {listed(dead, 1)}" if dead else ""
    ends_at = takers if dead else [node for node in takers if node in chain.base] or takers
    yield NavFinding(
        rank="stops everything",
        subject=ends_at[0] if ends_at else last.topic,
        cause=f"The robot is commanded to drive and stands{between}."
        if dead
        else f"The robot is commanded to drive and stands: {listed(ends_at, 2)} gets the commands and does not move.",
        proof=f"{named(last.topic)} asks for {ahead:.2f} m/s and {turning:.2f} rad/s at {last.rate_hz:.0f} Hz; "
        f"{named(moving[0].topic)} says 0 m/s.",
        remedy="Check motors, emergency stop, brake and mode of the base; and whether it stands against something.",
    )


def _moves(odometry: Any) -> bool:
    """Whether an odometry message reports motion."""
    speed = odometry.twist.twist
    return (
        abs(float(speed.linear.x)) > _MOVES_M_S
        or abs(float(speed.linear.y)) > _MOVES_M_S
        or abs(float(speed.angular.z)) > _TURNS_RAD_S
    )


CHECK = NavCheck(("heard", "parameters", "diagnostics"), _find, CHAIN)
