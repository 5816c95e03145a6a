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
_LOW = re.compile(r"(^|[/_])(cmd|commands?|setpoint)($|[/_])")
_PART = re.compile(
    r"[/_](thrust(er)?s?|throttle|rudder|steering|brake|pos(ition)?|vel(ocity)?|effort|torque|speed)($|[/_])"
)
"""In the name of a number that moves a part, where nobody tells that number: then it waits for one."""
_SO_NAMED: Mapping[str, tuple[str, re.Pattern[str]]] = {
    "PoseStamped": ("goal", re.compile(r"[/_](goal(_pose)?$|setpoint)")),  # of Nav2, RViz; MAVROS
    "Pose": ("pose", re.compile(r"[/_](body|target|goal|desired|cmd|command|setpoint)")),  # of bodies on legs, of hands
    "Float64MultiArray": ("low level", _LOW),  # forward_command_controller and its kind
    "Float32MultiArray": ("low level", _LOW),
    "Float64": ("low level", _LOW),  # motors of VESC, joints and thrusters of simulators
    "Float32": ("low level", _LOW),
    "String": ("script", re.compile(r"/script_command$")),  # of Universal Robots
}
"""Types that are for anything, what they are for where drivers listen to them, and the names of such topics; in the
order in which they are told."""
_USES = ("", "goal", "action", "trajectory", "pose", "low level", "script")
_NUMBERS = ("Float64", "Float32")
_GOALS = re.compile(r"nav2_msgs/action/Navigate\w+_FeedbackMessage")
_OF_A_HAND = re.compile(r"(servo|delta_twist)", re.IGNORECASE)
"""In the topic of a velocity that moves the tip of an arm, and no base (MoveIt Servo)."""
_MOST_NAMED = 3


@dataclass(frozen=True, slots=True)
class CommandInput:
    """A topic with one of its types and who subscribes, or an action and its servers. `use` says what it takes if not
    a movement; `is_active` is false where all who listen are controllers that are not active.
    """

    topic: str
    type: str
    listeners: Sequence[str]
    senders: Sequence[str] = ()
    use: str = ""
    is_active: bool = True

    def __str__(self) -> str:
        """With who else may send there, which whoever would drive there wants to know."""
        by = f" (from {', '.join(map(named, self.senders[:2]))})" if self.senders else ""
        use = f" ({self.use})" if self.use and self.use != "trajectory" else ""  # its type says that
        state = "" if self.is_active else ", not active"
        who = " and ".join(map(named, self.listeners[:_MOST_NAMED]))
        return f"{named(self.topic)} {named(self.type.rpartition('/')[2])}{use} → {who}{state}{by}"


def command_inputs(graph: GraphSnapshot, managed: Mapping[str, Sequence[Mapping[str, Any]]]) -> Sequence[CommandInput]:
    """The inputs of a graph: those that take commands now first, of these movements before goals before lower ones,
    then the nearest to the root of names.

    The topic of a controller that takes trajectories as an action, too, is told with that.
    `managed`: what controller managers say of their controllers, by their node.
    """
    idle = {
        f"{listed_by.rpartition('/')[0]}/{one['name']}"
        for listed_by, controllers in managed.items()
        for one in controllers
        if one["state"] != "active"
    }
    found = [one for topic in graph.topics.values() for one in _inputs_of(topic, idle) if not _has_action(graph, one)]
    return sorted(found, key=lambda one: (not one.is_active, _USES.index(one.use), one.topic.count("/"), one.topic))


def drive_types(inputs: Sequence[CommandInput]) -> Sequence[str]:
    """The types of the movements that something active takes, by which the kind of base is known."""
    return [one.type for one in inputs if not one.use and one.is_active and not _OF_A_HAND.search(one.topic)]


def _has_action(graph: GraphSnapshot, one: CommandInput) -> bool:
    action = f"{one.topic.removesuffix('/joint_trajectory')}/follow_joint_trajectory/_action/feedback"
    return one.type.endswith("/JointTrajectory") and action in graph.topics


def _inputs_of(topic: TopicEndpoints, idle: set[str]) -> Iterator[CommandInput]:
    for kind in sorted({subscriber.type for subscriber in topic.subscribers}):
        name = kind.rpartition("/")[2]
        use, pattern = ("", None) if name in _COMMANDS else _SO_NAMED.get(name, (None, None))
        waits = name in _NUMBERS and not topic.publishers and _PART.search(topic.topic)
        if use is None or (pattern and not pattern.search(topic.topic) and not waits):
            continue
        use = "trajectory" if name == "JointTrajectory" else use
        who = sorted({subscriber.node for subscriber in topic.subscribers if subscriber.type == kind})
        senders = sorted({one.node for one in topic.publishers})
        yield CommandInput(topic.topic, kind, who, senders, use, not set(who) <= idle)
    action, _, part = topic.topic.rpartition("/_action/")
    for kind in filter(_GOALS.fullmatch, topic.types if part == "feedback" else ()):
        if servers := sorted({one.node for one in topic.publishers}):
            yield CommandInput(action, kind.removesuffix("_FeedbackMessage"), servers, use="action")
