"""Calls as an agent makes them on the simulated robot: what the model reads of them is measured."""

from __future__ import annotations

from collections.abc import Mapping

from support.clients.script import Call

_POSITION = "import robot\np = robot.latest('/odom')\nprint('x is', round(p['pose']['pose']['position']['x'], 3))"

CALLS: Mapping[str, Call] = {
    "robot": Call("ros2_robot"),
    "topic list": Call("ros2_topic_list"),
    "odometry": Call("ros2_topic_subscribe", {"topic_name": "/odom"}),
    "odometry × 5": Call("ros2_topic_subscribe", {"topic_name": "/odom", "message_limit": 5}),
    "scan": Call("ros2_topic_subscribe", {"topic_name": "/scan"}),
    "camera": Call("ros2_topic_subscribe", {"topic_name": "/camera/image_raw"}),
    "scene": Call("ros2_scene"),
    "transform": Call("ros2_tf_lookup", {"target": "map", "source": "base_link"}),
    "health": Call("ros2_health_check"),
    "statistics": Call("ros2_topic_stats", {"topic_names": ["/odom", "/scan"]}),
    "publish": Call(
        "ros2_topic_publish",
        {"topic_name": "/cmd_vel", "data": {"linear": {"x": 0.05}}, "frequency": 10, "duration": 0.5},
    ),
    "drive": Call("ros2_drive", {"distance_m": 0.1}),
    "program": Call("ros2_program_run", {"program": _POSITION}),
    "program that fails": Call("ros2_program_run", {"program": "print('before')\nx = 1 / 0"}),
    "navigate": Call("ros2_navigate", {"to": [{"x": 0.5, "y": 0.0}], "timeout_s": 20}),
    "parameters": Call("ros2_parameter_list"),
    "transforms × 200": Call("ros2_topic_subscribe", {"topic_name": "/tf", "message_limit": 200, "duration": 10}),
    "hostile text": Call("ros2_topic_subscribe", {"topic_name": "/note"}),
    "log": Call("ros2_log_read"),
    "unknown topic": Call("ros2_topic_subscribe", {"topic_name": "/no_such_topic"}),
    "unknown field": Call("ros2_topic_publish", {"topic_name": "/cmd_vel", "data": {"linear": {"z9": 1}}}),
}
"""By the name that the table has for it."""
REFUSED = ("unknown topic", "unknown field")
"""Calls that end in an error; all others must succeed, but for the program that fails."""
