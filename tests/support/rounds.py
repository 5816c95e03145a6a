"""Whether the long versions of the tests run."""

from __future__ import annotations

import os

FULL = os.environ.get("ROS2_MCP_FULL", "").strip().lower() in ("1", "true", "yes", "on")
