"""What needs many rounds, long times or a quiet machine is run only when it is asked for."""

from __future__ import annotations

import os

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if os.environ.get("ROS2_MCP_FULL"):
        return
    skip = pytest.mark.skip(reason="set ROS2_MCP_FULL=1 on a quiet machine")
    for item in items:
        if item.get_closest_marker("full"):
            item.add_marker(skip)
