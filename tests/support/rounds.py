"""Which versions of the tests run: all rounds, or at home only what needs little of the machine."""

from __future__ import annotations

import os

FULL = os.environ.get("ROS2_MCP_FULL", "").strip().lower() in ("1", "true", "yes", "on")

QUICK = os.environ.get("ROS2_MCP_QUICK", "").strip().lower() in ("1", "true", "yes", "on")
"""`.ci/run --quick`: without the tests that need login shells, sshd or Chromium, as where none of them is."""
