"""How goals end whose navigator dies, freezes or does not cancel, whose bridge dies, or that others have sent: nothing
is said to have ended that goes on. Nav2's servers and its navigator are processes of their own; the base judges.
"""

from __future__ import annotations

import os
import signal
import time

import pytest

from support.agent import FULL, Agent, agent_for, until
from support.commanded import CommandedProcess

FAR = [{"x": 4.0, "y": 0.0}]
FARTHER = [{"x": 8.0, "y": 0.0}]
"""For who shall not get there, however late a busy machine ends it."""
NO_CANCELS = """
policy: 1
name: no-cancels
mode: autonomous
allow:
  - {goal: /navigate_to_pose, type: nav2_msgs/action/NavigateToPose}
"""


def begin(agent: Agent, nav2: CommandedProcess, **arguments: object):
    """A navigation on which the base drives."""
    driving = agent.begin("ros2_navigate", **{"to": FARTHER, "timeout_sec": 50, **arguments})
    until(lambda: nav2.speed() > 0.1 or driving.done())
    assert not driving.done(), driving.result()
    return driving


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_navigator_that_dies_or_freezes_leaves_nothing_driving(nav_agent, nav2, navigator, number) -> None:
    driving = begin(nav_agent, nav2)
    os.kill(navigator.pid, number)
    done = driving.result(60)
    speed, x = nav2.speed(), nav2.x()
    navigator.kill()
    assert done["outcome"] == "failed", done
    assert speed == 0.0 and x < 7.7, "it was not left to drive to the end of its path"
    assert "follow_path" in nav2.cancels()
    assert "/follow_path" in done["note"] and "The robot stands" in done["note"], done["note"]


def test_what_the_policy_does_not_let_be_cancelled_is_waited_for(nav_environment, nav2, navigator, tmp_path) -> None:
    policy = tmp_path / "policy.yaml"
    policy.write_text(NO_CANCELS)
    elsewhere = {**nav_environment, "XDG_STATE_HOME": str(tmp_path)}  # under a policy one server acts on a robot
    with agent_for(elsewhere, "--tools", "all", "--policy", str(policy)) as limited:
        limited.knows("/cmd_vel", "/odom", "/tf")
        limited.until_answered("ros2_parameter_list", node_name="/bt_navigator")
        driving = begin(limited, nav2, to=FAR)
        navigator.kill()
        done = driving.result(60)
        assert done["outcome"] == "failed", done
        assert nav2.speed() == 0.0 and nav2.x() > 3.5, "it drove to the end of its path, and was waited for"
        assert "follow_path" not in nav2.cancels()
        assert "The robot stands" in done["note"], done["note"]


def test_a_goal_outlives_the_bridge_and_its_end_is_seen_by_the_next_one(nav_agent, nav2, navigator) -> None:
    driving = nav_agent.begin("ros2_navigate", to=[{"x": 2.5, "y": 0.0}], timeout_sec=50)
    until(lambda: nav2.speed() > 0.1)
    os.kill(nav_agent.call("ros2_status")["bridge_pid"], signal.SIGKILL)
    done = driving.result(60)
    assert (done["outcome"], done["legs"][0]["outcome"]) == ("reached", "reached"), done
    assert nav2.x() == pytest.approx(2.5, abs=0.5)


def test_a_stop_beside_a_dead_navigator_is_no_end_that_was_not_seen(nav_agent, nav2, navigator) -> None:
    driving = begin(nav_agent, nav2)
    navigator.kill()
    first = nav_agent.call("ros2_stop")
    done = driving.result(60)
    assert not first["confirmed"]
    assert done["outcome"] == "failed", done
    until(lambda: nav2.speed() == 0.0)
    assert "follow_path" in nav2.cancels(), "what went on below was cancelled"
    began = time.monotonic()
    later = nav_agent.call("ros2_stop")
    assert not later["confirmed"] and "navigate_to_pose" in later["note"]
    if FULL:
        assert time.monotonic() - began < 2.5


@pytest.mark.promise("stopping", "names the goals of other clients that run, each with the one call that ends it")
def test_a_stop_names_the_goal_of_another_client_and_the_call_that_ends_it(nav_agent, nav2, navigator) -> None:
    pose = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 8.0}, "orientation": {"w": 1.0}}}
    nav_agent.call(
        "ros2_topic_publish", topic_name="/goal_pose", message_type="geometry_msgs/msg/PoseStamped", data=pose
    )
    until(lambda: nav2.speed() > 0.1)
    stopped = until(lambda: (found := nav_agent.call("ros2_stop"))["running"] and found)  # its state is read in time
    assert not stopped["confirmed"]
    (running,) = stopped["running"]
    assert (running["action_name"], running["delegated_to"]) == ("/navigate_to_pose", ["/follow_path"])
    call = f'ros2_cancel_action_goal(action_name="/navigate_to_pose", goal_id_hex="{running["goal_id"]}")'
    assert call in stopped["note"]
    nav_agent.call("ros2_cancel_action_goal", action_name="/navigate_to_pose", goal_id_hex=running["goal_id"])
    until(lambda: nav2.speed() == 0.0)

    def is_still() -> bool:
        again = nav_agent.call("ros2_stop")
        return again["running"] == [] and again["observed"] == "observed still"

    until(is_still)


def test_a_cancel_that_the_navigator_refuses_is_carried_out_below_it(nav_agent, nav2, navigator) -> None:
    navigator.put(refuses=True)
    driving = begin(nav_agent, nav2)
    nav_agent.call("ros2_stop")
    done = driving.result(60)
    assert done["outcome"] == "failed" and "could not be cancelled" in done["note"], done
    until(lambda: nav2.speed() == 0.0)


def test_a_raw_goal_outlives_the_bridge(nav_agent, nav2, navigator) -> None:
    pose = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 2.0}, "orientation": {"w": 1.0}}}}
    sent = nav_agent.begin(
        "ros2_send_action_goal",
        action_name="/navigate_to_pose",
        action_type="nav2_msgs/action/NavigateToPose",
        goal_fields=pose,
        wait_for_result=True,
        timeout_sec=40,
    )
    until(lambda: nav2.speed() > 0.1)
    os.kill(nav_agent.call("ros2_status")["bridge_pid"], signal.SIGKILL)
    done = sent.result(60)
    assert done["status"] == "SUCCEEDED" and "bridge was lost" in done["note"], done


def test_a_robot_that_goes_on_after_its_navigator_gave_up_is_stopped_and_said(nav_agent, nav2, navigator) -> None:
    navigator.put(gives_up=True)
    done = nav_agent.call("ros2_navigate", to=FARTHER, timeout_sec=50)
    assert done["outcome"] == "failed" and "still moved after its navigator had given up" in done["note"], done
    assert "follow_path" in nav2.cancels() and abs(nav2.speed()) < 0.02
