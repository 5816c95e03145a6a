"""The server on a machine whose clock is wrong: `other_clock_server.py SECONDS_AHEAD [options of ros2-mcp]`.

Its bridge is a process of its own and has the right clock, as all nodes have.
"""

from __future__ import annotations

import sys
import time

AHEAD_NS = round(float(sys.argv[1]) * 1e9)
_right_ns = time.time_ns

time.time_ns = lambda: _right_ns() + AHEAD_NS
time.time = lambda: time.time_ns() / 1e9

if __name__ == "__main__":
    from ros2_mcp.cli import run

    sys.exit(run(sys.argv[2:]))
