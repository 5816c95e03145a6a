"""`ros2_nav_check`: find out why the robot does not navigate, without sending a goal. It only reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, cast

from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.nav2 import COSTMAPS
from ros2_mcp.model.text import counted, named, quoted
from ros2_mcp.ops.navigation.checks import NEEDS, nav_findings_in, not_checked
from ros2_mcp.ops.navigation.checks.command_chain import chain_of
from ros2_mcp.ops.navigation.evidence import ODOMETRY, SCAN, NavEvidence, NavFinding
from ros2_mcp.ops.navigation.known_places import places_of
from ros2_mcp.ops.navigation.readers import read_evidence
from ros2_mcp.ops.navigation.targets import targets_of
from ros2_mcp.ops.navigation.unread import unread_in
from ros2_mcp.ops.results.results import IF_ANY, SAID
from ros2_mcp.robot import Robot

Verdict = Literal["FINE", "NOT KNOWN", "STOPPED", "SOME GOALS FAIL", "IMPAIRED"]
_VERDICTS: dict[str, Verdict] = {
    "stops everything": "STOPPED",
    "stops some goals": "SOME GOALS FAIL",
    "makes it worse": "IMPAIRED",
}
_ONLY_MOTION_SHOWS = (
    "Not seen while it stands: how the lidar is mounted, and how odometry counts (ros2_nav_probe moves a little)."
)
_DOCKING = "docking_server"
_MOST = 8
"""Number of findings that are reported in full; a user with more begins with the first of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NavChecked:
    """What keeps the robot from navigating, the worst first; each with its cause, its proof and a remedy.

    `FINE` means that nothing was found and all the evidence was read; `NOT KNOWN` that some of it could not be read:
    `unread` says what, and why. `seen` has the figures behind the verdict, `not_checked` the checks that could not be
    run, `note` why a goal was not checked.
    """

    verdict: Verdict = field(metadata=SAID)
    findings: Sequence[NavFinding] = field(metadata=SAID)
    servers: str = field(metadata=SAID)
    seen: Sequence[str] = field(metadata=SAID)
    unread: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    not_checked: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    note: str = field(default="", metadata={**IF_ANY, **SAID})

    def summary(self) -> list[str]:
        """Return the verdict, one line per finding, and the measured figures."""
        what = "nothing found that keeps the robot from navigating" if not self.findings else "why, the worst first"
        missing = f"not read: {'; '.join(self.unread)}"
        lines = [f"{self.verdict}: {missing if self.verdict == 'NOT KNOWN' else what}. {self.note}".rstrip()]
        for number, one in enumerate(self.findings, 1):
            lines.append(f"{number}. {one.rank}: {one.cause} Proof: {one.proof} Remedy: {one.remedy}")
        lines.append(" ".join([f"{self.servers}.", *(f"{line}." for line in self.seen)]))
        if not self.findings:
            lines.append(_ONLY_MOTION_SHOWS)
        if self.unread and self.verdict != "NOT KNOWN":
            lines.append(f"{missing[:1].upper()}{missing[1:]}.")
        if self.not_checked:
            lines.append(f"Not checked: {', '.join(self.not_checked)}.")
        return lines


async def check_navigation(robot: Robot, to: object = None, action: str = "") -> NavChecked:
    """Read the evidence for all checks, in parallel, and run the checks; no goal is sent.

    Raises:
        BadInput: for a malformed place, or several places.
        NotFound: without Nav2.
        LinkError: if there is no bridge.
    """
    target, unknown = None, ""
    if to is not None:
        try:
            targets = targets_of(to, places_of(robot))
        except NotFound as error:  # why the robot does not go need not depend on the goal
            targets, unknown = (), error.message
        if not unknown and len(targets) != 1:
            raise BadInput("ros2_nav_check checks one goal, not several.", "Give one.")
        target = next(iter(targets), None)
    robot.log.start()
    evidence, missed = await read_evidence(robot, NEEDS, target, action)
    if not evidence.is_nav2:
        raise await robot.graph.missing(
            "There is no Nav2: no bt_navigator, planner_server, controller_server or lifecycle manager is seen.",
            "Start Nav2; ros2_node_list shows what runs.",
        )
    checked = judged(evidence, missed)
    if not unknown:
        return checked
    return replace(checked, note=f"The goal was not checked: {unknown}{_dock_meant(evidence, to)}")


