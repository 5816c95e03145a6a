"""What is seen of a navigation on its way, and Nav2's own ways out: each measured. Nav2's servers and its navigator are
processes of their own; the base judges.
"""

from __future__ import annotations

import pytest

from support.agent import Agent, until
from support.commanded import CommandedProcess

FAR = [{"x": 6.0, "y": 0.0}]


@pytest.fixture(autouse=True)
def standing(nav2: CommandedProcess) -> None:
    """Each test begins with a base that stands at the start, and servers that are active."""
    until(lambda: nav2.speed() == 0.0)
    nav2.put()


def until_seen(agent: Agent, *words: str) -> dict:
    """The state of a navigation as soon as it tells these words; it is ended."""
    begun = agent.call("ros2_navigate", to=FAR, timeout_sec=0)
    job = begun["job_id"]
    try:
        return until(
            lambda: (
                (now := agent.call("ros2_navigate", job_id=job, timeout_sec=0.5))
                and all(one in str(now["health"]) for one in words)
                and now
            )
        )
    finally:
        agent.call("ros2_stop")


# ── on the way ─────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_robot_that_is_commanded_and_does_not_move_is_told(nav_agent, nav2, navigator) -> None:
    nav2.put(motors=False)
    seen = until_seen(nav_agent, "COMMANDED AND NOT MOVING")
    assert "0.30 m/s on /cmd_vel, and /odom reports 0.00 m/s" in seen["health"][0]


def test_the_polygon_that_holds_the_robot_is_told_while_it_drives(nav_agent, nav2, navigator) -> None:
    begun = nav_agent.call("ros2_navigate", to=FAR, timeout_sec=0)
    until(lambda: nav2.speed() > 0.1)

    def is_told() -> bool:
        """The monitor publishes its state once: again, for a watch that a busy machine delays."""
        nav2.hold(polygon="")
        nav2.hold(polygon="PolygonStop")
        now = nav_agent.call("ros2_navigate", job_id=begun["job_id"], timeout_sec=0.5)
        return "holds the robot" in str(now["health"])

    until(is_told)
    nav2.hold(polygon="")
    nav_agent.call("ros2_stop")


def test_a_recovery_and_a_longer_way_are_told_by_name(nav_agent, nav2, navigator) -> None:
    navigator.put(recovers=True, longer_m=4.0)
    seen = until_seen(nav_agent, "Nav2 recovers: spin", "became 4.0 m longer")
    assert seen["legs"][0]["recovered_by"] == "spin"


def test_a_navigation_that_is_stuck_ends_by_itself_where_that_is_asked_for(nav_agent, nav2, navigator) -> None:
    nav2.put(motors=False)
    done = nav_agent.call("ros2_navigate", to=FAR, timeout_sec=50, stop_when_stuck_s=5)
    assert (done["outcome"], done["legs"][0]["outcome"]) == ("failed", "failed")
    assert "stop_when_stuck_s" in done["note"] and "COMMANDED AND NOT MOVING" in done["note"], done["note"]
    assert "follow_path" in nav2.cancels()


# ── ways out ───────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.promise("ros2_nav_recover", "Reports what was measured: cells cleared, distance and angle by odometry")
def test_moves_and_clearings_are_measured(nav_agent, nav2) -> None:
    backed = nav_agent.call("ros2_nav_recover", what="back_up", amount=0.2)
    assert backed["successful"] and nav2.x() == pytest.approx(-0.2, abs=0.06)
    assert "(-0.2" in backed["measured"] or "(-0.1" in backed["measured"], backed
    turned = nav_agent.call("ros2_nav_recover", what="spin", amount=60)
    assert turned["successful"] and "turned +" in turned["measured"], turned
    before = nav2.cleared()
    cleared = nav_agent.call("ros2_nav_recover", what="clear_global")
    assert cleared["successful"] and nav2.cleared() == before + 1
    assert "0 occupied cells before, 0 occupied cells after" in cleared["measured"], cleared
    assert "Give either what or stack" in nav_agent.refusal("ros2_nav_recover")
    assert "at most 3 m" in nav_agent.refusal("ros2_nav_recover", what="back_up", amount=20)


def test_all_servers_are_paused_and_resumed_and_a_preview_meanwhile_is_unknown_not_impossible(nav_agent, nav2) -> None:
    paused = nav_agent.call("ros2_nav_recover", stack="pause")
    assert paused["successful"] and set(nav2.states().values()) == {"inactive"}
    assert "3 of 4 inactive" in paused["measured"], "the navigator does not run here"
    way = nav_agent.call("ros2_nav_preview", to={"x": 1.0, "y": 0.0})
    assert way["is_feasible"] is None and "/planner_server is inactive" in way["note"]
    nav_agent.call("ros2_nav_recover", stack="resume")
    assert set(nav2.states().values()) == {"active"}
    assert nav_agent.call("ros2_nav_preview", to={"x": 1.0, "y": 0.0})["is_feasible"] is True


def test_a_change_of_one_managed_node_says_whose_it_is_and_what_follows(nav_agent, nav2) -> None:
    state = nav_agent.call("ros2_lifecycle_state", node_names=["/planner_server"])["nodes"][0]
    assert state["managed_by"] == "/lifecycle_manager_navigation"
    changed = nav_agent.call("ros2_lifecycle_change", node_name="/planner_server", transition="deactivate")
    assert changed["state"] == "inactive"
    assert "/lifecycle_manager_navigation" in changed["note"] and "ros2_nav_recover" in changed["note"]


@pytest.mark.promise("ros2_nav_localize", "Reports whether localisation accepted it")
def test_an_initial_pose_is_taken_and_seen_to_be(nav_agent, nav2) -> None:
    told = nav_agent.call("ros2_nav_localize", at={"x": 2.0, "y": 1.0, "yaw_deg": 90})
    assert told["is_taken"] is True and "(2.00, 1.00) facing 90°" in told["after"], told
    assert "before not known (no map is published)" in told["fit"]
    nav_agent.call("ros2_nav_localize", at={"x": 0.0, "y": 0.0, "yaw_deg": 0})
    assert nav_agent.call("ros2_stop")["confirmed"], "an initial pose sets nothing in motion"


def test_waypoints_that_were_missed_stand_in_the_first_line(nav_agent, nav2) -> None:
    nav2.put(missed=[1])
    poses = [{"header": {"frame_id": "map"}, "pose": {"orientation": {"w": 1.0}}}] * 3
    done = nav_agent.call(
        "ros2_send_action_goal",
        action_name="/follow_waypoints",
        action_type="nav2_msgs/action/FollowWaypoints",
        goal_fields={"poses": poses},
        wait_for_result=True,
        force=True,
    )
    assert done["status"] == "SUCCEEDED" and "MISSED 1 waypoint: poses[1] (NO_VALID_PATH" in done["summary"]


def test_a_request_of_nothing_but_an_empty_needs_no_fields(nav_agent, nav2) -> None:
    before = nav2.cleared()
    service = "/global_costmap/clear_entirely_global_costmap"
    assert nav_agent.call("ros2_service_call", service_name=service)["called"]
    assert nav2.cleared() == before + 1
