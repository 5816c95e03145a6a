"""Nav2's sensor inputs: topics that are silent or published under another name, and sensors whose points are
ignored."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import SENSORS as PLACE
from ros2_mcp.ops.navigation.checks.check import NavCheck
from ros2_mcp.ops.navigation.evidence import ODOMETRY, SENSORS, NavEvidence, NavFinding, is_of_role, nodes_of
from ros2_mcp.ops.topics.info import mismatches
from ros2_mcp.robot import TopicEndpoints

_READERS = ("local_costmap", "global_costmap", "amcl", "slam_toolbox")
_NEEDS_ODOMETRY = ("controller_server", "bt_navigator", "velocity_smoother", "behavior_server")
_INPUTS = ("sensor_msgs/msg/Imu", ODOMETRY, "geometry_msgs/msg/TwistWithCovarianceStamped", *SENSORS)
_MOST_NAMES = 4


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    for topic in evidence.topics(*SENSORS, ODOMETRY):
        roles = _NEEDS_ODOMETRY if ODOMETRY in topic.types else _READERS
        readers = [one for one in topic.subscribers if is_of_role(one.node, *roles)]
        if not readers:
            continue
        who = listed(nodes_of(readers), _MOST_NAMES)
        if not topic.publishers:
            yield _absent(evidence, topic, who)
        elif (heard := (evidence.heard or {}).get(topic.topic)) and heard.is_silent:
            yield _silent(evidence, topic, who)
        elif found := mismatches(topic.publishers, readers):
            yield NavFinding(
                rank="stops everything" if len(found) >= len(readers) else "stops some goals",
                subject=topic.topic,
                cause=f"{named(topic.topic)} does not reach {who}: the endpoints do not match.",
                proof=" ".join(found[:2]),
                remedy="Give both the same type and compatible QoS.",
            )
    yield from _heights(evidence)


def _absent(evidence: NavEvidence, topic: TopicEndpoints, who: str) -> NavFinding:
    gone = evidence.graph.left.topics.get(topic.topic, ())
    others = [other for other in evidence.topics(*topic.types) if other.publishers]
    last = topic.topic.rpartition("/")[2]
    elsewhere = [other for other in others if other.topic.rpartition("/")[2] == last] or others
    kind = topic.types[0].rpartition("/")[2]
    is_needed = any(is_of_role(one.node, "amcl", "slam_toolbox", "local_costmap") for one in topic.subscribers)
    remedy, proof = f"Start what publishes {named(topic.topic)}, or correct the topic.", ""
    cause = f"{who} listens on {named(topic.topic)}, which has no publisher"
    if gone:
        cause, proof = f"{cause} any longer", f"{listed(list(gone), _MOST_NAMES)} published it earlier, and has left."
        remedy = "Start that node again; ros2_log_read may show why it ended."
    elif len(elsewhere) == 1:
        other = elsewhere[0]
        cause = f"{cause}; the {kind} is on {named(other.topic)}"
        proof = f"{listed(nodes_of(other.publishers), _MOST_NAMES)} publishes it there; on {named(topic.topic)} are 0."
        remedy = f"Set the topic of that source to {other.topic}, with the slash in front, or remap it."
    elif elsewhere:
        proof = f"Of the same type are {listed([one.topic for one in elsewhere], _MOST_NAMES)}."
    return NavFinding(
        rank="stops everything" if is_needed else "stops some goals",
        subject=topic.topic,
        cause=f"{cause}.",
        proof=proof,
        remedy=remedy,
        covers=_follows(topic),
    )


def _silent(evidence: NavEvidence, topic: TopicEndpoints, who: str) -> NavFinding:
    heard = (evidence.heard or {})[topic.topic]
    by = nodes_of(topic.publishers)
    idle = [node for node in by if not evidence.is_active(node)]
    state = f" {listed(idle, 2)} is not active." if idle else ""
    inputs = silent_inputs(evidence, by[0]) if len(by) == 1 else []
    if inputs:
        cause = f"{inputs[0]} is silent, so that {named(by[0])} tells nothing on {named(topic.topic)}."
        first = nodes_of(evidence.topic(inputs[0]).publishers)
        gone = ", ".join(sorted(evidence.graph.left.topics.get(inputs[0], ())))
        lost = f"Start {gone} again: it published {inputs[0]}, and has gone." if gone else "Start what publishes it."
        remedy = f"Find out why {listed(first, 2)} publishes nothing there." if first else lost
        proof = f"Nothing came on either in {heard.duration_s:.1f} s; {named(by[0])} is there, and {who} waits."
    else:
        cause = f"{named(topic.topic)} is silent: {listed(by, _MOST_NAMES)} publishes it, and nothing comes."
        remedy = f"Check the device, the parameters and the log of {listed(by, _MOST_NAMES)}; then start it again."
        proof = f"No message in {heard.duration_s:.1f} s, for which {who} waits.{state}"
    return NavFinding(
        rank="stops everything",
        subject=inputs[0] if inputs else topic.topic,
        cause=cause,
        proof=proof,
        remedy=remedy,
        covers=[topic.topic, *_follows(topic)] if inputs else _follows(topic),
    )


def silent_inputs(evidence: NavEvidence, node: str) -> list[str]:
    """Return the topics a node subscribes to that have no publisher, or whose publishers send nothing."""
    silent = list[str]()
    for topic in evidence.topics(*_INPUTS):
        if not any(one.node == node for one in topic.subscribers):
            continue
        heard = (evidence.heard or {}).get(topic.topic)
        if not topic.publishers or (heard and heard.is_silent):
            silent.append(topic.topic)
    return silent


def _follows(topic: TopicEndpoints) -> list[str]:
    """Return the transforms that are missing as a consequence: AMCL publishes its transform only with a scan, and a
    base without odometry publishes none either."""
    if ODOMETRY in topic.types:
        return ["odom → base", "map → odom"]
    return ["map → odom"] if any(is_of_role(one.node, "amcl", "slam_toolbox") for one in topic.subscribers) else []


def _heights(evidence: NavEvidence) -> Iterator[NavFinding]:
    """Find laser scanners of a costmap that are mounted outside its obstacle heights: none of their points are
    marked."""
    frames = evidence.frames
    if not frames:
        return
    for node in evidence.of_role("local_costmap", "global_costmap"):
        values = (evidence.parameters or {}).get(node, {})
        base = str(values.get("robot_base_frame") or frames.tree.base)
        for name, topic in values.items():
            if not name.endswith(".topic") or not isinstance(topic, str):
                continue
            source = name.removesuffix(".topic")
            heard = (evidence.heard or {}).get(topic if topic.startswith("/") else f"/{topic}")
            if heard is None or not heard.frame_id or heard.type != SENSORS[0]:
                continue
            mount = frames.tree.newest(base, heard.frame_id)
            least, most = (_number(values.get(f"{source}.{which}_obstacle_height")) for which in ("min", "max"))
            if mount is None or least is None or most is None or least <= mount.pose.translation[2] <= most:
                continue
            yield NavFinding(
                rank="makes it worse",
                subject=node,
                cause=f"{named(node)} ignores all of {named(heard.topic)}: the scanner is mounted outside of the "
                "heights that it takes in.",
                proof=f"It is mounted at {mount.pose.translation[2]:.2f} m; min and max_obstacle_height of "
                f"{named(source)} are {least:g} and {most:g} m.",
                remedy=f"Set {source}.max_obstacle_height and min_obstacle_height around the scanner's height.",
            )


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


CHECK = NavCheck(("heard",), _find, PLACE)