def _dock_meant(evidence: NavEvidence, to: object) -> str:
    """Say that the given name is that of a dock; "" if it is not."""
    name = str(cast("Mapping[str, object]", to).get("place") if isinstance(to, Mapping) else to).strip()
    is_dock = any(name in _docks(evidence, node) for node in evidence.of_role(_DOCKING))
    return f' {quoted(name)} is a dock: ros2_nav_dock(dock="{name}").' if is_dock else ""


def _docks(evidence: NavEvidence, node: str) -> list[str]:
    found = evidence.value(node, "docks")
    return [str(name) for name in cast("Sequence[object]", found)] if isinstance(found, (list, tuple)) else []


def _at(pose: object) -> str:
    """Say where a dock is; "" if its pose is not among the parameters."""
    numbers = cast("Sequence[object]", pose)[:2] if isinstance(pose, (list, tuple)) else ()
    at = [f"{one:.2f}" for one in numbers if isinstance(one, (int, float))]
    return f" at ({', '.join(at)})" if len(at) == 2 else ""


def judged(evidence: NavEvidence, missed: Mapping[str, str] | None = None) -> NavChecked:
    """Return the verdict on the evidence. `missed` has the parts that could not be read, each with the reason."""
    findings = nav_findings_in(evidence)
    unread = unread_in(evidence, missed)
    verdict: Verdict = _VERDICTS[findings[0].rank] if findings else "FINE"
    return NavChecked(
        verdict="NOT KNOWN" if unread and verdict in ("FINE", "IMPAIRED") else verdict,
        findings=findings[:_MOST],
        servers=servers_in_words(evidence),
        seen=_seen(evidence),
        unread=unread,
        not_checked=sorted(not_checked(evidence)),
    )


def servers_in_words(evidence: NavEvidence) -> str:
    """Say how many of Nav2's servers are active."""
    managed = [node for supervisor in evidence.supervisors for node in evidence.managed(supervisor)]
    servers = list(dict.fromkeys(managed)) or [
        node
        for node in evidence.robots_nodes
        if node in (evidence.states or {}) and node.rpartition("/")[2] not in COSTMAPS
    ]
    if evidence.states is None or not servers:
        return "Nav2: the states of its servers are not known"
    active = [node for node in servers if evidence.states.get(node) == "active"]
    return f"Nav2: {len(active)} of {len(servers)} active"


def _seen(evidence: NavEvidence) -> list[str]:
    """Return the figures that support the verdict: rates, ages of transforms, command chain, deviation."""
    lines: list[str] = []
    flows = [f"{named(one.topic)} {one.rate_hz:.3g} Hz" for one in evidence.of(SCAN, ODOMETRY)[:4] if one.count]
    if flows:
        lines.append(", ".join(flows))
    if frames := evidence.frames:
        ages = [
            f"{named(edge.moving[-1].parent)} → {named(edge.child)} {frames.silent_ns(edge) / 1e9:.1f} s ago"
            for edge in frames.tree.edges.values()
            if edge.moving and edge.moving[-1].parent.rpartition("/")[2] in ("map", "odom")
        ]
        lines += [f"Last told: {', '.join(ages[:3])}"] if ages else []
    chain = chain_of(evidence)
    if chain.nodes:
        lines.append(f"Commands: {' → '.join(named(node) for node in chain.nodes[:6])}")
    docks = [
        f"{named(name)}{_at(evidence.value(node, f'{name}.pose'))}"
        for node in evidence.of_role(_DOCKING)
        for name in _docks(evidence, node)
    ]
    if docks:
        lines.append(f"Docks: {', '.join(docks[:_MOST])}{' and more' if len(docks) > _MOST else ''}")
    if evidence.parameters is not None:
        lines.append(f"Parameters of {counted(len(evidence.parameters), 'node')} read")
    return lines
