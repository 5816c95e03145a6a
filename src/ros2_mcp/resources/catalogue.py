"""All resources: for each its URI, its content, and what is watched for its subscribers.

A resource is one function here. Its docstring is the description that clients read, its result the content.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mcp.shared.uri_template import UriTemplate

from ros2_mcp.model import names
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.ops.actions.list import list_actions
from ros2_mcp.ops.actions.status import all_goals
from ros2_mcp.ops.graph import interfaces
from ros2_mcp.ops.log import read as ops_log
from ros2_mcp.ops.measure.diagnostics import LISTEN_S, read_diagnostics
from ros2_mcp.ops.nodes import parameters
from ros2_mcp.ops.nodes.info import node_info
from ros2_mcp.ops.nodes.list import list_nodes
from ros2_mcp.ops.results.results import answer_bytes, as_json, iso_time
from ros2_mcp.ops.services.list import list_services
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.space.robot import in_brief
from ros2_mcp.ops.topics.info import topic_info
from ros2_mcp.ops.topics.list import list_topics
from ros2_mcp.ops.watch.changes import (
    GoalsEnded,
    GraphParts,
    LogLines,
    ParametersOf,
    Seen,
    TopicSamples,
    Unchanging,
    WorseDiagnostics,
)
from ros2_mcp.ops.watch.watchers import Subject, Watcher
from ros2_mcp.resources.fitting import Content
from ros2_mcp.robot import Robot

# The most names that are requested; fitting the content may cut them further.
MAX_LISTED = 1000
# The most nodes whose endpoints are in the graph: each needs a request to the bridge.
MAX_NODES = 200
# The most lines of the log: more than fit; those that do not fit are dropped, and counted.
MAX_LINES = 200
# How long to wait for the next message of a topic, while a client waits for the content.
SAMPLE_S = 2.0

Read = Callable[..., Awaitable[Content]]


@dataclass(frozen=True, kw_only=True)
class Declared:
    """One resource, or a template of resources if its URI has variables.

    A name with slashes may be percent-encoded in the URI, and may lack its first slash. `read` takes the robot, its
    watcher, and the variables by name; `subject` takes the variables by name. `completes` maps a variable to the kind
    of live names that complete it.
    """

    uri: str
    title: str
    description: str
    name: str
    read: Read
    subject: Callable[..., Subject]
    completes: Mapping[str, str]

    @cached_property
    def template(self) -> UriTemplate:
        """The parsed URI."""
        return UriTemplate.parse(self.uri)


RESOURCES: list[Declared] = []


def resource(uri: str, title: str, subject: Callable[..., Subject], **completes: str) -> Callable[[Read], Read]:
    """Declare a function as the content of a resource."""

    def declare(read: Read) -> Read:
        RESOURCES.append(
            Declared(
                uri=uri,
                title=title,
                description=" ".join((read.__doc__ or "").split()),
                name=read.__name__.replace("_", "-"),
                read=read,
                subject=subject,
                completes=completes,
            )
        )
        return read

    return declare


def matching(uri: str) -> tuple[Declared, Mapping[str, Any]]:
    """Return the resource of a URI, and the values of its variables. Raises `NotFound` for an unknown URI."""
    for declared in RESOURCES:
        variables = declared.template.match(uri)
        if variables is not None:
            return declared, variables
    raise NotFound(f"There is no resource {uri}.", names.did_you_mean(uri, [declared.uri for declared in RESOURCES]))


def subject_of(uri: str) -> Subject:
    """Return what to watch for a subscription to this URI.

    Raises:
        NotFound: for an unknown URI.
        BadInput: for a name that ROS does not allow, or an unknown log level.
    """
    declared, variables = matching(uri)
    return declared.subject(**variables)


# ── the graph ────────────────────────────────────────────────────────────────────────────────────────────────────────


@resource("ros2://graph", "The graph", lambda: GraphParts(("nodes", "topics", "services")))
async def graph(robot: Robot, _: Watcher) -> Content:
    """Every node with what it publishes, subscribes to and serves. Changes when something comes or goes."""

    async def info(node: str) -> Content | None:
        try:
            found = await node_info(robot, node)
        except RobotError:
            return None  # it has left meanwhile, or has no name
        offers = {
            "publishes": found.publishes,
            "subscribes": found.subscribes,
            "services": found.services,
            "actions": found.actions,
        }
        return {"node": found.node, **{kind: [offer.name for offer in listed] for kind, listed in offers.items()}}

    listed, all_topics = await asyncio.gather(list_nodes(robot, limit=MAX_NODES), list_topics(robot, limit=MAX_LISTED))
    infos = await asyncio.gather(*map(info, listed.nodes))
    return {
        "nodes": [found for found in infos if found],
        "topics": [{"topic_name": row.topic_name, "topic_type": row.topic_type} for row in all_topics.topics],
        "settled": listed.settled and all_topics.settled,
        "note": " ".join(filter(None, dict.fromkeys((listed.note, all_topics.note)))),
    }


@resource("ros2://robot", "The robot in brief", lambda: GraphParts(("topics",)))
async def robot_in_brief(robot: Robot, _: Watcher) -> Content:
    """What the robot is: kind, size, command inputs, sensors, joints, where it is, what is unhealthy. Changes when a
    topic comes or goes."""
    return as_json(await in_brief(robot, Live(robot)))


@resource("ros2://topics", "Topics", lambda: GraphParts(("topics",)))
async def topics(robot: Robot, _: Watcher) -> Content:
    """Every topic with its type. Changes when a topic or a publisher comes or goes."""
    return as_json(await list_topics(robot, limit=MAX_LISTED))


@resource("ros2://nodes", "Nodes", lambda: GraphParts(("nodes",)))
async def nodes(robot: Robot, _: Watcher) -> Content:
    """Every node. Changes when one comes or goes."""
    return as_json(await list_nodes(robot, limit=MAX_LISTED))


@resource("ros2://services", "Services", lambda: GraphParts(("services",)))
async def services(robot: Robot, _: Watcher) -> Content:
    """Every service with its type. Changes when one comes or goes."""
    return as_json(await list_services(robot, limit=MAX_LISTED))


@resource("ros2://actions", "Actions and goals", GoalsEnded)
async def actions(robot: Robot, _: Watcher) -> Content:
    """Every action with its goals and their states. Changes when a goal has ended, or an action came or went."""
    listed, goals = await asyncio.gather(list_actions(robot), all_goals(robot))
    return {
        "actions": as_json(listed.actions),
        "goals": as_json(goals.goals),
        "note": f"{listed.note} {goals.note}".strip(),
    }


# ── diagnostics and log ──────────────────────────────────────────────────────────────────────────────────────────────


@resource("ros2://diagnostics", "Diagnostics", WorseDiagnostics)
async def diagnostics(robot: Robot, watcher: Watcher) -> Content:
    """What every component says of its health, the worst first. Changes when one got worse."""
    table = watcher.newest(WorseDiagnostics())
    if table is None or not table.rows:
        table = await read_diagnostics(robot)
    note = "" if table.rows else f"No diagnostics were received for {LISTEN_S:g} s."
    return {"components": as_json(table.rows), "note": note}


@resource("ros2://log", "The log", LogLines)
async def log(robot: Robot, watcher: Watcher) -> Content:
    """The newest lines of /rosout, the newest first. Changes with every line."""
    return await log_lines(robot, watcher)


def _lines_of(level: str = "", node: str = "") -> Subject:
    ops_log.level_number(level)  # raises for an unknown level
    return LogLines(level.lower(), node)


@resource("ros2://log{?level,node}", "The log from a level on, or of a node", _lines_of, node="node")
async def log_lines(robot: Robot, _: Watcher, level: str = "", node: str = "") -> Content:
    """The newest lines from a level on (debug, info, warn, error, fatal), or of a node. Changes with such a line."""
    found = await ops_log.read(robot, ops_log.LogRequest(level=level, node=node, limit=MAX_LINES))
    return {**as_json(found), "lines": as_json(found.lines[::-1])}


# ── one topic, type or node ──────────────────────────────────────────────────────────────────────────────────────────


def _samples_of(name: str) -> Subject:
    return TopicSamples(names.absolute(name))


@resource("ros2://topic/{+name}", "A topic", _samples_of, name="topic")
async def topic(robot: Robot, watcher: Watcher, name: str) -> Content:
    """Publishers, subscribers, QoS and the newest message of a topic. Changes with every message."""
    info = await topic_info(robot, name)
    seen: Seen | None = watcher.newest(TopicSamples(info.topic_name))
    note = "" if info.publishers else "It has no publisher."
    if seen is None and info.publishers:
        async with robot.listen(
            info.topic_name, info.publishers[0].type, keep="latest", newest_of_old=True
        ) as listening:
            samples = await listening.take(SAMPLE_S)
        seen = Seen(listening.type, samples[-1], listening.is_from_before(samples[-1])) if samples else None
        publishers = ", ".join(sorted({publisher.node for publisher in info.publishers}))
        note = f"No message came within {SAMPLE_S:g} s from {publishers}."
    return {**as_json(info), "sample": await _shown(robot, seen), "note": note if seen is None else ""}


async def _shown(robot: Robot, seen: Seen | None) -> Content | None:
    """Render a sample in at most half of the result's size; the other half is for the endpoints."""
    if seen is None:
        return None
    from ros2_mcp.values.render import RenderOptions  # NumPy and rosbags: listing resources must not wait for them

    options = RenderOptions(max_bytes=answer_bytes(robot) // 2)
    await robot.values.learn(seen.type)
    rendered = await robot.values.render(seen.type, seen.sample.data, options)
    return {
        "type": seen.type,
        "received_at": iso_time(seen.sample.received_ns),
        "from_before": FromBefore.of(1, seen.sample.source_ns, robot.now_ns()).age if seen.is_old else "",
        "message": rendered.value,
        "truncated": list(rendered.truncated),
    }


def _definition_of(type: str) -> Subject:  # noqa: A002, ARG001 - the template's variable
    return Unchanging()


@resource("ros2://interface/{+type}", "A definition", _definition_of, type="interface")
async def interface(robot: Robot, _: Watcher, type: str) -> Content:  # noqa: A002 - the template's variable
    """The definition of a message, service or action type, with an example. Never changes."""
    return as_json(await interfaces.define(robot, type))


def _parameters_of(name: str) -> Subject:
    return ParametersOf(names.absolute(name, "node"))


@resource("ros2://node/{+name}/parameters", "Parameters of a node", _parameters_of, name="node")
async def node_parameters(robot: Robot, _: Watcher, name: str) -> Content:
    """The parameters of a node with values and descriptions. Changes when one is set."""
    node = (await node_info(robot, name)).node
    found = (await parameters.describe(robot, [node], limit=MAX_LISTED)).nodes[0]
    if found.error:
        raise NotFound(found.error)
    return as_json(found)
