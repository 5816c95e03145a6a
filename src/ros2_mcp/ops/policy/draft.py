"""Draft a policy from the live graph, with a comment at each line: for an operator, who reads and changes it."""

from __future__ import annotations

import asyncio
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.nav2 import NAVIGATE
from ros2_mcp.model.text import is_name
from ros2_mcp.ops.motion.controllers import FOLLOW, controllers
from ros2_mcp.ops.nodes import parameters
from ros2_mcp.ops.space.description import described
from ros2_mcp.robot import Robot
from ros2_mcp.robot.resolution import is_infrastructure
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp.world.urdf import Joint, Limits
from ros2_mcp_common.policy.polygons import what_is_wrong
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES
from ros2_mcp_common.policy.verbs import is_meta, only_reads

_SAFETY = re.compile(r"collision|safety|e_?stop|emergency|mux|smoother|watchdog|deadman|twist_stamper|speed_limit")
"""Matches names of nodes, topics and services that guard a robot."""
_OWN_LIMITS = re.compile(r"timeout|max.*(vel|speed)|(vel|speed).*max")
"""Matches names of parameters that bound how a base drives."""
_JOINT = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]{0,99}", re.ASCII)
"""Matches a name that is plain text in YAML and in a sentence: a robot could otherwise write
lines of its own into the draft."""
_ODOMETRY = "nav_msgs/msg/Odometry"
_SEND_GOAL = "/_action/send_goal"
_ACKERMANN = "ackermann_msgs/"
_ARM_SPEED, _SLIDE_SPEED, _ARM_SHARE = 0.3, 0.05, 0.3
"""The speed limits of joints: in rad/s, in m/s, and as a share of the velocity limit in the URDF; the least applies.
Slow enough to be watched."""
_MOST = 40
"""The most services that are listed as comments: the services of a small robot. A large robot has hundreds, too many to
read.
"""
_HEAD = """\
# A draft of a policy, made by `ros2-mcp policy init` from the robot in ROS domain {domain}. Read each line, and delete
# what the agent does not need: what no rule allows is refused. Lines behind a # are what else was found.
#   ros2-mcp policy check FILE                      is it right, and what does it say in words?
#   ros2-mcp policy explain FILE 'publish /cmd_vel geometry_msgs/msg/Twist {{"linear": {{"x": 1}}}}'
#   ros2-mcp --policy FILE                          serve under it
# docs/how-to/policy.md says more. Software is no safety function: keep the hardware stop at hand.
policy: 1
name: my-robot
mode: autonomous # or confirm: a person approves what acts; or observe: only reading and stopping
"""
_LIMIT = """\
limits: # hold for these types on every topic, whatever allows them
  base:
    types: [{types}]
    norm: {{linear: 0.2, angular: 0.5}} # m/s and rad/s: the length of the vector
    zero: [linear.z, angular.x, angular.y]
    ramp: {{linear: {{up: 0.5}}, angular: {{up: 1.5}}}} # how fast they may grow, per second
    hold_s: 0.5 # without a new command the zero follows
"""
_CAR_LIMIT = """\
  car:
    types: [{types}]
    range: {{speed: [-0.2, 0.2], steering_angle: [-0.5, 0.5]}} # m/s and rad
    hold_s: 0.5
"""
_FEEDBACK = """\
feedback: # what the robot says of its own speed: it is stopped when it moves although it was told to stand
  topic: {topic}
  # goals: {{linear: 1.0, angular: 2.0}} # what is too fast for a goal: it drives as fast as the robot is set
"""


