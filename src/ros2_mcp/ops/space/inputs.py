"""The command inputs of a robot: topics that take commands, with their subscribers and other publishers, and
actions."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.text import named
from ros2_mcp.ops.graph.remaps import led_nowhere
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.controllers import idle_nodes
from ros2_mcp.ops.space.lines import Named, some_nodes, to_nodes
from ros2_mcp.robot.resolution import is_infrastructure

_COMMANDS = ("Twist", "TwistStamped", "AckermannDrive", "AckermannDriveStamped", "JointTrajectory", "Joy")
"""Message types used only for commands."""
LOW_LEVEL = re.compile(r"(^|[/_])(cmd|commands?|setpoint)($|[/_])")
"""Matches the names of topics that take low-level commands, of any type."""
REPORT = re.compile(r"/(sensors?|feedback|states?|status|reports?|measured|telemetry)/")
"""Matches the names of topics on which a driver reports; a topic so named takes no commands, whatever else its name
says."""
_RATES = re.compile(r"[/_](attitude|body_?rates?)([/_]|$)")
"""Matches topics whose velocity commands are body rates only, as autopilots have them."""
_PART = re.compile(
    r"[/_](thrust(er)?s?|throttle|rudder|steering|brake|pos(ition)?|vel(ocity)?|effort|torque|speed)($|[/_])"
)
"""Matches topics whose number moves a part, such as a thruster. Without a publisher they wait for a command."""
_SO_NAMED: Mapping[str, tuple[str, re.Pattern[str]]] = {
    "PoseStamped": ("goal", re.compile(r"[/_](goal(_pose)?$|setpoint)")),  # Nav2, RViz; MAVROS
    "Pose": ("pose", re.compile(r"[/_](body|target|goal|desired|cmd|command|setpoint)")),  # legged bodies, grippers
    "Float64MultiArray": ("low level", LOW_LEVEL),  # forward_command_controller and similar ones
    "Float32MultiArray": ("low level", LOW_LEVEL),
    "Float64": ("low level", LOW_LEVEL),  # motors of VESC, joints and thrusters of simulators
    "Float32": ("low level", LOW_LEVEL),
    "String": ("script", re.compile(r"/script_command$")),  # Universal Robots
    "JointState": ("joints", re.compile(r"[/_](commands?|cmd|targets?|goals?|desired|setpoints?)$")),  # simulators
}
"""Types of general use, the use that drivers make of them, and the names of such topics; in the order in which they are
listed."""
_USES = ("", "goal", "action", "trajectory", "pose", "body rates", "joints", "low level", "script", "joystick")
_NUMBERS = ("Float64", "Float32")
_FEEDBACK = "_FeedbackMessage"
_GOALS = re.compile(r".*/action/(Navigate\w+|FollowJointTrajectory|\w*GripperCommand|MoveGroup)")
"""Actions by which a robot is usually moved; others are listed by name only."""
_NO_INPUTS = (
    "action_msgs", "bond", "diagnostic_msgs", "lifecycle_msgs", "map_msgs", "nav_msgs", "rcl_interfaces",
    "rosgraph_msgs", "sensor_msgs", "service_msgs", "tf2_msgs", "visualization_msgs",
)  # fmt: skip
"""Packages of sensor and status messages: a subscriber without a publisher lacks data there, and is no command
input."""
_PLAIN = ("geometry_msgs", "std_msgs")
_OF_A_HAND = re.compile(r"(servo|delta_twist)", re.IGNORECASE)
"""Matches velocity topics that move the tip of an arm instead of a base (MoveIt Servo)."""
_STACKS = ("moveit_msgs", "nav2_msgs")
_TRAJECTORIES = "joint_trajectory"
_OF_PROGRAMS = (
    "composition_interfaces", "controller_manager_msgs", "diagnostic_msgs", "lifecycle_msgs",
    "map_msgs", "moveit_msgs", "nav2_msgs", "nav_msgs", "rcl_interfaces", "robot_localization", "rosbag2_interfaces",
    "slam_toolbox", "tf2_msgs", "topic_tools_interfaces", "type_description_interfaces",
)  # fmt: skip
"""Packages of services that query or configure software; robots are moved by their actions and topics instead."""
_ASKS = re.compile(r"^(get|list|query|is|has|read|check|dump|save|load)(_|$)|_(get|list|query)(_|$)|_status$")
"""Matches the last part of the names of services that change nothing on the robot."""


@dataclass(frozen=True, slots=True)
class CommandInput:
    """A topic with one of its types and its subscribers, or an action and its servers. `use` says what the input takes,
    if not velocities; `is_active` is false if all subscribers are inactive controllers; `or_topic` is the topic on
    which the servers of an action take the same commands.
    """

    topic: str
    type: str
    listeners: Sequence[str]
    senders: Sequence[str] = ()
    use: str = ""
    is_active: bool = True
    or_topic: str = ""

    @property
    def line(self) -> str:
        """The input in words, such as `/cmd_vel Twist → /base (from /smoother)`: the other publishers may conflict with
        a command.
        """
        use = self.use if self.use != "trajectory" else ""  # the type already implies it
        use += f", or topic {named(self.or_topic)}" if self.or_topic else ""
        kind = f"{named(self.type.rpartition('/')[2])}{f' ({use})' if use else ''}"
        state = "" if self.is_active else ", not active"
        by = f" (from {some_nodes(self.senders, ', ')})" if self.senders else ""
        return f"{named(self.topic)} {kind}{to_nodes(self.listeners)}{state}{by}"


def command_inputs(graph: GraphSnapshot, managed: Mapping[str, Sequence[Mapping[str, Any]]]) -> Sequence[CommandInput]:
    """Return the command inputs of a graph: active inputs first; among these velocities before goals before low-level
    commands; then the shortest namespace first.

    The topic of a trajectory controller that also has an action is listed with the action. `managed`: the controllers
    listed by each controller manager, by the manager's node.
    """
    idle = idle_nodes(managed)
    found = [one for topic in graph.topics.values() for one in _inputs_of(topic, idle) if not _has_action(graph, one)]
    found += [
        CommandInput(action, kind, servers, use="action", is_active=not set(servers) <= idle, or_topic=topic)
        for action, kind, servers in _actions(graph)
        if _GOALS.fullmatch(kind)
        for topic in [_TRAJECTORIES if _beside(action) in graph.topics else ""]
    ]
    return sorted(found, key=lambda one: (not one.is_active, _USES.index(one.use), one.topic.count("/"), one.topic))


def other_actions(graph: GraphSnapshot, inputs: Sequence[CommandInput]) -> list[Named]:
    """Return the actions that are no command inputs; the actions of Nav2 and MoveIt last."""
    told = {one.topic for one in inputs}
    found = [one for one in _actions(graph) if one[0] not in told and not _GOALS.fullmatch(one[1])]
    found.sort(key=lambda one: one[1].partition("/")[0] in _STACKS)
    return [Named(name, kind.rpartition("/")[2], listeners=servers) for name, kind, servers in found]


def topics_without_publisher(graph: GraphSnapshot, inputs: Sequence[CommandInput]) -> list[Named]:
    """Return topics that have subscribers but no publisher, whatever their types. A topic of a sensor type is included
    only if a topic with nearly the same name is published, which suggests a missing remapping.
    """
    told = {one.topic for one in inputs}
    remapped = led_nowhere(graph.topics)
    waiting = [one for one in graph.topics.values() if _waits(one, told) or one.topic in remapped.keys() - told]
    return [_waiting(one, remapped.get(one.topic)) for one in sorted(waiting, key=_rank)]


def _waiting(topic: TopicEndpoints, published: TopicEndpoints | None) -> Named:
    listeners = sorted({subscriber.node for subscriber in topic.subscribers})
    meant = f"({named(published.topic)} has no subscriber: a remapping?)" if published else ""
    return Named(topic.topic, topic.types[0].rpartition("/")[2], meant, listeners=listeners)


def orders_by_service(graph: GraphSnapshot) -> list[Named]:
    """Return the services that command the robot, for example to stand up, to arm or to reset."""
    return [
        Named(name, types[0].rpartition("/")[2])
        for name, types in sorted((graph.services or {}).items(), key=lambda one: (one[0].count("/"), one[0]))
        if not is_infrastructure(name, types) and types[0].partition("/")[0] not in _OF_PROGRAMS
        if not _ASKS.search(name.rpartition("/")[2])
    ]


def _waits(topic: TopicEndpoints, told: Collection[str]) -> bool:
    """Return whether a topic has subscribers that wait for commands; a topic named as a low-level command may have
    publishers.
    """
    if topic.topic in told or not topic.subscribers or "/_" in topic.topic:
        return False
    if any(kind.rpartition("/")[2] in _COMMANDS or kind.partition("/")[0] in _NO_INPUTS for kind in topic.types):
        return False  # topics of the first kind, or their actions, are listed already
    if REPORT.search(topic.topic):
        return False
    return not topic.publishers or bool(LOW_LEVEL.search(topic.topic))


def _rank(topic: TopicEndpoints) -> tuple[bool, bool, int, str]:
    """Return a sort key that puts topics first whose name or type is that of a command."""
    is_plain = topic.types[0].partition("/")[0] in _PLAIN
    return not LOW_LEVEL.search(topic.topic), is_plain, topic.topic.count("/"), topic.topic


def drive_types(inputs: Sequence[CommandInput]) -> Sequence[str]:
    """Return the types of the velocity commands that active inputs take; the kind of base is derived from them."""
    return [one.type for one in inputs if not one.use and one.is_active and not _OF_A_HAND.search(one.topic)]


def _beside(action: str) -> str:
    """Return the topic of a trajectory controller, given its action."""
    return f"{action.removesuffix('/follow_joint_trajectory')}/{_TRAJECTORIES}"


def _has_action(graph: GraphSnapshot, one: CommandInput) -> bool:
    action = f"{one.topic.removesuffix(f'/{_TRAJECTORIES}')}/follow_joint_trajectory/_action/feedback"
    return one.type.endswith("/JointTrajectory") and action in graph.topics


def _inputs_of(topic: TopicEndpoints, idle: set[str]) -> Iterator[CommandInput]:
    for kind in sorted({subscriber.type for subscriber in topic.subscribers}):
        name = kind.rpartition("/")[2]
        use, pattern = ("", None) if name in _COMMANDS else _SO_NAMED.get(name, (None, None))
        waits = name in _NUMBERS and not topic.publishers and _PART.search(topic.topic)
        if use is None or (pattern and not pattern.search(topic.topic) and not waits):
            continue
        if use == "low level" and REPORT.search(topic.topic):
            continue
        use = {"JointTrajectory": "trajectory", "Joy": "joystick"}.get(name, use)
        use = "body rates" if name.startswith("Twist") and _RATES.search(topic.topic) else use
        who = sorted({subscriber.node for subscriber in topic.subscribers if subscriber.type == kind})
        senders = sorted({one.node for one in topic.publishers})
        yield CommandInput(topic.topic, kind, who, senders, use, not set(who) <= idle)


def _actions(graph: GraphSnapshot) -> Iterator[tuple[str, str, Sequence[str]]]:
    """Yield each action with its type and its servers."""
    for topic in graph.topics.values():
        action, _, part = topic.topic.rpartition("/_action/")
        if part == "feedback" and (servers := sorted({one.node for one in topic.publishers})):
            yield action, topic.types[0].removesuffix(_FEEDBACK), servers
