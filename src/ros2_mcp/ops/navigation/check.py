"""`ros2_nav_check`: find out why the robot does not navigate, without sending a goal. It only reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.nav2 import COSTMAPS
from ros2_mcp.model.text import counted, named
from ros2_mcp.ops.navigation.checks import NEEDS, nav_findings_in, not_checked
from ros2_mcp.ops.navigation.checks.command_chain import chain_of
from ros2_mcp.ops.navigation.checks.fit import deviation_m
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
_ONLY_MOTION_SHOWS = "Only a motion shows how the lidar is turned and how odometry counts (ros2_nav_probe), and rates."
_MOST = 8
"""Number of findings that are reported in full; a user with more begins with the first of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NavChecked:
    """What keeps the robot from navigating, the worst first; each with its cause, its proof and a remedy.

    `FINE` means that nothing was found and all the evidence was read; `NOT KNOWN` that some of it could not be read:
    `unread` says what, and why. `seen` has the figures behind the verdict, `not_checked` the checks that could not be
    run.
    """

    verdict: Verdict = field(metadata=SAID)
    findings: Sequence[NavFinding] = field(metadata=SAID)
    servers: str = field(metadata=SAID)
    seen: Sequence[str] = field(metadata=SAID)
    unread: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    not_checked: Sequence[str] = field(metadata={**IF_ANY, **SAID})

    def summary(self) -> list[str]:
        """Return the verdict, one line per finding, and the measured figures."""
        what = "nothing found that keeps the robot from navigating" if not self.findings else "why, the worst first"
        missing = f"not read: {'; '.join(self.unread)}"
        lines = [f"{self.verdict}: {missing if self.verdict == 'NOT KNOWN' else what}."]
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
        NotFound: for an unknown place, or without Nav2.
        LinkError: if there is no bridge.
    """
    target = None
    if to is not None:
        targets = targets_of(to, places_of(robot))
        if len(targets) != 1:
            raise BadInput("ros2_nav_check checks one goal, not several.", "Give one.")
        target = targets[0]
    robot.log.start()
    evidence, missed = await read_evidence(robot, NEEDS, target, action)
    if not evidence.is_nav2:
        raise await robot.graph.missing(
            "There is no Nav2: no bt_navigator, planner_server, controller_server or lifecycle manager is seen.",
            "Start Nav2; ros2_node_list shows what runs.",
        )
    return judged(evidence, missed)


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
    if (deviation := deviation_m(evidence)) is not None:
        lines.append(f"Standard deviation of the position by localisation: {deviation:.2f} m")
    if evidence.parameters is not None:
        lines.append(f"Parameters of {counted(len(evidence.parameters), 'node')} read")
    return lines