_KEEP_OUT = """\
# keep_out: # zones that the robot's outline may not enter: docs/how-to/policy.md
#   zones: {{stairs: [[3, 1], [4, 1], [4, 2]]}} # corners in m, in the map
#   {outline}
# pose: {{topic: /tf, frame: map, base: {base}}}
"""
_NO_OUTLINE = "radius_m: 0.3 # or footprint: [[x, y], …]: the robot's outline, which Nav2 does not tell here"


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """A joint trajectory controller: its action and topic ("" if it has none), and the joints that it moves, each with
    its description if the robot has a URDF.
    """

    name: str
    action: str
    topic: str
    joints: Mapping[str, Joint | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """The facts for a draft: `outline` is that of Nav2's local costmap, as a line of a policy, and `base` its frame
    ("": there is none). `inputs` are the velocity topics, `actions` and `services` names with types, `arms` the
    joint trajectory controllers.
    """

    domain: int
    inputs: Sequence[TopicEndpoints]
    odometry: Sequence[str]
    actions: Sequence[tuple[str, str]]
    services: Sequence[tuple[str, str]]
    watching: Sequence[str]
    own_limits: Sequence[str]
    arms: Sequence[Arm] = ()
    outline: str = ""
    base: str = ""


async def draft(robot: Robot) -> str:
    """Return a policy for the robot that is seen now: it allows slow velocities on the robot's inputs, recording, and
    goals for arms with a person's consent; the rest is comments.

    Raises:
        LinkError: if there is no bridge.
    """
    found = await _look(robot)
    return "".join(lines_of_draft(found))


async def _look(robot: Robot) -> Found:
    topics, services, nodes = await asyncio.gather(robot.graph.topics(), robot.graph.services(), robot.graph.nodes())
    # A name that ROS does not allow, or of two lines, would write lines of its own into the draft.
    velocities = [row.name for row in topics if is_name(row.name) and not VELOCITY_TYPES.keys().isdisjoint(row.types)]
    inputs = await asyncio.gather(*map(robot.graph.endpoints, velocities))
    drivers = {endpoint.node for topic in inputs for endpoint in topic.subscribers if is_of_robot(endpoint.node)}
    everybody = [*(row.name for row in nodes if is_of_robot(row.name)), *(row.name for row in (*topics, *services))]
    asked = [(row.name, row.types[0]) for row in services if row.types and is_name(row.name) and is_name(row.types[0])]
    outline, base = await _outline(
        robot, [row.name for row in nodes if row.name.endswith("/local_costmap") and is_name(row.name)]
    )
    return Found(
        domain=robot.graph.domain_id or 0,
        outline=outline,
        base=base,
        inputs=[topic for topic in inputs if topic.subscribers or topic.publishers],
        odometry=[row.name for row in topics if _ODOMETRY in row.types and row.publishers and is_name(row.name)],
        actions=[
            (name.removesuffix(_SEND_GOAL), kind.removesuffix("_SendGoal"))
            for name, kind in asked
            if name.endswith(_SEND_GOAL)
        ],
        services=[
            (name, kind)
            for name, kind in asked
            if not (names.is_hidden(name) or is_infrastructure(name, [kind]) or is_meta(kind) or only_reads(kind))
        ],
        watching=sorted(
            {name for name in everybody if is_name(name) and _SAFETY.search(name.lower()) and not names.is_hidden(name)}
        ),
        own_limits=await _own_limits(robot, sorted(drivers)),
        arms=await _arms(robot),
    )


async def _arms(robot: Robot) -> Sequence[Arm]:
    """Return the joint trajectory controllers whose joints are known."""
    found = [one for one in (await controllers(robot)).values() if is_name(one.interface) and one.joints]
    joints: Mapping[str, Joint] = {}
    with suppress(RobotError):  # no description, several, or an unreadable one: the draft says so
        joints = (await described(robot)).joints if found else joints
    return [
        Arm(name=one.name, action=one.action, topic=one.topic, joints={name: joints.get(name) for name in one.joints})
        for one in found
        if all(map(_JOINT.fullmatch, one.joints))
    ]


async def _outline(robot: Robot, costmaps: Sequence[str]) -> tuple[str, str]:
    """Return the robot's outline as Nav2's local costmap has it, as a line of a policy, and the frame of its base."""
    try:
        listing = await parameters.describe(robot, costmaps[:1]) if costmaps else None
    except RobotError:
        return "", ""
    told = {one.name: one.value for node in listing.nodes for one in node.parameters} if listing else {}
    base = str(told.get("robot_base_frame", ""))
    base = base if is_name(base) else ""
    beside = f" # as {costmaps[0]} has it, without its footprint_padding" if costmaps else ""
    with suppress(ValueError, TypeError):
        corners = [(float(x), float(y)) for x, y in json.loads(str(told.get("footprint", "")))]
        if not what_is_wrong(corners):
            return f"footprint: {json.dumps(corners)}{beside}", base
    with suppress(ValueError, TypeError):
        radius_m = float(str(told.get("robot_radius", "")))
        return (f"radius_m: {radius_m:g}{beside}" if 0.01 <= radius_m <= 100 else ""), base
    return "", base


async def _own_limits(robot: Robot, nodes: Sequence[str]) -> list[str]:
    """Return the parameters by which the drivers bound the motion, with their values."""
    if not nodes:
        return []
    try:
        listing = await parameters.describe(robot, nodes)
    except RobotError:
        return []
    return [
        f"{node.node} {parameter.name}: {json.dumps(parameter.value)}"
        for node in listing.nodes
        for parameter in node.parameters
        if is_name(parameter.name) and _OWN_LIMITS.search(parameter.name.lower())
    ]


# ── as text ────────────────────────────────────────────────────────────────────────────────────────────────────────


def lines_of_draft(found: Found) -> Iterator[str]:
    """Yield the text of the draft, in pieces."""
    yield _HEAD.format(domain=found.domain)
    yield "allow:\n"
    for topic in found.inputs:
        yield from _input(topic)
    yield "  - record: /**\n"
    for arm in found.arms:
        yield from _allowed_arm(arm)
    arms = [arm.action for arm in found.arms]
    for action, kind in (each for each in found.actions if each[0] not in arms):
        yield f"  # - {{goal: {action}, type: {kind}, consent: each}} # bound its fields with `fields:`\n"
    if found.services:
        yield "  # Services: allow those of which you know what they do; nothing here does.\n"
    for service, kind in found.services[:_MOST]:
        yield f"  # - {{call: {service}, type: {kind}}}\n"
    if (left := len(found.services) - _MOST) > 0:
        yield f"  # and {left} more services: ros2-mcp call ros2_service_list\n"
    yield "  # - {set: /NODE, names: [PARAMETER]} # parameters of a node: ros2-mcp call ros2_parameter_list\n"
    yield "# forbid: [{publish: /joy}] # stays forbidden, whatever allows it\n"
    yield from _limits(found)
    yield from _watched(found)


def _input(topic: TopicEndpoints) -> Iterator[str]:
    """Yield the rule for a velocity topic: allowed if nodes of the robot subscribe to it and none publishes on it."""
    readers = _listed(endpoint.node for endpoint in topic.subscribers)
    writers = _listed(endpoint.node for endpoint in topic.publishers)
    if writers:
        yield f"  # Not {topic.topic}: {writers} of the robot publishes there, and the agent would fight it.\n"
    elif readers:
        yield f"  - publish: {topic.topic} # {readers} drives by it\n"
        yield f"    types: [{', '.join(kind for kind in topic.types if kind in VELOCITY_TYPES)}]\n"
        yield "    sole_publisher: true # refused while a node of the robot publishes there\n"
        yield "    rate_hz: 50\n    for_s: 10 # at a time\n"


def _limits(found: Found) -> Iterator[str]:
    types = sorted({kind for topic in found.inputs for kind in topic.types if kind in VELOCITY_TYPES})
    cars = [kind for kind in types if kind.startswith(_ACKERMANN)]
    others = [kind for kind in types if kind not in cars] or [
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
    ]
    yield _LIMIT.format(types=", ".join(others))
    if cars:
        yield _CAR_LIMIT.format(types=", ".join(cars))
    for place, arm in enumerate(arm for arm in found.arms if arm.action):
        yield from _arm_limit(arm, f"arm_{place + 1}")


def _allowed_arm(arm: Arm) -> Iterator[str]:
    """Yield the rule for a trajectory controller: its goals are allowed, each after a person has approved it."""
    if arm.action:
        yield f"  - goal: {arm.action} # {arm.name} moves {', '.join(arm.joints)}\n    type: {FOLLOW}\n"
        yield "    consent: each # nobody but a person sees what stands around; never, where nothing does\n"
    if arm.topic:
        yield f"  # Not {arm.topic}: unlike a goal, a trajectory on a topic does not say how it went.\n"


def _arm_limit(arm: Arm, name: str) -> Iterator[str]:
    """Yield the limits of an arm's joints all along each trajectory: within their limits in the URDF, and slower."""
    yield f"  {name}: # {arm.name}\n    types: [{FOLLOW}]\n    names: [{arm.action}]\n"
    yield "    curve: # all along what the controller follows through the points, from where the joints are\n"
    yield "      trajectory:\n"
    yield "        acceleration: 1 # per second²; between a planner's points it is up to 1.75 times that at them\n"
    yield "        step: 0.3 # of the speed, at a point: points without velocities are joined by straight lines\n"
    yield "        joints: # no other may be moved; positions in rad (m), speeds per second\n"
    for joint, told in arm.joints.items():
        limits, is_slide = (told.limits if told else Limits()), bool(told and told.kind == "prismatic")
        speed = min(_SLIDE_SPEED if is_slide else _ARM_SPEED, _ARM_SHARE * (limits.velocity or math.inf))
        known = limits.known and limits.lower is not None and limits.upper is not None
        position = f"position: [{limits.lower:g}, {limits.upper:g}], " if known else ""
        unknown = "it turns without end" if told else "the robot has no description of it: add position"
        why = "" if known else f" # {unknown}"
        yield f"          {joint}: {{{position}speed: {speed:.3g}}}{why}\n"
    yield "    each:\n      trajectory.points[].effort[]: [0, 0]\n"
    yield "      path_tolerance[].position: [0, 0.2]\n      goal_tolerance[].position: [0, 0.2]\n"
    yield "    count: {trajectory.points: [1, 200], multi_dof_trajectory.points: [0, 0]}\n"


def _watched(found: Found) -> Iterator[str]:
    if found.odometry:
        yield _FEEDBACK.format(topic=found.odometry[0])
    else:
        yield "# No odometry was found: nothing here can see whether the robot stands still.\n"
    if any(kind == NAVIGATE for _, kind in found.actions):
        yield _KEEP_OUT.format(outline=found.outline or _NO_OUTLINE, base=found.base or "base_footprint")
    if found.watching:
        yield "# What seems to watch over this robot; no rule above lets the agent switch it off:\n"
        yield from (f"#   {name}\n" for name in found.watching)
    else:
        yield "# Nothing was found that seems to watch over this robot, such as a collision monitor or a multiplexer.\n"
    if found.own_limits:
        yield "# Limits and time-outs of its own drivers, which hold beside these:\n"
        yield from (f"#   {line}\n" for line in found.own_limits)


def _listed(nodes: Iterator[str]) -> str:
    return ", ".join(sorted({node for node in nodes if is_of_robot(node) and is_name(node)}))
