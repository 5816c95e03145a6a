"""Interface packages that may be missing in this ROS installation; features that need them are omitted and named."""

# pyright: basic
from __future__ import annotations

import importlib
import os
import sys
from typing import Any


def module(name: str) -> Any:
    """Return a module, or None if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def arrived(package: str, *names: str) -> list[Any]:
    """Return modules of a package that may be built while the robot runs; an empty list unless all exist."""
    importlib.invalidate_caches()
    found = [module(f"{package}.{name}") for name in names]
    return [] if None in found else found


def is_expected(package: str) -> bool:
    """Whether a package is installed, or has an entry in the search path, which is empty while it is being built."""
    return module(package) is not None or any(f"{os.sep}{package}-" in entry for entry in sys.path)


tf2_msgs = module("tf2_msgs.msg")
demo_services = module("ros2_mcp_demo_interfaces.srv")
demo_actions = module("ros2_mcp_demo_interfaces.action")
lifecycle = module("rclpy.lifecycle")
pillow = module("PIL.Image")
