"""Subscribes to the topics that show how a navigation is going: velocities, odometry, collision monitor, recoveries."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from time import monotonic
from typing import Any

import anyio

from ros2_mcp.guard.document import ODOMETRY
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.goals import STATUS_TYPE, TERMINAL
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.ops.navigation.base import chain_of
from ros2_mcp.ops.navigation.drive_watch import DriveWatch
from ros2_mcp.ops.navigation.evidence import is_of_role, nodes_of
from ros2_mcp.ops.navigation.monitor_watch import follow_monitor
from ros2_mcp.ops.navigation.readers import values_of
from ros2_mcp.ops.stop.observe import velocity_of
from ros2_mcp.robot import VELOCITY_TYPES, Robot

MONITOR_STATE = "nav2_msgs/msg/CollisionMonitorState"
TREE_LOG = "nav2_msgs/msg/BehaviorTreeLog"
BEHAVIOURS: Mapping[str, str] = {
    "nav2_msgs/action/Spin": "spin",
    "nav2_msgs/action/BackUp": "back up",
    "nav2_msgs/action/DriveOnHeading": "drive ahead",
    "nav2_msgs/action/Wait": "wait",
    "nav2_msgs/action/AssistedTeleop": "assisted teleop",
}
"""Recoveries that are actions, with their names in our texts."""
_CLEARS = "clear"
"""Part of the names of behaviour tree nodes that clear costmaps, such as ClearLocalCostmap-Context."""
_EVERY_S = 0.2
"""Period of reading one topic: enough for a person, and cheap on a robot with 40 topics."""
_AGAIN_S = 2.0
"""Wait before subscribing again after a failure, such as a lost bridge."""
_FREQUENCY = "controller_frequency"
_MOST_LINKS = 5
"""Topics from Nav2 to the wheels: controller, smoother, monitor, multiplexer, base."""

Take = Callable[[Mapping[str, Any]], None]


async def follow_drive(robot: Robot, action: str, watch: DriveWatch) -> None:
    """Pass received messages to `watch` until cancelled. Raises no `RobotError`."""
    namespace = action.rpartition("/")[0]
    while True:
        try:
            topics = list(await robot.graph.topics())
            actions = await robot.types.actions()
            velocities = [row.name for row in topics if not VELOCITY_TYPES.keys().isdisjoint(row.types)]
            present = await asyncio.gather(*map(robot.graph.endpoints, velocities[: 2 * _MOST_LINKS]))
            break
        except RobotError:
            await asyncio.sleep(_AGAIN_S)
    links = in_order(present)[:_MOST_LINKS]
    watch.chain(links)
    monitors: list[str] = []
    heard: list[tuple[str, str, Take]] = [(topic, "", partial(_take_velocity, watch, topic)) for topic in links]
    for row in topics:
        is_own = row.name.startswith(f"{namespace}/") and row.publishers
        if is_own and ODOMETRY in row.types and "odom" in row.name:
            heard.append((row.name, ODOMETRY, partial(_take_odometry, watch, row.name)))
        elif is_own and MONITOR_STATE in row.types:
            heard.append((row.name, MONITOR_STATE, partial(_take_monitor, watch)))
            monitors.append(row.name)
        elif is_own and TREE_LOG in row.types:
            heard.append((row.name, TREE_LOG, partial(take_tree, watch)))
    for name, kinds in actions.items():
        known = [BEHAVIOURS[kind] for kind in kinds if kind in BEHAVIOURS]
        if known and name.startswith(f"{namespace}/"):
            heard.append((f"{name}/_action/status", STATUS_TYPE, partial(_take_status, watch, known[0])))
    async with anyio.create_task_group() as group:
        for topic, kind, take in heard:
            group.start_soon(_hear, robot, topic, kind, take, watch)
        group.start_soon(_set_rate, robot, present, links, watch)
        for topic in monitors:
            group.start_soon(_follow_publishers, robot, topic, watch)


async def _set_rate(robot: Robot, present: Sequence[TopicEndpoints], links: Sequence[str], watch: DriveWatch) -> None:
    """Tell `watch` the controller's topic, and the rate that the controller is set to."""
    for one in present:
        for node in nodes_of(one.publishers):
            if one.topic not in links or not is_of_role(node, "controller_server"):
                continue
            with suppress(RobotError):
                hz = (await values_of(robot, node, [_FREQUENCY])).get(_FREQUENCY)
                if isinstance(hz, (int, float)) and hz > 0:
                    watch.rate(one.topic, float(hz))
                    return


