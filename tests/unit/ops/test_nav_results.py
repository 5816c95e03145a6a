"""What results of Nav2 say in the first line, and whose goal a goal of its servers is carried out for."""

from __future__ import annotations

from ros2_mcp.model.nav2 import FOLLOW_WAYPOINTS, NAVIGATE
from ros2_mcp.ops.actions.nav_results import told_by_result
from ros2_mcp.ops.actions.running import RunningGoal, from_above


def test_missed_waypoints_are_told_with_their_codes() -> None:
    missed = {"missed_waypoints": [{"index": 1, "error_code": 208}], "error_code": 0}
    assert told_by_result(FOLLOW_WAYPOINTS, missed).startswith("MISSED 1 waypoint: poses[1] (NO_VALID_PATH (208)")
    assert told_by_result(FOLLOW_WAYPOINTS, {"missed_waypoints": [0, 2]}) == "MISSED 2 waypoints: poses[0], poses[2]."


def test_waypoints_that_were_skipped_or_failed_are_told() -> None:
    statuses = [{"waypoint_index": one, "waypoint_status": status} for one, status in enumerate((1, 3, 2))]
    told = told_by_result("nav2_msgs/action/NavigateThroughPoses", {"waypoint_statuses": statuses})
    assert told == "MISSED 2 waypoints: poses[1] failed, poses[2] skipped."


def test_nothing_is_told_where_all_went_well_or_of_other_actions() -> None:
    assert told_by_result(NAVIGATE, {"error_code": 0, "error_msg": ""}) == ""
    assert told_by_result("other_msgs/action/Go", {"missed_waypoints": [1]}) == ""


def test_a_goal_below_is_told_with_the_one_that_it_is_carried_out_for() -> None:
    path = RunningGoal("/follow_path", "nav2_msgs/action/FollowPath", "2" * 32, "EXECUTING")
    pose = RunningGoal("/navigate_to_pose", NAVIGATE, "1" * 32, "EXECUTING")
    tour = RunningGoal("/follow_waypoints", FOLLOW_WAYPOINTS, "3" * 32, "EXECUTING")
    other = RunningGoal("/b/follow_path", "nav2_msgs/action/FollowPath", "4" * 32, "EXECUTING")
    assert [goal.action_name for goal in from_above([path])] == ["/follow_path"]
    found = from_above([path, pose, other])
    assert [(goal.action_name, goal.delegated_to) for goal in found] == [
        ("/navigate_to_pose", ["/follow_path"]),
        ("/b/follow_path", []),
    ]
    assert [goal.action_name for goal in from_above([tour, pose, path])] == ["/follow_waypoints"]
