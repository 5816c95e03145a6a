"""The bridge, whose ROS thread hangs when it is asked for `stats`; its other threads go on."""

import time
from typing import Any

from ros2_mcp_bridge import operations
from ros2_mcp_bridge.__main__ import main

HANG_S = 60.0
"""Longer than any test waits."""


def hang(*_: Any) -> None:
    time.sleep(HANG_S)


operations.Operations._stats = hang
main()
