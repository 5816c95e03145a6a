"""What moves a robot: the topics that listen for commands, who listens and who else may send there."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import GraphSnapshot

_COMMANDS = ("Twist", "TwistStamped", "AckermannDrive", "AckermannDriveStamped", "JointTrajectory", "Joy")
"""Types that are for nothing else."""
_SO_NAMED: Mapping[str, re.Pattern[str]] = {
    "Float64MultiArray": re.compile(r"/commands$"),  # forward_command_controller and its kind
    "Float64": re.compile(r"/commands?/|_cmd$|/cmd$"),  # motors of VESC, joints of simulators
    "PoseStamped": re.compile(r"/goal(_pose)?$"),  # of Nav2, RViz
    "Pose": re.compile(r"/(body|cmd)_pose$"),  # how a legged robot holds its body
    "String": re.compile(r"/script_command$"),  # of Universal Robots
}
"""Types that are for anything, and the names of topics that drivers listen to with them."""
_MOST_NAMED = 3


@dataclass(frozen=True, slots=True)
class CommandInput:
    """A topic with one of its types and who subscribes; `is_active` false where all of these are controllers that are
    not active.
    """

    topic: str
    type: str
    listeners: Sequence[str]
    senders: Sequence[str]
    is_active: bool = True

    def __str__(self) -> str:
        """With who else may send there, which whoever would drive there wants to know."""
        by = f" (from {', '.join(map(named, self.senders[:2]))})" if self.senders else ""
        state = "" if self.is_active else ", not active"
        who = " and ".join(map(named, self.listeners[:_MOST_NAMED]))
        return f"{named(self.topic)} {named(self.type.rpartition('/')[2])} → {who}{state}{by}"


def command_inputs(graph: GraphSnapshot, managed: Mapping[str, Sequence[Mapping[str, Any]]]) -> Sequence[CommandInput]:
    """The inputs of a graph, those that take commands now first, then the nearest to the root of names.

    `managed`: what controller managers say of their controllers, by their node.
    """
    idle = {
        f"{listed_by.rpartition('/')[0]}/{one['name']}"
        for listed_by, controllers in managed.items()
        for one in controllers
        if one["state"] != "active"
    }
    found = [one for topic in graph.topics.values() for one in _inputs_of(topic, idle)]
    return sorted(found, key=lambda one: (not one.is_active, one.topic.count("/"), one.topic))


def _inputs_of(topic: TopicEndpoints, idle: set[str]) -> Iterator[CommandInput]:
    for kind in sorted({subscriber.type for subscriber in topic.subscribers}):
        name = kind.rpartition("/")[2]
        if name not in _COMMANDS and not (name in _SO_NAMED and _SO_NAMED[name].search(topic.topic)):
            continue
        who = sorted({subscriber.node for subscriber in topic.subscribers if subscriber.type == kind})
        senders = sorted({one.node for one in topic.publishers})
        yield CommandInput(topic.topic, kind, who, senders, is_active=not set(who) <= idle)
