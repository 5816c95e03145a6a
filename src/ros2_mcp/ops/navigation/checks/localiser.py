"""No pose of the robot in the map: no localiser runs, it is not active, or it waits for an initial pose."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import LOCALISER, NavCheck
from ros2_mcp.ops.navigation.evidence import GRID, POSE, NavEvidence, NavFinding
from ros2_mcp.ops.navigation.targets import MAP_FRAME

_CALLED = re.compile(r"amcl|mcl|slam|locali[sz]|cartographer|rtabmap|hector|ndt|lio|ekf|ukf|ground_truth|map_odom")
_EDGE = "map → odom"


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    frames = evidence.frames
    if not frames:
        return
    told = [
        edge
        for edge in frames.tree.edges.values()
        if edge.child.rpartition("/")[2] == "odom"
        or (edge.newest and edge.newest.parent.rpartition("/")[2] == MAP_FRAME)
    ]
    is_told = any(not frames.is_stale(edge) for edge in told)
    amcl = evidence.of_role("amcl")
    if is_told or any(not evidence.is_active(node) for node in amcl):
        return  # an inactive localiser is reported by the check of the servers
    if amcl:
        yield from _waits(evidence, amcl[0], was_told=bool(told))
        return
    if told:
        return
    known = [node for node in evidence.nodes if _CALLED.search(node.rpartition("/")[2])]
    if known:
        return  # it runs; the check of the frames reports what is missing
    yield NavFinding(
        rank="stops everything",
        subject=_EDGE,
        cause="No localiser runs: no node localises the robot on the map.",
        proof=f"None of {len(evidence.nodes)} nodes is AMCL, SLAM or the like, and the frame map has no transform in "
        f"{frames.listened_s:.1f} s.",
        remedy="Start AMCL with a map, or slam_toolbox.",
    )


def _waits(evidence: NavEvidence, amcl: str, *, was_told: bool) -> Iterator[NavFinding]:
    poses = [one for one in evidence.of(POSE) if amcl in one.nodes]
    if any(one.count for one in poses):
        if not was_told:
            yield _untold(evidence, amcl)
        return
    had_pose = any(one.kept for one in poses)
    if was_told and had_pose:
        return  # the check of the frames reports how old its transform is
    said = evidence.lines("initial pose", "amcl")
    asks = evidence.value(amcl, "set_initial_pose")
    map_there = any(topic.publishers for topic in evidence.topics(GRID))
    heard = [one for one in (evidence.heard or {}).values() if one.type.endswith("LaserScan") and one.count]
    scans = listed([one.topic for one in heard], 2)
    proof = [f"It is active, {scans} comes, and it publishes no pose and no transform."]
    if had_pose:
        proof.append("Its last pose was published before.")
    if asks is not None:
        proof.append(f"set_initial_pose is {str(asks).lower()}.")
    if said:
        proof.append(f"Its log: «{said[-1].text}».")
    if not heard or not map_there:
        return  # it waits for a scan or a map, which is told of these
    if was_told and asks is not False and not said:
        return  # it published a pose before: that it was started again, and waits, has no proof
    waits = asks is False or said or not had_pose
    yield NavFinding(
        rank="stops everything",
        subject=_EDGE,
        cause=f"{named(amcl)} does not know where the robot is: it waits for /initialpose."
        if waits
        else f"{named(amcl)} does not localise the robot now; it may have been reset, and wait for /initialpose.",
        proof=" ".join(proof),
        remedy="ros2_nav_localize(search=true) finds its pose by the scan and publishes it on /initialpose; for the "
        "next start, set set_initial_pose to true.",
        covers=(_EDGE,),
    )


def _untold(evidence: NavEvidence, amcl: str) -> NavFinding:
    """Return the finding that AMCL publishes poses, and no transform."""
    is_off = evidence.value(amcl, "tf_broadcast") is False
    return NavFinding(
        rank="stops everything",
        subject=_EDGE,
        cause=f"{named(amcl)} publishes the robot's pose, but not the transform {_EDGE}.",
        proof="tf_broadcast is false." if is_off else "Poses came from it, and no such transform on /tf.",
        remedy="Set tf_broadcast to true." if is_off else "Check that its /tf is not remapped.",
        covers=(_EDGE,),
    )


CHECK = NavCheck(("frames", "heard", "states"), _find, LOCALISER)
