"""The places and the planned path of a drive, judged by the policy's keep-out zones before its goal is sent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ros2_mcp.guard.policy import Policy
from ros2_mcp.model.errors import Refused, RobotError
from ros2_mcp.model.nav2 import COMPUTE_PATH
from ros2_mcp.ops.navigation.action_names import action_of
from ros2_mcp.ops.navigation.below import idle_server
from ros2_mcp.ops.navigation.planner import planned
from ros2_mcp.ops.navigation.targets import Target
from ros2_mcp.ops.navigation.whereabouts import whereabouts
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.policy.field_values import Unfit
from ros2_mcp_common.policy.keep_out import Entry, KeepOut, Pose, path_of, poses_of, standing

_HINT = "ros2_policy shows the keep-out zones; choose places and a path around them."
_WATCHED = "The bridge ends the drive before a keep-out zone."


def check_places(policy: Policy, targets: Sequence[Target]) -> None:
    """Raise `Refused` if a place is in a keep-out zone or too near to a zone, before the robot drives to the first
    place.

    Places with any heading, and those in other frames, are judged when their goal is sent.
    """
    for keep_out in _zones_of(policy):
        for target in targets:
            if target.yaw_rad is None or target.frame != keep_out.frame_id:
                continue
            if found := keep_out.entry(standing(Pose(target.x_m, target.y_m, target.yaw_rad))):
                raise _refused(f"At the place {target}, {found}", keep_out)


async def judge_path(robot: Robot, session: Session, action: str, target: Target) -> str:
    """Ask the planner for the path to a place, and judge it; return a note if it could not be judged ("": it is clear).

    Without keep-out zones no planner is asked.

    Raises:
        Refused: if the path leads into a keep-out zone, or the robot is in one.
    """
    zones = list(_zones_of(robot.policy))
    if not zones:
        return ""
    frame = zones[0].frame_id
    try:
        planner = await action_of(robot, COMPUTE_PATH, _beside(action))
        if idle := await idle_server(robot, planner):
            return f"The path was not checked: {idle} {_WATCHED}"
        result = await planned(robot, session, planner, {"goal": target.pose(), "use_start": False})
        where = await whereabouts(robot, frame)
    except RobotError as error:
        return f"The path was not checked, because no planner could be asked: {error.message} {_WATCHED}"
    start = None
    if where.x_m is not None and where.y_m is not None and not where.trouble:
        start = Pose(where.x_m, where.y_m, where.yaw_rad or 0.0)
    for keep_out in zones:
        try:
            if problem := _problem(keep_out, result, start):
                raise _refused(problem, keep_out)
        except Unfit as unfit:
            raise _refused(f"The planned path cannot be judged: {unfit}", keep_out) from None
    has_path = bool(result.get("path", {}).get("poses"))
    return "" if has_path else f"The planner found no path that could be checked. {_WATCHED}"


def entered_by(policy: Policy, path: Any) -> str:
    """Return in a sentence where the outline of a robot on this nav_msgs/msg/Path is in a keep-out zone, or too near to
    it; "" if the path is clear."""
    for keep_out in _zones_of(policy):
        try:
            found = keep_out.entry(path_of(poses_of(keep_out, path), keep_out.swing_m))
        except Unfit as unfit:
            return f"Whether it keeps clear of the keep-out zones cannot be judged: {unfit}."
        if found:
            return f"The policy refuses it: {found} ({keep_out.rule})."
    return ""


def _problem(keep_out: KeepOut, result: Mapping[str, Any], start: Pose | None) -> str:
    """Return why a planned path may not be driven; "" if it may."""
    poses = poses_of(keep_out, result["path"]) if result.get("path", {}).get("poses") else ()
    if start:
        here = keep_out.nearest(start)
        if here.distance_m < keep_out.watched_m:
            told = Entry(here.zone, start, here.distance_m).told("is")
            return f"{told}: only a velocity that leads away from it may drive it"
        found = keep_out.entered_from(here, path_of(poses, keep_out.swing_m, start)) if poses else None
    else:
        found = keep_out.entry(path_of(poses, keep_out.swing_m)) if poses else None
    return f"On the planned path {found}" if found else ""


def _beside(action: str) -> str:
    """Return the planner's action in the namespace of a navigator's action; "" if the navigator does not have its usual
    name.
    """
    namespace, _, name = action.rpartition("/")
    return f"{namespace}/compute_path_to_pose" if name == "navigate_to_pose" else ""


def _zones_of(policy: Policy) -> Iterator[KeepOut]:
    return (document.keep_out for document in policy.documents if document.keep_out)


def _refused(problem: str, keep_out: KeepOut) -> Refused:
    return Refused(f"The policy of this robot: {problem} ({keep_out.rule}). Nothing was sent.", _HINT)
