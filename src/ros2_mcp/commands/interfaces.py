"""Build interface packages for a ROS 2 that was installed from wheels."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ros2_mcp.link.environment import find_ros
from ros2_mcp.link.interfaces import InterfaceCache, build
from ros2_mcp.settings import Settings


def build_interfaces(settings: Settings, directories: Sequence[Path]) -> int:
    """Build the packages and print their folders; the server uses them from its next start on. Return 2 if a definition
    was skipped, which the builder has reported.
    """
    built = build(find_ros(settings), directories, InterfaceCache(settings.interface_folder))
    for package in built.packages:
        print(package)
    return 2 if built.left_out else 0
