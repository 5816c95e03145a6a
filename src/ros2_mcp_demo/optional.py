"""Interface packages that this ROS installation may lack; what needs them is left out and named."""

# pyright: basic
from __future__ import annotations

import importlib
from typing import Any


def module(name: str) -> Any:
    """The module, or None where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


tf2_msgs = module("tf2_msgs.msg")
demo_services = module("ros2_mcp_demo_interfaces.srv")
demo_actions = module("ros2_mcp_demo_interfaces.action")
lifecycle = module("rclpy.lifecycle")
pillow = module("PIL.Image")


_GOES_WITHOUT = (
    (tf2_msgs, "/tf and /tf_static (no tf2_msgs)"),
    (demo_services, "/set_mode, /spawn_obstacle, /slow_echo (no ros2_mcp_demo_interfaces)"),
    (demo_actions, "/navigate_to (no ros2_mcp_demo_interfaces)"),
    (lifecycle, "/gripper_driver (no rclpy.lifecycle)"),
    (pillow, "/camera/image_raw/compressed (no Pillow)"),
)


def left_out():
    """What the robot goes without, one phrase for each missing package."""
    return [what for package, what in _GOES_WITHOUT if package is None]
