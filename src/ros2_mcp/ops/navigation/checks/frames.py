"""Frames: a transform that is no longer published, never published, published by two nodes, or has other frame
names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ros2_mcp.model.names import may_be_one
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import FRAMES, NavCheck
from ros2_mcp.ops.navigation.checks.inputs import silent_inputs
from ros2_mcp.ops.navigation.evidence import ODOMETRY, SCAN, Frames, NavEvidence, NavFinding, is_of_role
from ros2_mcp.ops.navigation.targets import MAP_FRAME
from ros2_mcp.ops.space.tellers import GONE
from ros2_mcp.robot.transforms import TF, TF_STATIC

if TYPE_CHECKING:
    from ros2_mcp.world.frame_edges import Edge

_BASES = ("base_link", "base_footprint")
_NAMES_OF_FRAMES = ("robot_base_frame", "base_frame_id", "global_frame", "odom_frame_id", "local_frame")
_ROLES = (
    *("local_costmap", "global_costmap", "bt_navigator", "behavior_server", "collision_monitor", "amcl"),
    *("docking_server", "slam_toolbox"),
)
_TELLS_TF = ("enable_odom_tf", "publish_odom_tf", "publish_tf", "odom_tf", "broadcast_tf")
_SENSORS = re.compile(r"laser|lidar|scan|velodyne|livox|hokuyo", re.IGNORECASE)
_MOST_NAMES = 4


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    frames = evidence.frames
    if frames is None:
        return
    if not frames.tree.frames:
        yield NavFinding(
            rank="stops everything",
            subject="odom → base",
            cause="There are no transforms at all.",
            proof=f"Nothing came on {TF} and {TF_STATIC} in {frames.listened_s:.1f} s.",
            remedy="Start robot_state_publisher and the base; check ROS_DOMAIN_ID, and the namespace of /tf.",
            covers=("map → odom",),
        )
        return
    for edge in frames.tree.edges.values():
        if edge.two_parents or edge.on_both or len(edge.writers) > 1:
            yield _two_owners(frames, edge)
    yield from _left(evidence, frames)
    yield from _odometry(evidence, frames)
    for edge in frames.tree.edges.values():
        if frames.is_stale(edge) and _is_needed(edge):
            yield _stale(evidence, frames, edge)
    yield from _names(evidence, frames)


def _is_base(frame: str) -> bool:
    return frame.rpartition("/")[2] in _BASES


def _is_needed(edge: Edge) -> bool:
    last = edge.child.rpartition("/")[2]
    return (
        last == "odom"
        or last in _BASES
        or bool(edge.newest and edge.newest.parent.rpartition("/")[2] in ("odom", MAP_FRAME))
    )


def _name(edge: Edge) -> str:
    """The name of an edge, with the names that other checks use for the two that navigation needs."""
    if edge.child.rpartition("/")[2] == "odom":
        return "map → odom"
    if _is_base(edge.child) and edge.newest and edge.newest.parent.rpartition("/")[2] == "odom":
        return "odom → base"
    return f"{named(edge.newest.parent)} → {named(edge.child)}" if edge.newest else named(edge.child)


def _two_owners(frames: Frames, edge: Edge) -> NavFinding:
    parents = edge.parents
    static_by = frames.tellers.on(TF_STATIC, edge, parents[0]) or " or ".join(frames.owners.get(TF_STATIC, ()))
    is_left, left = GONE in static_by or edge.is_left, ""
    is_static_too = bool(edge.static) and bool(edge.moving)
    who = frames.tellers.of(edge) or listed(list(frames.owners.get(TF, ())), _MOST_NAMES)
    if is_static_too:
        moving = frames.tellers.on(TF, edge, edge.moving[-1].parent) or " or ".join(frames.owners.get(TF, ()))
        cause = f"{named(edge.child)} is told twice: as moving by {moving}, and as static by {static_by}."
        remedy = "End the static one (static_transform_publisher)."
        if is_left:
            left = f"; the static one was {static_by.removesuffix(GONE)}'s" if GONE in static_by else ""
            cause = f"{named(edge.child)} was told as static by a node that has gone, and as moving by {moving}."
            remedy = "Its publisher has gone: start the nodes again that heard it, as they keep it."
    elif edge.two_parents:
        cause = f"{named(edge.child)} has two parents: {listed(parents, 3)}."
        told = [f"{named(parent)} → {named(edge.child)}" for parent in parents]
        remedy = f"A frame has one parent: stop publishing {' or '.join(told)}."
    else:
        cause = f"The transform {_name(edge)} is told by two nodes."
        remedy = f"Switch it off at one of both ({who}): two localisers, or simulator and EKF."
    apart = edge.apart
    far = f" What they tell is {apart[0]:.2g} m and {apart[1]:.2g}° apart." if apart else ""
    return NavFinding(
        rank="makes it worse" if is_left or not (_is_needed(edge) or edge.two_parents) else "stops everything",
        subject=_name(edge),
        cause=cause,
        proof=f"It is published by {who}{left}.{far}",
        remedy=remedy,
    )


def _left(evidence: NavEvidence, frames: Frames) -> Iterator[NavFinding]:
    """Static transforms that navigation needs, and that no publisher keeps any more for later subscribers."""
    of_sensors = {one.frame_id for one in evidence.of(SCAN, "sensor_msgs/msg/PointCloud2")}
    for edge in frames.tree.edges.values():
        if not (edge.is_static and edge.is_left and edge.newest and (edge.child in of_sensors or _is_needed(edge))):
            continue
        name = f"{named(edge.newest.parent)} → {named(edge.child)}"
        who = frames.tellers.of(edge).removesuffix(GONE)
        yield NavFinding(
            rank="makes it worse",
            subject=name,
            cause=f"The static transform {name} was published by a node that has gone.",
            proof=f"A new subscription to {TF_STATIC} does not get it{f'; it was that of {who}' if who else ''}. Who "
            "heard it keeps it; who starts now never gets it.",
            remedy="Start its publisher again.",
        )


def _odometry(evidence: NavEvidence, frames: Frames) -> Iterator[NavFinding]:
    """Find odometry that is published without its transform."""
    tree = frames.tree
    if any(_is_base(child) and edge.two_parents for child, edge in tree.edges.items()):
        return  # the other parent hides the transform from odom
    if any(
        _is_base(child) and edge.newest and edge.newest.parent != child and not _is_fixed(edge)
        for child, edge in tree.edges.items()
    ):
        return
    heard = [one for one in evidence.of(ODOMETRY) if one.count and one.newest is not None]
    for one in heard:
        message = one.newest
        parent, child = one.frame_id or "odom", str(message.child_frame_id).lstrip("/")
        if child in tree.edges and tree.find(parent, child):
            return
    if not heard:
        return
    one = heard[0]
    off = _switched_off(evidence)
    yield NavFinding(
        rank="stops everything",
        subject="odom → base",
        cause=f"No node publishes the transform from odom to the base{f': {off[0]}' if off else ''}.",
        proof=f"{named(one.topic)} comes at {one.rate_hz:.3g} Hz from {listed(one.nodes, 2)}, and in "
        f"{frames.listened_s:.1f} s no transform of its frames. {_also(off)}".rstrip(),
        remedy="Set enable_odom_tf (publish_tf) of the base or the EKF to true, or start an EKF.",
        covers=("map → odom",),
    )


def _switched_off(evidence: NavEvidence, owner: str = "") -> list[str]:
    """Return the parameters that keep a node from broadcasting its transform: those of `owner`, if it is given, and
    first those of nodes that publish odometry.
    """
    comes = [node for one in evidence.of(ODOMETRY) if one.count for node in one.nodes]
    nodes = [node for node in evidence.parameters or {} if not owner or node in re.split(r"[ ,]+", owner)]
    return [
        f"{name} of {named(node)} is false"
        for node in sorted(nodes, key=lambda node: node not in comes)
        for name, value in (evidence.parameters or {}).get(node, {}).items()
        if value is False and name.rpartition(".")[2] in _TELLS_TF
    ]


def _also(off: Sequence[str]) -> str:
    return f"Also, {'; '.join(off[1:3])}." if off[1:] else ""


def _is_fixed(edge: Edge) -> bool:
    """Whether the edge joins two base frames, such as base_footprint → base_link: that is no odometry."""
    return bool(edge.newest and _is_base(edge.newest.parent))


def _stale(evidence: NavEvidence, frames: Frames, edge: Edge) -> NavFinding:
    silent_s = frames.silent_ns(edge) / 1e9
    owner = frames.tellers.of(edge).removeprefix("probably ")
    inputs = silent_inputs(evidence, owner) if owner.startswith("/") else []
    is_gone = "gone" in owner
    cause = f"The transform {_name(edge)} is not told any more"
    cause += f": {owner}." if is_gone else f"; {owner} publishes it." if owner else "."
    proof = f"The last one came {silent_s:.1f} s ago."
    odometry_comes = _name(edge) == "odom → base" and any(one.count for one in evidence.of(ODOMETRY))
    off = _switched_off(evidence, owner) if odometry_comes and not is_gone else []
    if off:
        cause = f"Odometry is published, but no node publishes the transform from odom to the base: {off[0]}."
        proof += f" {_also(off)}".rstrip()
    elif inputs:
        cause = f"{cause[:-1]}, and what it waits for is silent: {listed(inputs, 3)}."
    elif owner.startswith("/") and not is_gone:
        proof += " The node is still there." if owner in evidence.nodes else " The node has left."
    fine = [one.topic for one in evidence.of(SCAN) if one.count]
    proof += f" {listed(fine, 2)} comes." if fine else ""
    remedy = f"First find out why {inputs[0]} is silent." if inputs else "Start its publisher again, and read its log."
    if odometry_comes and not off and owner in evidence.nodes and not (evidence.parameters or {}).get(owner):
        proof += " Odometry comes; the node's parameters, such as publish_tf, did not come."
    remedy = "Set it to true again." if off else remedy
    return NavFinding(
        rank="stops everything",
        subject=_name(edge),
        cause=cause,
        proof=proof,
        remedy=remedy,
        covers=["map → odom", *inputs] if _name(edge) == "odom → base" else inputs,
    )


def _names(evidence: NavEvidence, frames: Frames) -> Iterator[NavFinding]:
    """Find frames in Nav2's parameters or in headers of sensor messages that no transform has."""
    known = set(frames.tree.frames)
    wanted: dict[str, list[str]] = {}
    for node in evidence.of_role(*_ROLES):
        for name in _NAMES_OF_FRAMES:
            value = evidence.value(node, name)
            frame = value.lstrip("/") if isinstance(value, str) else ""
            if frame and frame not in known and frame not in (MAP_FRAME, "odom"):
                wanted.setdefault(frame, []).append(f"{name} of {node}")
    for frame, who in wanted.items():
        yield NavFinding(
            rank="stops everything",
            subject=frame,
            cause=f"Nav2 needs the frame {named(frame)}, which no transform has"
            f"{f'; there is {near}' if (near := _near(frame, known)) else ''}.",
            proof=f"It is {listed(who, _MOST_NAMES)}; {len(known)} frames were received in {frames.listened_s:.1f} s.",
            remedy=f"Set it to {near or 'an existing frame'}, or publish a static transform for it.",
            covers=("map → odom", "odom → base") if frame.rpartition("/")[2] in _BASES else (),
        )
    for one in evidence.of(SCAN, "sensor_msgs/msg/PointCloud2"):
        is_read = any(is_of_role(end.node, *_ROLES) for end in evidence.topic(one.topic).subscribers)
        if one.frame_id and one.frame_id not in known and is_read and one.frame_id not in wanted:
            near = _near_sensor(one.frame_id, known)
            yield NavFinding(
                rank="stops everything",
                subject=one.topic,
                cause=f"{named(one.topic)} is in the frame {named(one.frame_id)}, which no transform has"
                f"{f'; there is {near}' if near else ''}.",
                proof=f"{one.count} messages have it in their header; {len(known)} frames are published.",
                remedy=f"Set the driver's frame_id to {near}."
                if near
                else "Publish a static transform from the base to it.",
                covers=("map → odom",),
            )


def _near(frame: str, known: set[str]) -> str:
    """The known frame that is probably meant by an unknown frame; "" if there is no such frame."""
    if frame.rpartition("/")[2] in _BASES:
        for base in sorted(known):
            if _is_base(base):
                return base
    same = [other for other in sorted(known) if other.rpartition("/")[2] == frame.rpartition("/")[2]]
    word = frame.rpartition("/")[2].split("_")[0]
    like = same or [other for other in sorted(known) if may_be_one(frame, other)]
    like = like or [
        other for other in sorted(known) if len(word) > 2 and other.rpartition("/")[2].split("_")[0] == word
    ]
    return like[0] if like else ""


def _near_sensor(frame: str, known: set[str]) -> str:
    """The known frame that is probably meant by a sensor's unknown frame; "" if there is no such frame, or several. No
    sensor is in the frame of the base itself."""
    others = {other for other in known if not _is_base(other)}
    sensors = [other for other in sorted(others) if _SENSORS.search(other) and not other.endswith("_optical")]
    return _near(frame, others) or (sensors[0] if len(sensors) == 1 else "")


CHECK = NavCheck(("frames", "heard", "parameters"), _find, FRAMES)
