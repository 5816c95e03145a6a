"""Clocks: computers whose clocks differ, and nodes whose use_sim_time differs from the others'."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import CLOCKS, NavCheck
from ros2_mcp.ops.navigation.evidence import ODOMETRY, ROLES, SCAN, NavEvidence, NavFinding, is_of_role, is_tool

if TYPE_CHECKING:
    from ros2_mcp.world.frame_edges import Edge

_CLOCK = "/clock"
_BEHIND_S, _AHEAD_S = 1.0, 0.2
"""Larger than the delays of networks and drivers. A delay never makes a stamp lie in the future; only AMCL does so, on
purpose."""
_STEADY_S = 0.4
"""A clock offset is the same in each message; a delay varies by more than this."""
_OTHER_TIME_S = 1e6
_MOST_TOLERANCE_S = 2.5
"""AMCL stamps ahead of the scan by its transform_tolerance (default: 1 s)."""
_LEAST, _LEAST_MESSAGES = 3, 8
"""Least number of transforms, and of messages of a topic: on a loaded machine a few may all be late."""
_MOST_NAMES = 6
_SYNC = "Synchronise the clocks of the robot's computers (chrony or NTP); if they agree, its driver's stamps are"


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    yield from _simulated(evidence)
    yield from _offsets(evidence)


def _simulated(evidence: NavEvidence) -> Iterator[NavFinding]:
    clocks = {one.node for one in evidence.topic(_CLOCK).publishers}
    simulated, by_wall = list[str](), list[str]()
    for node, values in (evidence.parameters or {}).items():
        value = values.get("use_sim_time")
        if node not in clocks and not is_tool(node) and isinstance(value, bool):
            (simulated if value else by_wall).append(node)
    if simulated and not clocks:
        yield NavFinding(
            rank="stops everything",
            subject=simulated[0],
            cause=f"{listed(simulated, _MOST_NAMES)} {'runs' if len(simulated) == 1 else 'run'} on simulated time, "
            "which stands still: /clock has no publisher.",
            proof=f"use_sim_time is true at {listed(simulated, _MOST_NAMES)}, and false at {len(by_wall)} others.",
            remedy="Set use_sim_time to false on a real robot, or start what publishes /clock.",
            covers=("map → odom", "odom → base", *_published_by(evidence, simulated)),
        )
    elif simulated and by_wall:
        fewer, more = sorted((by_wall, simulated), key=len)
        runs = "wall time" if fewer is by_wall else "simulated time"
        yield NavFinding(
            rank="stops everything",
            subject=fewer[0],
            cause=f"{listed(fewer, _MOST_NAMES)} {'runs' if len(fewer) == 1 else 'run'} on {runs}, the others do not.",
            proof=f"use_sim_time is {str(fewer is simulated).lower()} there, and {str(more is simulated).lower()} at "
            f"{len(more)} nodes.",
            remedy="Give all nodes the same use_sim_time, and start them again.",
            covers=("map → odom", "odom → base", *_published_by(evidence, fewer)),
        )


def _published_by(evidence: NavEvidence, nodes: Collection[str]) -> list[str]:
    """Return the topics on which one of these nodes publishes: their stamps are of another time."""
    return [name for name, topic in evidence.graph.topics.items() if any(one.node in nodes for one in topic.publishers)]


def _offsets(evidence: NavEvidence) -> Iterator[NavFinding]:
    """Find topics and transforms whose stamps have a constant offset, while others have none."""
    offsets = dict(_of_topics(evidence))
    offsets |= _of_transforms(evidence)
    plain = {what: s for what, s in offsets.items() if abs(s) < _OTHER_TIME_S}
    plain_of, follows = plain, _of_localiser(evidence, plain)
    plain = {what: s for what, s in plain.items() if what not in follows}
    late = _come_late(evidence, plain)
    plain = {what: s for what, s in plain.items() if what not in late}
    off = {what: s for what, s in plain.items() if s > _BEHIND_S or s < -_AHEAD_S}
    is_alike = len(off) == len(plain) > 1 and max(off.values()) - min(off.values()) < _STEADY_S
    if not off or is_alike:  # all alike: the clock of the bridge's own computer differs, which need not be the robot's
        return
    groups: list[dict[str, float]] = []
    for what, seconds in sorted(off.items(), key=lambda pair: pair[1]):
        if groups and seconds - max(groups[-1].values()) < _STEADY_S:
            groups[-1][what] = seconds
        else:
            groups.append({what: seconds})
    fine = [what for what in plain if what not in off]
    for group in groups:
        middle = sorted(group.values())[len(group) // 2]
        way = "behind" if middle > 0 else "ahead of"
        beside = f", and not so {listed(fine, 3)}" if fine else ""
        after = [what for what, scan in follows.items() if scan in group]
        if after:
            beside += f"; that of {listed(after, 2)} ({plain_of[after[0]]:+.2f} s) follows from it: a localiser takes "
            beside += "the scan's stamp, and adds its transform_tolerance"
        yield NavFinding(
            rank="stops everything",
            subject=next(iter(group)),
            cause=f"The stamps of {listed(list(group), _MOST_NAMES)} are {abs(middle):.2f} s {way} the others, always: "
            "the clocks differ.",
            proof=f"Receipt minus stamp is {middle:+.2f} s, the least of {len(group)} series{beside}.",
            remedy=f"{_SYNC} {'late' if middle > 0 else 'ahead'}.",
            covers=[*group, *after, *_follows(group)],
        )


def _of_localiser(evidence: NavEvidence, offsets: Mapping[str, float]) -> dict[str, str]:
    """Return the transforms to odom whose offset is due to a scan with a wrong offset, each with that scan: the
    localiser stamps them with the stamp of the scan, or with a tolerance added to it.
    """
    scans = {
        one.topic: offsets[one.topic]
        for one in evidence.of(SCAN)
        if one.topic in offsets and not -_AHEAD_S <= offsets[one.topic] <= _BEHIND_S
    }
    found: dict[str, str] = {}
    for name in _to_odom(evidence):
        for topic, seconds in scans.items():
            if name in offsets and -_STEADY_S < seconds - offsets[name] < _MOST_TOLERANCE_S + _STEADY_S:
                found[name] = topic
    return found


def _come_late(evidence: NavEvidence, offsets: Mapping[str, float]) -> set[str]:
    """Return the odometry topics that arrive late although a transform with the same stamps arrives in time: no clock
    is wrong.
    """
    found = set[str]()
    edges = evidence.frames.tree.edges.values() if evidence.frames else ()
    for one in evidence.of(ODOMETRY):
        if offsets.get(one.topic, 0.0) <= _BEHIND_S:
            continue
        stamps = {
            header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
            for _, message, _ in one.messages
            if (header := getattr(message, "header", None))
        }
        for edge in edges:
            is_same = any(told.stamp_ns in stamps for told in edge.moving)
            if is_same and abs(offsets.get(_named(edge), _BEHIND_S)) < _AHEAD_S:
                found.add(one.topic)
    return found


def _to_odom(evidence: NavEvidence) -> list[str]:
    edges = evidence.frames.tree.edges.values() if evidence.frames else ()
    return [_named(edge) for edge in edges if edge.moving and edge.child.rpartition("/")[2] == "odom"]


def _named(edge: Edge) -> str:
    return f"{named(edge.moving[-1].parent)} → {named(edge.child)}"


def _follows(group: Mapping[str, float]) -> list[str]:
    is_of_base = any("odom" in what for what in group)
    return ["odom → base", "map → odom"] if is_of_base else ["map → odom"]


def _of_topics(evidence: NavEvidence) -> Iterator[tuple[str, float]]:
    for topic, heard in (evidence.heard or {}).items():
        if len(heard.ages_s) < _LEAST_MESSAGES or all(is_of_role(node, *ROLES) for node in heard.nodes):
            continue  # what Nav2 itself publishes has the stamps of what it received
        least, most = min(heard.ages_s), max(heard.ages_s)
        # A loaded machine delays some of the messages; a clock offset shifts all of them.
        if most - least < _STEADY_S or least < -_AHEAD_S or least > _BEHIND_S:
            yield topic, least if least > -_AHEAD_S else most


def _of_transforms(evidence: NavEvidence) -> dict[str, float]:
    """Return the offset of the stamps of each moving transform in s (receipt minus stamp). A localiser may stamp its
    transform in the future, which is skipped."""
    found: dict[str, float] = {}
    if not evidence.frames:
        return found
    for edge in evidence.frames.tree.edges.values():
        if len(edge.moving) < _LEAST or evidence.frames.is_stale(edge):
            continue
        lags = [(told.received_ns - told.stamp_ns) / 1e9 for told in edge.moving[-30:]]
        name = _named(edge)
        if edge.child.rpartition("/")[2] == "odom" and -_MOST_TOLERANCE_S < min(lags) < 0:
            continue
        found[name] = min(lags) if min(lags) > -_AHEAD_S else max(lags)
    return found


CHECK = NavCheck(("parameters", "heard", "frames"), _find, CLOCKS)
