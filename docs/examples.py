"""Asks the simulated robots with each tool, over stdio, and writes what was answered to docs/reference/examples.json.

docs/generate.py puts these examples into docs/reference/tools.md. Run it where a tool's answer has changed its form:
`PYTHONPATH=tests python docs/examples.py` (a minute), then `python docs/generate.py`. Numbers differ from run to run.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from socket import gethostname
from typing import Any

from mcp import ClientSession, StdioServerParameters
from mcp.client.stdio import stdio_client

from ros2_mcp.commands.simulation import Graph
from support.demo_robot import build_interfaces, robot_environment, running_robot

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs/reference/examples.json"
ROBOTS_STATE_S = 4.0
"""Before the first question, so that rates and ages are those of a running robot."""
MOST_LINES, MOST_CHARACTERS = 20, 240
"""Of an answer, and of a line of it, in the documentation: enough to see its form."""

STRING, NAVIGATE = "std_msgs/msg/String", "/navigate_to_pose"
AT_2_HZ = {"transform": "rate_limit", "target_rate_hz": 2}
IN_MAP = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}, "orientation": {"w": 1}}}


@dataclass(frozen=True, slots=True)
class Example:
    """A call worth showing.

    Attributes:
        arguments: As they are sent. A text `{name}` is replaced by what an earlier answer told.
        then: Names and regular expressions of what later calls need of this answer.
    """

    tool: str
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    then: Mapping[str, str] = field(default_factory=dict[str, str])


ROVER = (
    Example("ros2_robot"),
    Example("ros2_status"),
    Example("ros2_node_list"),
    Example("ros2_policy"),
    Example("ros2_get_message_fields", {"message_type": "geometry_msgs/msg/TwistStamped"}),
    Example("ros2_interface_list", {"package": "nav2_msgs", "kind": "action"}),
    Example("ros2_topic_list", {"pattern": "scan"}),
    Example("ros2_topic_info", {"topic_name": "/scan"}),
    Example("ros2_topic_subscribe", {"topic_name": "/odom", "message_limit": 2, "fields": ["pose.pose.position"]}),
    Example(
        "ros2_subscribe_multiple_topics",
        {"topics": [{"topic_name": "/odom", "message_limit": 1}, {"topic_name": "/battery_state", "message_limit": 1}]},
    ),
    Example("ros2_topic_echo_wait", {"topic_name": "/battery_state", "fields": ["percentage", "voltage"]}),
    Example("ros2_topic_stats", {"topic_names": ["/scan", "/odom"], "duration_s": 2}),
    Example("ros2_wait_until", {"topic_name": "/battery_state", "condition": "percentage > 0.2", "timeout_s": 10}),
    Example("ros2_health_check"),
    Example("ros2_topic_statistics", {"topic_names": ["/odom"], "fields": ["twist.twist.linear.x"], "duration_s": 1}),
    Example("ros2_tf_lookup", {"target": "map", "source": "base_link"}),
    Example("ros2_tf_tree", {"picture": False}),
    Example("ros2_scene", {"radius_m": 3}),
    Example("ros2_plot", {"series": ["/odom:twist.twist.linear.x"], "duration_s": 2}),
    Example("ros2_get_map_as_image"),
    Example("ros2_log_read", {"level": "info", "limit": 3}),
    Example("ros2_record_start", {"topic_names": ["/odom", "/scan"], "name": "first_drive"}),
    Example("ros2_drive", {"distance_m": 0.3}),
    Example("ros2_record_status"),
    Example("ros2_record_stop", then={"bag": r"\w*first_drive\w*"}),
    Example("ros2_bag_list", {"pattern": "first_drive"}),
    Example("ros2_bag_info", {"bag": "{bag}"}),
    Example(
        "ros2_bag_read", {"bag": "{bag}", "topic_name": "/odom", "message_limit": 1, "fields": ["pose.pose.position"]}
    ),
    Example("ros2_get_messages", {"topic_name": "/odom", "number_of_messages": 1, "fields": ["pose.pose.position"]}),
    Example("ros2_bag_play", {"bag": "{bag}", "topic_names": ["/odom"], "remaps": {"/odom": "/odom_played"}}),
    Example("ros2_bag_play_status"),
    Example("ros2_bag_play_stop"),
    Example(
        "ros2_topic_publish",
        {"topic_name": "/greeting", "data": {"data": "hello"}, "message_type": "std_msgs/msg/String"},
    ),
    Example(
        "ros2_publish_multiple_topics",
        {
            "topics": [
                {
                    "topic_name": "/greeting",
                    "message_type": "std_msgs/msg/String",
                    "data": {"data": "hello"},
                    "frequency": 5,
                    "duration": 1,
                },
                {
                    "topic_name": "/count",
                    "message_type": "std_msgs/msg/Int32",
                    "data": {"data": 3},
                    "frequency": 2,
                    "duration": 1,
                },
            ]
        },
    ),
    Example(
        "ros2_move_until",
        {
            "topic_name": "/scan",
            "condition": "nearest(-20, 20) < 1.0",
            "linear_x": 0.2,
            "timeout_s": 4,
            "max_distance_m": 0.4,
        },
    ),
    Example("ros2_service_list", {"pattern": "costmap"}),
    Example("ros2_service_call", {"service_name": "/reset_odometry"}),
    Example("ros2_list_actions"),
    Example("ros2_nav_check"),
    Example("ros2_nav_preview", {"to": {"x": 1.0, "y": 0.0}}),
    Example("ros2_place_set", {"name": "dock", "x": 0.0, "y": 0.0, "yaw_deg": 0}),
    Example("ros2_place_list"),
    Example("ros2_navigate", {"to": "dock"}),
    Example(
        "ros2_send_action_goal",
        {
            "action_name": "/navigate_to_pose",
            "goal_fields": {
                "pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}, "orientation": {"w": 1}}}
            },
        },
        then={"goal": r"[0-9a-f]{32}"},
    ),
    Example("ros2_action_subscribe_feedback", {"action_name": "/navigate_to_pose", "duration_sec": 1}),
    Example("ros2_action_subscribe_status", {"action_name": "/navigate_to_pose", "duration_sec": 1}),
    Example("ros2_action_status"),
    Example("ros2_cancel_action_goal", {"action_name": "/navigate_to_pose", "goal_id_hex": "{goal}"}),
    Example(
        "ros2_action_request_result", {"action_name": "/navigate_to_pose", "goal_id_hex": "{goal}", "timeout_sec": 5}
    ),
    Example("ros2_node_info", {"node_name": "/lidar"}),
    Example("ros2_parameter_list", {"node_names": ["/base_controller"]}),
    Example("ros2_parameter_get", {"node_name": "/base_controller", "names": ["max_linear_speed"]}),
    Example("ros2_parameter_set", {"node_name": "/base_controller", "values": {"max_linear_speed": 0.4}}),
    Example("ros2_lifecycle_state"),
    Example("ros2_lifecycle_change", {"node_name": "/gripper_driver", "transition": "deactivate"}),
    Example(
        "ros2_relay_start",
        {"source_topic": "/odom", "destination_topic": "/odom_slow", "transform": "rate_limit", "target_rate_hz": 2},
    ),
    Example("ros2_relay_list"),
    Example("ros2_topic_compare", {"topic1_name": "/odom", "topic2_name": "/odom_slow", "duration_sec": 2}),
    Example("ros2_relay_stop"),
    Example("ros2_program_run", {"program": 'robot.latest("/battery_state")["percentage"]'}),
    Example("ros2_program_save", {"name": "battery", "program": "print(1)", "description": "Tells the charge."}),
    Example("ros2_program_list"),
    Example("ros2_audit_read", {"limit": 2}),
    Example("ros2_view", {"topics": ["/odom"], "kind": "plot", "fields": ["twist.twist.linear.x"]}),
    Example("ros2_view_state"),
    Example("ros2_stop"),
)
ARM = (Example("ros2_joint_move", {"joints": {"shoulder_pan_joint": 0.3}}),)
NAV2 = (
    Example("ros2_nav_localize", {"search": True}),
    Example("ros2_nav_map"),
    Example("ros2_nav_dock", {"dock": "charger", "timeout_s": 55}),
    Example("ros2_nav_route", {"to": [{"x": 0.4, "y": 0.0}, {"x": 0.8, "y": 0.0}], "wait_s": 120, "timeout_s": 10}),
    Example("ros2_nav_pause"),
    Example("ros2_nav_recover", {"what": "clear_global"}),
    Example("ros2_nav_probe"),
)
CALLS: Mapping[str, Sequence[Example]] = {"rover": ROVER, "arm": ARM, "nav2": NAV2}


async def answered(robot: str, examples: Sequence[Example], folder: Path) -> list[dict[str, Any]]:
    """What a server beside this robot answers to each."""
    prefixes, domain = build_interfaces(robot, later=True), Graph.private().domain_id
    environment = robot_environment(prefixes, ROS_DOMAIN_ID=str(domain), XDG_STATE_HOME=str(folder))
    options = ["--tools", "all", "--record-dir", str(folder / "recordings"), "--programs", str(folder / "programs")]
    command = StdioServerParameters(command=sys.executable, args=["-m", "ros2_mcp", *options], env=environment)
    with running_robot(prefixes, domain, "--robot", robot):
        async with stdio_client(command) as (incoming, outgoing), ClientSession(incoming, outgoing) as session:
            await session.initialize()
            await asyncio.sleep(ROBOTS_STATE_S)
            return await asked(session, examples, folder)


async def asked(session: ClientSession, examples: Sequence[Example], folder: Path) -> list[dict[str, Any]]:
    """One call after another, with what the earlier ones told."""
    known: dict[str, str] = {}
    told: list[dict[str, Any]] = []
    for example in examples:
        arguments = {
            name: known[value[1:-1]] if isinstance(value, str) and re.fullmatch(r"\{\w+\}", value) else value
            for name, value in example.arguments.items()
        }
        result = await session.call_tool(example.tool, arguments)
        text = "\n".join(part.text for part in result.content if part.type == "text")
        for ours, shown in ((str(folder), "~"), (str(ROOT), "~/ros2-mcp"), (gethostname(), "computer")):
            text = text.replace(ours, shown)
        if result.is_error:
            sys.exit(f"{example.tool} {json.dumps(arguments)}: {text}")
        known |= {name: found.group() for name, look in example.then.items() if (found := re.search(look, text))}
        picture = any(part.type == "image" for part in result.content)
        told.append({"tool": example.tool, "arguments": arguments, "text": shortened(text), "picture": picture})
        print(f"{example.tool} {json.dumps(arguments)}\n{text}\n", file=sys.stderr)  # noqa: T201 - to be looked at
    return told


def shortened(text: str) -> str:
    """The first lines, and how many follow."""
    lines = text.splitlines()
    shown = [line if len(line) <= MOST_CHARACTERS else f"{line[:MOST_CHARACTERS]} …" for line in lines[:MOST_LINES]]
    left_out = len(lines) - len(shown)
    return "\n".join([*shown, f"… {left_out} more lines"] if left_out else shown)


def main() -> None:
    """Writes the file."""
    told: list[dict[str, Any]] = []
    for robot, examples in CALLS.items():
        with tempfile.TemporaryDirectory() as folder:
            told += asyncio.run(answered(robot, examples, Path(folder)))
    EXAMPLES.write_text(json.dumps(told, indent=1, ensure_ascii=False) + os.linesep, encoding="utf-8")


if __name__ == "__main__":
    main()
