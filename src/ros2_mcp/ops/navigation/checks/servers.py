"""Nav2's servers: the first server that failed, in the order of the lifecycle manager, with its log."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.ops.log.read import LogLine
from ros2_mcp.ops.navigation.checks.check import SERVERS, NavCheck
from ros2_mcp.ops.navigation.evidence import ROLES, NavEvidence, NavFinding, is_of_role, line_age_s, said

_LOCALISES = ("amcl", "map_server", "slam_toolbox")
_LOST = re.compile(
    r"SERVER (\S+) IS DOWN|not received a heartbeat from (\S+?)\.?(?:\s|$)|(\S+) was unable to be reached"
)
_UP = re.compile(r"Managed nodes (are active|have been paused)|Pausing managed nodes", re.IGNORECASE)
"""Lines of a lifecycle manager when all nodes are active again, or were paused on request: its earlier lines are
obsolete."""
_IGNORED = re.compile(r"Message Filter dropping|missed its desired rate|desired rate of", re.IGNORECASE)
"""Lines that explain nothing: lines of the first seconds, and a warning that is often false."""
_HOSTS = {"global_costmap": "planner_server", "local_costmap": "controller_server"}
_OLD_PLUGIN = re.compile(r"\w+/\w+")
_MOST_NAMES = 8
_SLOW_S = 900.0


def of_localisation(evidence: NavEvidence) -> Iterator[NavFinding]:
    """Find faults of the servers of localisation."""
    yield from _find(evidence, of_localisation=True)


def of_navigation(evidence: NavEvidence) -> Iterator[NavFinding]:
    """Find faults of all other servers."""
    yield from _find(evidence, of_localisation=False)


def _find(evidence: NavEvidence, *, of_localisation: bool) -> Iterator[NavFinding]:
    managed = {supervisor: nodes for supervisor in evidence.supervisors if (nodes := evidence.managed(supervisor))}
    for supervisor, nodes in managed.items():
        if any(is_of_role(node, *_LOCALISES) for node in nodes) == of_localisation:
            yield from _of_supervisor(evidence, supervisor, nodes)
    supervised = {node for nodes in managed.values() for node in nodes}
    alone = [
        node
        for node in (*evidence.of_role(*ROLES), *evidence.graph.left.nodes)
        if node not in supervised and is_of_role(node, *ROLES) and is_of_role(node, *_LOCALISES) == of_localisation
    ]
    yield from _unmanaged(evidence, alone)
    if not of_localisation and not managed:
        yield from _missing(evidence)


def _of_supervisor(evidence: NavEvidence, supervisor: str, nodes: Sequence[str]) -> Iterator[NavFinding]:
    """Yield the findings on one lifecycle manager; they cover the manager's own diagnostics, which report the same
    fault."""
    for finding in _by_supervisor(evidence, supervisor, nodes):
        yield replace(finding, covers=[*finding.covers, *([supervisor] if finding.subject != supervisor else [])])


def _by_supervisor(evidence: NavEvidence, supervisor: str, nodes: Sequence[str]) -> Iterator[NavFinding]:
    states = evidence.states or {}
    absent = [node for node in nodes if node not in states and node not in evidence.nodes]
    hung = [node for node in nodes if states.get(node) == ""]
    idle = [node for node in nodes if states.get(node) not in (None, "", "active")]
    if not (absent or hung or idle):
        return
    lost = _lost(evidence, supervisor, nodes)
    if lost or ((absent or hung) and not _waits(evidence, nodes, absent, idle)):
        yield _down(evidence, supervisor, nodes, lost, absent, hung, idle)
        return
    if absent:
        first = absent[0]
        yield NavFinding(
            rank="stops everything",
            subject=first,
            cause=f"{named(supervisor)} waits for {named(first)}, which does not run: it has brought nothing up.",
            proof=f"node_names has {counted(len(nodes), 'node')}; no node offers {named(first)}/get_state, and "
            f"{counted(len(idle), 'other')} {'is' if len(idle) == 1 else 'are'} not active.",
            remedy=f"Start {named(first)}, or take it out of node_names of {named(supervisor)}.",
            covers=_covered(nodes),
        )
        return
    yield _not_brought_up(evidence, supervisor, nodes, idle)


def _waits(evidence: NavEvidence, nodes: Sequence[str], absent: Sequence[str], idle: Sequence[str]) -> bool:
    """Whether the manager never brought up its nodes because one of them never started."""
    never = [node for node in absent if node not in evidence.graph.left.nodes]
    active = [node for node in nodes if (evidence.states or {}).get(node) == "active"]
    return bool(never) and not active and bool(idle)


def _lost(evidence: NavEvidence, supervisor: str, nodes: Sequence[str]) -> tuple[str, LogLine] | None:
    """Return the server whose heartbeat the manager missed last, and that line of its log; None if all are active
    again."""
    for line in reversed(evidence.log or ()):
        if line.node.rpartition("/")[2] != supervisor.rpartition("/")[2]:
            continue
        if _UP.search(line.text):
            return None
        if not (found := _LOST.search(line.text)):
            continue
        name = next(filter(None, found.groups())).strip("/")
        server = next((node for node in nodes if node.rpartition("/")[2] == name.rpartition("/")[2]), "")
        if server:
            return server, line
    return None


def _down(
    evidence: NavEvidence,
    supervisor: str,
    nodes: Sequence[str],
    lost: tuple[str, LogLine] | None,
    absent: Sequence[str],
    hung: Sequence[str],
    idle: Sequence[str],
) -> NavFinding:
    first = lost[0] if lost else [*absent, *hung][0]
    fate = (
        "died"
        if first in absent and (lost or idle)
        else "has left the graph: it died, or is not seen any more"
        if first in absent
        else "died, or hangs: it answers nothing"
        if first in hung
        else "missed its heartbeat, and lives"
    )
    others = [node for node in idle if node != first]
    took = f"; {named(supervisor)} took {counted(len(others), 'other')} down" if others else ""
    age_s = line_age_s(evidence, lost[1]) if lost else None
    since = f" since {age_s:.0f} s" if age_s is not None and age_s < _SLOW_S else ""
    lines = [line for line in _lines(evidence, first) if line.level in ("ERROR", "FATAL")]
    proof = [f"{named(first)} {_seen(evidence, first)}."]
    proof += [f"{said(lost[1])}."] if lost else []
    proof += [f"Before that {said(lines[-1])}."] if lines and not lost else []
    up = f"then bring the stack up with {named(supervisor)}/manage_nodes"
    remedy = f"Start {named(first)} again (its log says why it ended), {up}."
    if first not in absent and first not in hung:
        remedy = (
            "Bring the stack up again; if nobody restarted it, find out what starves it (load of the computer), or "
            "raise bond_timeout."
        )
    elif first in hung:
        remedy = f"Start {named(first)} again, and end it first if it still runs; {up}."
    is_alone = not others and not lost
    return NavFinding(
        rank="stops everything",
        subject=first,
        cause=f"{named(first)} {fate}." if is_alone else f"Nav2 is down{since}: {named(first)} {fate}{took}.",
        proof=" ".join(proof),
        remedy=remedy,
        covers=[node for node in _covered(nodes) if node != first],
    )


def _seen(evidence: NavEvidence, node: str) -> str:
    state = (evidence.states or {}).get(node)
    if state == "":
        return "is in the graph, and does not answer"
    if state:
        return f"is {state}"
    return "has left the graph" if node in evidence.graph.left.nodes else "is not in the graph"


def _not_brought_up(evidence: NavEvidence, supervisor: str, nodes: Sequence[str], idle: Sequence[str]) -> NavFinding:
    states = evidence.states or {}
    unconfigured = [node for node in idle if states[node] in ("unconfigured", "finalized")]
    first = (unconfigured or idle)[0]
    errors = [line for node in idle for line in _lines(evidence, node) if line.level in ("ERROR", "FATAL")]
    own = [line for line in _lines(evidence, first) if line.level in ("ERROR", "FATAL")] or errors[:1]
    if own and not _lines(evidence, first):
        first = next((node for node in idle if own[0] in _lines(evidence, node)), first)
    after = [node for node in idle if node != first]
    is_all = len(idle) == len(nodes)
    old = _old_plugins(evidence, first)
    if is_all and not own and not old:
        same = {states[node] for node in idle}
        paused = same == {"inactive"}
        autostart = evidence.value(supervisor, "autostart")
        how = "paused, or never activated" if paused else "not started"
        said_so = f" autostart of {named(supervisor)} is false." if autostart is False else ""
        return NavFinding(
            rank="stops everything",
            subject=supervisor,
            cause=f"The whole stack is {how}: none of its {len(nodes)} servers is active.",
            proof=f"{listed(list(nodes), _MOST_NAMES)}: {', '.join(sorted(same))}.{said_so}",
            remedy=f'ros2_nav_recover(stack="{"resume" if paused else "up"}"), or {named(supervisor)}/manage_nodes '
            f"with command {'2 (RESUME)' if paused else '0 (STARTUP)'}.",
            covers=_covered(nodes),
        )
    waits = (
        f"; {counted(len(after), 'other')} only {'waits' if len(after) == 1 else 'wait'}"
        if after and not is_all
        else ""
    )
    waits = f"; the {len(after)} others only wait" if after and is_all else waits
    proof = [f"{said(own[0])}."] if own else [f"It is {states[first]}, the first in the order of {named(supervisor)}."]
    proof += [
        f"The plugin {value} ({name}) has the form of an older distribution, with / instead of ::."
        for name, value in old[:1]
    ]
    return NavFinding(
        rank="stops everything",
        subject=first,
        cause=f"{named(first)} is {states[first]}{' since it failed to come up' if own or old else ''}{waits}.",
        proof=" ".join(proof),
        remedy=f"Set {old[0][0]} to {old[0][1].replace('/', '::')}, and bring the stack up again."
        if old
        else "Correct what its log says, and bring the stack up again."
        if own
        else f"Activate it with ros2_lifecycle_change; or bring all up with {named(supervisor)}/manage_nodes.",
        covers=[node for node in _covered(nodes) if node != first],
    )


def _old_plugins(evidence: NavEvidence, node: str) -> list[tuple[str, str]]:
    """Return the parameters of a node, with their values, that name a plugin with a slash instead of "::": newer
    distributions refuse a slash."""
    values = {
        name: value for name, value in (evidence.parameters or {}).get(node, {}).items() if isinstance(value, str)
    }
    return [(name, value) for name, value in values.items() if name.endswith("plugin") and _OLD_PLUGIN.fullmatch(value)]


def _lines(evidence: NavEvidence, node: str) -> list[LogLine]:
    """Return a node's warnings and errors since its manager last activated all nodes, without lines that explain
    nothing."""
    supervisors = [
        supervisor.rpartition("/")[2] for supervisor in evidence.supervisors if node in evidence.managed(supervisor)
    ]
    log = evidence.log or ()
    ups = [n for n, line in enumerate(log) if line.node.rpartition("/")[2] in supervisors and _UP.search(line.text)]
    since = ups[-1] if ups else 0
    return [line for line in log[since:] if line.node == node and not _IGNORED.search(line.text)]


def _covered(nodes: Sequence[str]) -> list[str]:
    """Return the subjects of findings that follow from nodes that are down."""
    return [*nodes, *(["map → odom"] if any(is_of_role(node, "amcl", "slam_toolbox") for node in nodes) else [])]


def _unmanaged(evidence: NavEvidence, nodes: Sequence[str]) -> Iterator[NavFinding]:
    states = evidence.states or {}
    gone = [node for node in nodes if node in evidence.graph.left.nodes]
    if len(gone) > 1:
        yield NavFinding(
            rank="stops everything",
            subject=gone[0],
            cause=f"{len(gone)} nodes of Nav2 have left: {listed(gone, _MOST_NAMES)}.",
            proof="They were there earlier in this session, and so was their manager, if any.",
            remedy="Start Nav2 again; ros2_log_read may show why it ended.",
            covers=_covered(gone)[1:],
        )
    # Managers that are busy themselves do not say whom they manage: what is asked then is late everywhere.
    unread = [one for one in evidence.supervisors if evidence.value(one, "node_names") is None]
    silent = [node for node in nodes if states.get(node) == "" and node not in gone] if unread else []
    if len(silent) > 1:
        yield NavFinding(
            rank="stops everything",
            subject=silent[0],
            cause=f"{len(silent)} servers of Nav2 do not answer: {listed(silent, _MOST_NAMES)}. They hang, or the "
            "computer is too busy.",
            proof=f"They are in the graph; {listed(unread, _MOST_NAMES)} did not answer either.",
            remedy="See what loads the robot's computer (top), and ask again; what hangs must be started again.",
            covers=_covered(silent)[1:],
        )
    no_names = f"{listed(unread, _MOST_NAMES)} did not answer either" if unread else "no manager has it in node_names"
    for node in nodes:
        state = states.get(node)
        is_gone = node in gone
        if (is_gone and len(gone) > 1) or (not is_gone and state in (None, "active")):
            continue
        if (state == "" and len(silent) > 1) or _falls_with_its_host(evidence, node):
            continue
        lines = [line for line in _lines(evidence, node) if line.level in ("ERROR", "FATAL")]
        hangs = f"{named(node)} hangs: it does not answer."
        yield NavFinding(
            rank="stops everything",
            subject=node,
            cause=f"{named(node)} has left." if is_gone else hangs if state == "" else f"{named(node)} is {state}.",
            proof=f"{said(lines[-1])}." if lines else f"It {_seen(evidence, node)}; {no_names}.",
            remedy="Start it again." if is_gone or state == "" else "Activate it: ros2_lifecycle_change.",
            covers=_covered([node])[1:],
        )


def _falls_with_its_host(evidence: NavEvidence, node: str) -> bool:
    """Whether a costmap's server is not active: the costmap is a part of its process."""
    role = next((role for part, role in _HOSTS.items() if is_of_role(node, part)), "")
    if not role:
        return False
    has_left = any(is_of_role(one, role) for one in evidence.graph.left.nodes)
    return has_left or not all(map(evidence.is_active, evidence.of_role(role)))


def _missing(evidence: NavEvidence) -> Iterator[NavFinding]:
    """Find a server that bt_navigator needs and that was never seen: it ended before this session, as did its
    manager."""
    offered = {
        name.rpartition("/_action/")[0] for name in evidence.graph.services or () if "/_action/send_goal" in name
    }
    if not evidence.of_role("bt_navigator"):
        return
    for role, action in (("planner_server", "compute_path_to_pose"), ("controller_server", "follow_path")):
        is_offered = any(name.rpartition("/")[2] == action for name in offered)
        if (
            not evidence.of_role(role)
            and not is_offered
            and not any(is_of_role(one, role) for one in evidence.graph.left.nodes)
        ):
            yield NavFinding(
                rank="stops everything",
                subject=role,
                cause=f"There is no {role}: no node offers {action}, which bt_navigator calls.",
                proof=f"No node of that name among {len(evidence.nodes)}, and no lifecycle manager.",
                remedy=f"Start {role}, and its lifecycle manager.",
            )


CHECK = NavCheck(("states", "parameters", "log"), of_navigation, SERVERS)