async def _follow_publishers(robot: Robot, topic: str, watch: DriveWatch) -> None:
    """Follow the collision monitor that publishes its state on a topic."""
    with suppress(RobotError):
        for node in nodes_of((await robot.graph.endpoints(topic)).publishers)[:1]:
            await follow_monitor(robot, node, watch)


def in_order(present: Sequence[TopicEndpoints]) -> list[str]:
    """Return the velocity topics from Nav2 to the base, each after the topics that its publishers subscribe to."""
    topics, chain = chain_of(present)
    links = {one.topic: one for one in present if one.topic in topics and one.subscribers}
    behind = {
        name: {
            other
            for other, before in links.items()
            if other != name
            and {one.node for one in before.subscribers} & {one.node for one in link.publishers if one.node in chain}
        }
        for name, link in links.items()
    }
    found: list[str] = []
    while len(found) < len(links):
        free = sorted(name for name in links if name not in found and behind[name] <= set(found))
        found += free or sorted(set(links) - set(found))  # topics that form a cycle have no order
    return found


async def _hear(robot: Robot, topic: str, kind: str, take: Take, watch: DriveWatch) -> None:
    keep = "all" if kind in (MONITOR_STATE, TREE_LOG) else "latest"
    while True:
        try:
            async with robot.listen(topic, kind, keep=keep) as listening:
                while True:
                    for sample in await listening.take(_AGAIN_S):
                        with suppress(LookupError, TypeError, ValueError):  # another release may have other fields
                            take(await robot.values.in_full(listening.type, sample.data))
                            if not kind:
                                watch.counted(topic, listening.counts.received, sample.received_ns / 1e9)
                    await asyncio.sleep(_EVERY_S)
        except RobotError:
            await asyncio.sleep(_AGAIN_S)


def _take_velocity(watch: DriveWatch, topic: str, message: Mapping[str, Any]) -> None:
    velocity = velocity_of(message, "twist" if "header" in message else "")
    if velocity:
        watch.commanded(topic, velocity[0], velocity[5], monotonic())


def _take_odometry(watch: DriveWatch, topic: str, message: Mapping[str, Any]) -> None:
    velocity = velocity_of(message, "twist.twist")
    at = message["pose"]["pose"]["position"]
    if velocity:
        watch.moved(topic, velocity[0] or velocity[1], velocity[5], (float(at["x"]), float(at["y"])), monotonic())


def _take_monitor(watch: DriveWatch, message: Mapping[str, Any]) -> None:
    watch.monitor(int(message["action_type"]), str(message["polygon_name"]), monotonic())


def take_tree(watch: DriveWatch, message: Mapping[str, Any]) -> None:
    """Take costmap clearings from the log of the behaviour tree. They are services, which appear nowhere else; other
    recoveries are actions."""
    for change in message["event_log"]:
        name = str(change["node_name"])
        before, after = change["previous_status"], change["current_status"]
        # A clearing that is answered at once succeeds without ever running.
        if _CLEARS in name.lower() and (after == "RUNNING" or (before, after) == ("IDLE", "SUCCESS")):
            which = "local" if "local" in name.lower() else "global" if "global" in name.lower() else ""
            cleared = f"clear {which} costmap".replace("  ", " ")
            watch.behaviour(cleared, is_running=True, now=monotonic())
            watch.behaviour(cleared, is_running=False, now=monotonic())


def _take_status(watch: DriveWatch, name: str, message: Mapping[str, Any]) -> None:
    is_running = any(int(entry["status"]) not in TERMINAL for entry in message["status_list"])
    watch.behaviour(name, is_running=is_running, now=monotonic())
