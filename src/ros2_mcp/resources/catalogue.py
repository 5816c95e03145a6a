"""Every resource: its URI, what it says, and what is watched for those who subscribe to it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from mcp.shared.uri_template import UriTemplate

from ros2_mcp.model import names
from ros2_mcp.model.errors import NotFound
from ros2_mcp.ops.log import level_number
from ros2_mcp.ops.watch.changes import (
    GoalsEnded,
    GraphParts,
    LogLines,
    ParametersOf,
    TopicSamples,
    Unchanging,
    WorseDiagnostics,
)
from ros2_mcp.ops.watch.watchers import Subject
from ros2_mcp.resources import content


@dataclass(frozen=True)
class Declared:
    """One resource, or a template of resources where its URI has variables.

    A name with slashes stands in the URI as it is or percent-encoded, with or without its first slash.
    `completes` maps a variable to the kind of live names that complete it.
    """

    uri: str
    title: str
    description: str
    read: Callable[..., Awaitable[content.Content]]
    subject: Callable[..., Subject]
    completes: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def name(self) -> str:
        """A short name."""
        return self.read.__name__.removeprefix("all_").replace("_", "-")

    @cached_property
    def template(self) -> UriTemplate:
        """The parsed URI."""
        return UriTemplate.parse(self.uri)


def _samples_of(name: str) -> Subject:
    return TopicSamples(names.absolute(name))


def _definition_of(type: str) -> Subject:  # noqa: A002, ARG001 - the template's variable
    return Unchanging()


def _parameters_of(name: str) -> Subject:
    return ParametersOf(names.absolute(name, "node"))


def _lines_of(level: str = "", node: str = "") -> Subject:
    level_number(level)
    return LogLines(level.lower(), node)


RESOURCES = (
    Declared(
        "ros2://graph",
        "The graph",
        "Every node with what it publishes, subscribes to and serves. Changes when something comes or goes.",
        content.graph,
        lambda: GraphParts(("nodes", "topics", "services")),
    ),
    Declared(
        "ros2://topics",
        "Topics",
        "Every topic with its type. Changes when a topic or a publisher comes or goes.",
        content.all_topics,
        lambda: GraphParts(("topics",)),
    ),
    Declared(
        "ros2://nodes",
        "Nodes",
        "Every node. Changes when one comes or goes.",
        content.all_nodes,
        lambda: GraphParts(("nodes",)),
    ),
    Declared(
        "ros2://services",
        "Services",
        "Every service with its type. Changes when one comes or goes.",
        content.all_services,
        lambda: GraphParts(("services",)),
    ),
    Declared(
        "ros2://actions",
        "Actions and goals",
        "Every action with its goals and their states. Changes when a goal has ended, or an action came or went.",
        content.all_actions,
        GoalsEnded,
    ),
    Declared(
        "ros2://diagnostics",
        "Diagnostics",
        "What every component says of its health, the worst first. Changes when one got worse.",
        content.diagnostics,
        WorseDiagnostics,
    ),
    Declared(
        "ros2://log",
        "The log",
        "The newest lines of /rosout, the newest first. Changes with every line.",
        content.log,
        LogLines,
    ),
    Declared(
        "ros2://log{?level,node}",
        "The log from a level on, or of a node",
        "The newest lines from a level on (debug, info, warn, error, fatal), or of a node. Changes with such a line.",
        content.log_lines,
        _lines_of,
        {"node": "node"},
    ),
    Declared(
        "ros2://topic/{+name}",
        "A topic",
        "Publishers, subscribers, QoS and the newest message of a topic. Changes with every message.",
        content.topic,
        _samples_of,
        {"name": "topic"},
    ),
    Declared(
        "ros2://interface/{+type}",
        "A definition",
        "The definition of a message, service or action type, with an example. Never changes.",
        content.interface,
        _definition_of,
        {"type": "interface"},
    ),
    Declared(
        "ros2://node/{+name}/parameters",
        "Parameters of a node",
        "The parameters of a node with values and descriptions. Changes when one is set.",
        content.node_parameters,
        _parameters_of,
        {"name": "node"},
    ),
)


def matching(uri: str) -> tuple[Declared, Mapping[str, Any]]:
    """The resource that a URI means, with the values of its variables; raises `NotFound` if it is none of ours."""
    for declared in RESOURCES:
        variables = declared.template.match(uri)
        if variables is not None:
            return declared, variables
    raise NotFound(f"There is no resource {uri}.", names.did_you_mean(uri, [declared.uri for declared in RESOURCES]))


def subject_of(uri: str) -> Subject:
    """What is watched for a subscriber to this URI.

    Raises:
        NotFound: if it is none of ours.
        BadInput: if it has a name that ROS does not allow, or a level that is none.
    """
    declared, variables = matching(uri)
    return declared.subject(**variables)
