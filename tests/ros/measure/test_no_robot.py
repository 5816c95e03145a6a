"""A domain without a robot, and a robot that leaves while the server goes on: everything that lists says so."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from typing import Any

import pytest

from support.agent import FULL, Agent, until
from support.processes import peer_command, running


def test_where_there_is_no_robot_it_is_said_and_health_is_critical(
    agent: Agent, ros_environment: dict[str, str], domain_id: int
) -> None:
    nobody = f"No robot is seen in domain {domain_id}."
    assert nobody in agent.call("ros2_status")["note"]
    for tool in ("ros2_topic_list", "ros2_node_list", "ros2_service_list", "ros2_list_actions"):
        assert nobody in agent.call(tool)["note"], tool
    found = agent.call("ros2_health_check")
    assert (found["verdict"], [row["subject"] for row in found["findings"]]) == ("CRITICAL", ["robot"])
    assert nobody in found["findings"][0]["problem"]
    log = agent.call("ros2_log_read")
    assert log["kept"] or "s since this server subscribed" in log["note"]
    doctor = subprocess.run(
        [sys.executable, "-m", "ros2_mcp", "doctor"], env=ros_environment, capture_output=True, text=True, check=True
    )
    assert f"[note] Robot: {nobody}" in doctor.stdout
    assert doctor.stdout.endswith(f"\n\nROS 2 is found and the bridge starts. {nobody}\n")


ASKED: dict[str, dict[str, Any]] = {
    "ros2_action_request_result": {"action_name": "/dock", "goal_id_hex": "ab" * 16, "timeout_sec": 1},
    "ros2_action_status": {},
    "ros2_action_subscribe_feedback": {"action_name": "/dock"},
    "ros2_action_subscribe_status": {"action_name": "/dock"},
    "ros2_cancel_action_goal": {"action_name": "/dock", "cancel_all": True},
    "ros2_drive": {"distance_m": 1},
    "ros2_get_map_as_image": {},
    "ros2_get_pointcloud_as_bev": {},
    "ros2_joint_move": {"joints": {"elbow": 1}},
    "ros2_lifecycle_state": {},
    "ros2_log_read": {},
    "ros2_move_until": {"topic_name": "/scan", "condition": "range_max > 1", "linear_x": 0.1},
    "ros2_nav_dock": {"dock": "home"},
    "ros2_nav_localize": {"at": {"x": 1, "y": 0, "yaw_deg": 0}},
    "ros2_nav_map": {"what": "save", "path": "/maps/floor"},
    "ros2_nav_probe": {},
    "ros2_nav_recover": {"stack": "pause"},
    "ros2_nav_preview": {"to": {"x": 1, "y": 0}},
    "ros2_navigate": {"to": [{"x": 1, "y": 0}]},
    "ros2_parameter_get": {"node_name": "/driver", "names": ["rate"]},
    "ros2_plot": {"series": ["/odom:pose.pose.position.x"]},
    "ros2_robot": {},
    "ros2_scene": {},
    "ros2_send_action_goal": {"action_name": "/dock", "goal_fields": {}},
    "ros2_service_call": {"service_name": "/reset", "timeout_sec": 1},
    "ros2_tf_lookup": {"target": "map", "source": "base_link"},
    "ros2_tf_tree": {},
    "ros2_topic_info": {"topic_name": "/scan"},
    "ros2_topic_publish": {"topic_name": "/cmd_vel", "data": {}},
    "ros2_topic_statistics": {"topic_names": ["/scan"]},
    "ros2_topic_stats": {"topic_names": ["/scan"]},
    "ros2_topic_subscribe": {"topic_name": "/scan"},
    "ros2_wait_until": {"topic_name": "/scan", "condition": "range_max > 1"},
}
"""Tools that want a robot, beside those that list."""


@pytest.mark.parametrize("tool", ASKED)
def test_without_a_robot_every_tool_says_the_same_sentence(agent: Agent, domain_id: int, tool: str) -> None:
    told = " ".join(getattr(part, "text", "") for part in agent.whole(tool, ASKED[tool]).content)
    assert f"No robot is seen in domain {domain_id}." in told


def test_a_robot_that_has_left_is_missed_by_its_names(agent: Agent, ros_environment: dict[str, str]) -> None:
    with running(ros_environment, *peer_command("signal_peer")):
        until(lambda: "/signals" in agent.call("ros2_node_list")["nodes"])
        agent.knows("/signal", "/signal_late", "/pulse").call("ros2_health_check", check_rates=False)
        status = agent.call("ros2_status")
        assert (status["robot_seen"], status["note"]) == (True, "")
        assert "No robot" not in agent.call("ros2_topic_list")["note"]
    until(lambda: not agent.call("ros2_status")["robot_seen"])
    found = agent.call("ros2_health_check")
    assert (found["verdict"], [row["subject"] for row in found["findings"]]) == ("CRITICAL", ["robot"])
    gone = found["findings"][0]["problem"]
    assert "gone: nodes /signals; topics " in gone and "/signal," in gone


def test_names_are_found_by_type_and_a_misspelt_one_is_told_at_once(
    agent: Agent, ros_environment: dict[str, str]
) -> None:
    with running(ros_environment, *peer_command("signal_peer")):
        agent.knows("/signal_late", "/signal_wave", "/signal", "/signal_copy", "/signal_steady")
        listed = agent.call("ros2_topic_list", pattern="msg/PointStamped")["topics"]
        assert {row["topic_name"] for row in listed} == {"/signal", "/signal_copy", "/signal_steady"}
        asked = {"msg_type": "Float64", "message_limit": 9}
        waiting = agent.begin("ros2_topic_subscribe", topic_name="/not/there", duration=50, **asked)
        begun = time.monotonic()
        told = agent.refusal("ros2_topic_subscribe", topic_name="/signal_waev", **asked)
        assert "Did you mean /signal_wave?" in told
        assert not waiting.done(), "what waits for a name that resembles no other was begun before"
        if FULL:
            assert time.monotonic() - begun < 10  # of the 20 s that it would wait
        lines: list[str] = []

        async def progress(_done: float, _whole: float | None, line: str | None) -> None:
            lines.append(line or "")

        agent.whole("ros2_topic_subscribe", {"topic_name": "/signal_waev", "duration": 0.2}, progress)
        assert lines[0] == "Waiting for the topic /signal_waev. Did you mean /signal_wave?"
        begun = time.monotonic()
        told = agent.refusal(
            "ros2_service_call",
            service_name="/signals/get_parameter",
            service_type="GetParameters",
            fields={"names": []},
        )
        assert "no service" in told and "Did you mean" not in told  # those of every node are not suggested
        assert not waiting.done()
        if FULL:
            assert time.monotonic() - begun < 8  # of the 10 s that it would wait
        waiting.cancel()
        assert agent.call("ros2_get_message_fields", message_type="SetBool")["message_type"] == "std_srvs/srv/SetBool"


def test_a_robot_that_hangs_or_was_killed_is_missed_while_the_graph_still_shows_it(
    agent: Agent, ros_environment: dict[str, str]
) -> None:
    with running(ros_environment, *peer_command("signal_peer")) as robot:
        until(lambda: "/signals" in agent.call("ros2_node_list")["nodes"])
        until(lambda: agent.call("ros2_health_check", rate_check_duration_sec=1)["verdict"] != "CRITICAL")
        robot.send_signal(signal.SIGSTOP)
        found = agent.call("ros2_health_check", rate_check_duration_sec=1)
        robot.send_signal(signal.SIGCONT)
        assert (found["verdict"], found["findings"][0]["subject"]) == ("CRITICAL", "robot")
        assert "none of /signals answers" in found["findings"][0]["problem"]
        robot.kill()
        found = agent.call("ros2_health_check", rate_check_duration_sec=1)
        assert (found["verdict"], found["findings"][0]["subject"]) == ("CRITICAL", "robot")
        problem = found["findings"][0]["problem"]
        assert "none of /signals answers" in problem or "No robot is seen" in problem


def test_a_sensor_that_has_left_while_others_stay_is_critical(agent: Agent, ros_environment: dict[str, str]) -> None:
    with running(ros_environment, *peer_command("signal_peer")):
        with running(ros_environment, *peer_command("stranger_peer", "range")):
            until(lambda: {"/signals", "/stranger"} <= set(agent.call("ros2_node_list")["nodes"]))
            agent.knows("/signal", "/range").call("ros2_health_check", check_rates=False)
        until(lambda: "/stranger" not in agent.call("ros2_node_list")["nodes"])
        until(lambda: "/range" not in [row["topic_name"] for row in agent.call("ros2_topic_list")["topics"]])
        found = agent.call("ros2_health_check", check_rates=False)
        missed = found["findings"][0]
        assert (found["verdict"], missed["severity"], missed["subject"]) == ("CRITICAL", "critical", "/stranger")
        assert missed["problem"].startswith("/stranger has left: no publisher is left on /range")
