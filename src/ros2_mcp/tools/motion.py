"""Tools that move the robot with feedback; the control loop runs on the robot's side."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.motion import drive, until
from ros2_mcp.ops.motion import joints as joint_move
from ros2_mcp.ops.motion.controllers import FOLLOW
from ros2_mcp.ops.results.results import Report
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import Flag, Number, TopicName
from ros2_mcp.tools.declare import tool
from ros2_mcp_common.policy.velocity import HOLD_TYPES, VELOCITY_TYPES
from ros2_mcp_common.wire.limits import MAX_DURATION_S

PLACE = 62
"""Next to publishing: after the tools that only read, before `ros2_stop`."""

VelocityTopic = Annotated[str, Field(description="Velocity topic. Default: from the graph.")]
OdometryTopic = Annotated[str, Field(description="Odometry topic. Default: from the graph.")]
ScanTopic = Annotated[str, Field(description="Scan or cloud topic. Default: from the graph.")]
MetresPerSecond = Annotated[Number, Field(ge=-10, le=10, description="In m/s.")]


@tool(
    title="Drive by odometry",
    risk="actuate",
    does={"publish": tuple(VELOCITY_TYPES)},
    group="motion",
    program="drive",
    finds="forward, back, drive a distance, turn around, rotate",
)
async def ros2_drive(
    robot: Robot,
    session: Session,
    report: Report,
    distance_m: Annotated[Number | None, Field(description="Metres ahead; negative: back.")] = None,
    angle_deg: Annotated[Number | None, Field(description="Degrees to turn in place; positive: left.")] = None,
    radius_m: Annotated[Number | None, Field(description="With angle_deg: radius (m) of an arc ahead.")] = None,
    speed: Annotated[Number | None, Field(description="Speed in m/s; in °/s when it turns in place.")] = None,
    guard_m: Annotated[
        Number | None,
        Field(description="Metres kept free ahead of the outline; default 0.2, 0: off."),
    ] = None,
    topic_name: VelocityTopic = "",
    odometry: OdometryTopic = "",
    scan: ScanTopic = "",
) -> drive.Driven:
    """Drive a distance or turn an angle by odometry, to 2 cm or 1°; returns when the robot stands. Moves the robot.

    Keeps clear of obstacles. Reports how far it came and what ended it. Stops when odometry or scan falls silent, and
    after 1.5 times the expected time + 15 s.
    """
    request = drive.DriveRequest(
        distance_m=distance_m,
        angle_deg=angle_deg,
        radius_m=radius_m,
        speed=speed,
        guard_m=guard_m,
        topic_name=topic_name,
        odometry=odometry,
        scan=scan,
    )
    return await drive.drive(robot, session, request, report)


@tool(
    title="Move until a condition holds",
    risk="actuate",
    does={"publish": tuple(VELOCITY_TYPES)},
    group="motion",
    by_default=False,
    aliases={"timeout": "timeout_s"},
    program="move_until",
    finds="until an obstacle, wall, contact, condition; approach",
)
async def ros2_move_until(
    robot: Robot,
    session: Session,
    report: Report,
    topic_name: TopicName,
    condition: Annotated[str, Field(description='As in ros2_wait_until, such as "nearest(-20, 20) < 0.6" of a scan.')],
    linear_x: MetresPerSecond = 0.0,
    linear_y: MetresPerSecond = 0.0,
    linear_z: MetresPerSecond = 0.0,
    angular_z: Annotated[Number, Field(ge=-10, le=10, description="In rad/s; positive: left.")] = 0.0,
    timeout_s: Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description="Maximum duration in seconds.")] = 10.0,
    max_distance_m: Annotated[
        Number | None, Field(gt=0, le=1000, description="Maximum distance in metres, by odometry.")
    ] = None,
    is_event: Annotated[
        Flag, Field(description="The topic publishes only on events, as a bumper does: it may be silent.")
    ] = False,
    command_topic: VelocityTopic = "",
    odometry: OdometryTopic = "",
) -> until.MovedUntil:
    """Move at a velocity until a message on a topic meets a condition, checked on the robot's side; then stop.

    The robot pauses while the topic or odometry is late; the motion ends when one falls silent. If the condition is
    already met, nothing moves.
    """
    request = until.UntilRequest(
        topic_name=topic_name,
        condition=condition,
        velocity={"linear.x": linear_x, "linear.y": linear_y, "linear.z": linear_z, "angular.z": angular_z},
        timeout_s=timeout_s,
        max_distance_m=max_distance_m,
        is_event=is_event,
        command_topic=command_topic,
        odometry_topic=odometry,
    )
    return await until.move_until(robot, session, request, report)


@tool(
    title="Move joints",
    risk="actuate",
    does={"goal": (FOLLOW,), "publish": tuple(HOLD_TYPES)},
    group="motion",
    by_default=False,
    program="joint_move",
    finds="arm, joints, gripper, head, pan, tilt, manipulator",
)
async def ros2_joint_move(
    robot: Robot,
    session: Session,
    report: Report,
    joints: Annotated[dict[str, Number], Field(description='Targets in rad, or m: {"elbow_joint": 0.5}.')],
    relative: Annotated[Flag, Field(description="Targets are relative to the current positions.")] = False,
    speed: Annotated[
        Number | None, Field(description="Share of each joint's velocity limit, up to 1; default 0.3.")
    ] = None,
    duration_s: Annotated[Number | None, Field(description="Duration in seconds, instead of a speed.")] = None,
    tolerance: Annotated[
        Number, Field(description="Tolerance: a joint has arrived when it is this near (rad or m).")
    ] = joint_move.DEFAULT_TOLERANCE,
    controller: Annotated[
        str, Field(description="Name of the controller, its action or its topic. Default: from the graph.")
    ] = "",
) -> joint_move.JointsMoved:
    """Move joints by name through a joint trajectory controller; returns when they have arrived. Moves the robot.

    Targets are checked against the URDF's limits of position and speed. No path is planned around obstacles.
    """
    request = joint_move.JointRequest(
        joints=joints,
        relative=relative,
        speed=speed,
        duration_s=duration_s,
        tolerance=tolerance,
        controller=controller,
    )
    return await joint_move.move_joints(robot, session, request, report)
