"""What each resource says: JSON objects made of the operations' results."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence, Sized
from typing import Any, cast

from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.ops import log as ops_log
from ros2_mcp.ops.actions.list import list_actions
from ros2_mcp.ops.actions.status import all_goals
from ros2_mcp.ops.graph import interfaces
from ros2_mcp.ops.measure.diagnostics import read_diagnostics
from ros2_mcp.ops.nodes import list as nodes
from ros2_mcp.ops.nodes import parameters
from ros2_mcp.ops.nodes.info import Offer, node_info
from ros2_mcp.ops.results import as_json, iso_time
from ros2_mcp.ops.services import list as services
from ros2_mcp.ops.topics import list as topics
from ros2_mcp.ops.topics.info import TopicInfo, topic_info
from ros2_mcp.ops.watch.changes import Seen, TopicSamples, WorseDiagnostics
from ros2_mcp.ops.watch.watchers import Watcher
from ros2_mcp.robot import Robot

MOST = 1000
SAMPLE_S = 2.0
_SHORT = 200

Content = Mapping[str, Any]


async def graph(robot: Robot, _: Watcher) -> Content:
    """Every node with what it offers and uses, and the type of every topic."""
    listed, every_topic = await asyncio.gather(
        nodes.list_nodes(robot, limit=200), topics.list_topics(robot, limit=MOST)
    )
    infos = await asyncio.gather(*(_node(robot, node) for node in listed.nodes))
    return {
        "nodes": [info for info in infos if info],
        "topics": [{"topic_name": topic.topic_name, "topic_type": topic.topic_type} for topic in every_topic.topics],
        "settled": listed.settled and every_topic.settled,
        "note": f"{listed.note} {every_topic.note}".strip(),
    }


async def all_topics(robot: Robot, _: Watcher) -> Content:
    """The list of topics."""
    return as_json(await topics.list_topics(robot, limit=MOST))


async def all_nodes(robot: Robot, _: Watcher) -> Content:
    """The list of nodes."""
    return as_json(await nodes.list_nodes(robot, limit=MOST))


async def all_services(robot: Robot, _: Watcher) -> Content:
    """The list of services."""
    return as_json(await services.list_services(robot, limit=MOST))


async def all_actions(robot: Robot, _: Watcher) -> Content:
    """The actions with their goals."""
    listed, goals = await asyncio.gather(list_actions(robot), all_goals(robot))
    return {"actions": as_json(listed.actions), "goals": as_json(goals.goals), "note": goals.note}


async def diagnostics(robot: Robot, watcher: Watcher) -> Content:
    """What every component last said of itself, the worst first."""
    table = watcher.newest(WorseDiagnostics())
    if table is None or not table.rows:
        table = await read_diagnostics(robot)
    return {"components": as_json(table.rows), "note": "" if table.rows else "Nobody said anything for 1.5 s."}


async def log(robot: Robot, watcher: Watcher) -> Content:
    """The newest lines of /rosout, the newest first."""
    return await log_lines(robot, watcher)


async def log_lines(robot: Robot, _: Watcher, level: str = "", node: str = "") -> Content:
    """The same, from a level on, or of one node."""
    found = await ops_log.read(robot, ops_log.LogRequest(level=level, node=node, limit=200))
    return {**as_json(found), "lines": as_json(found.lines[::-1])}


async def topic(robot: Robot, watcher: Watcher, name: str) -> Content:
    """Who speaks to whom on a topic, and its newest message."""
    info = await topic_info(robot, name)
    seen = watcher.newest(TopicSamples(info.topic_name)) or await _sample_now(robot, info)
    return {**as_json(info), "sample": await _shown(robot, seen), "note": _silence(info) if seen is None else ""}


async def interface(robot: Robot, _: Watcher, type: str) -> Content:  # noqa: A002 - the template's variable
    """The definition of a type."""
    return as_json(await interfaces.define(robot, type))


async def node_parameters(robot: Robot, _: Watcher, name: str) -> Content:
    """The parameters of a node."""
    node = (await node_info(robot, name)).node
    found = (await parameters.describe(robot, [node], limit=MOST)).nodes[0]
    if found.error:
        raise NotFound(found.error)
    return as_json(found)


def fitting(content: Content, max_bytes: int) -> str:
    """The content as JSON text of at most that size; what is left out is said under `left_out`.

    Everything beyond ASCII is escaped, so nothing in it is invisible, and it means the same.
    """
    shown, left_out = dict(content), dict[str, str]()
    while len(text := _text({**shown, "left_out": left_out} if left_out else shown)) > max_bytes:
        part = _longest(shown)
        shown[part], left_out[part] = _shortened(shown[part], content[part])
    return text


def _shortened(value: Any, whole: Any) -> tuple[Any, str]:
    """Half of a list or a text, nothing of anything else; and what that is, in words."""
    if isinstance(value, (list, str)) and len(cast("Sized", value)) > 1:
        half = cast("list[Any] | str", value)[: len(cast("Sized", value)) // 2]
        unit = "characters" if isinstance(half, str) else "entries"
        return half, f"the first {len(half)} of {len(whole)} {unit} are shown"
    return None, f"{len(_text(whole))} bytes"


def _longest(shown: Content) -> str:
    """The part to shorten: the longest list or text, as long as there is one worth it, else the longest of all."""
    sizes = {part: len(_text(value)) for part, value in shown.items()}
    divisible = [part for part, value in shown.items() if isinstance(value, (list, str)) and sizes[part] > _SHORT]
    return max(divisible or sizes, key=lambda part: sizes[part])


def _text(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


async def _node(robot: Robot, node: str) -> Content | None:
    try:
        info = await node_info(robot, node)
    except RobotError:
        return None  # it has left meanwhile, or has no name

    def named(offers: Sequence[Offer]) -> list[str]:
        return [offer.name for offer in offers]

    return {
        "node": info.node,
        "publishes": named(info.publishes),
        "subscribes": named(info.subscribes),
        "services": named(info.services),
        "actions": named(info.actions),
    }


async def _sample_now(robot: Robot, info: TopicInfo) -> Seen | None:
    if not info.publishers:
        return None
    async with robot.listen(info.topic_name, info.publishers[0].type, keep="latest") as heard:
        samples = await heard.take(SAMPLE_S)
    return Seen(heard.type, samples[-1]) if samples else None


async def _shown(robot: Robot, seen: Seen | None) -> Content | None:
    if seen is None:
        return None
    from ros2_mcp.codec.render import RenderOptions

    options = RenderOptions(max_bytes=robot.result_bytes // 2)
    await robot.values.learn(seen.type)
    rendered = await asyncio.to_thread(robot.values.render, seen.type, seen.sample.data, options)
    return {
        "type": seen.type,
        "received_at": iso_time(seen.sample.received_ns),
        "message": rendered.value,
        "truncated": rendered.truncated,
    }


def _silence(info: TopicInfo) -> str:
    if not info.publishers:
        return "Nobody publishes on it."
    publishers = ", ".join(sorted({publisher.node for publisher in info.publishers}))
    return f"No message came within {SAMPLE_S:g} s from {publishers}."
