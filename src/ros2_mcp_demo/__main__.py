"""`python -m ros2_mcp_demo`: run the simulated robot until it is told to stop."""

# pyright: basic
from __future__ import annotations

import argparse
import os
import select
import signal
import sys


def main():
    """Run the robot; it ends on SIGINT, on SIGTERM, or with its standard input if asked to."""
    options = _options()
    stop = _StopRequest(options.until_stdin_closes)
    from . import optional
    from .robot import Robot

    robot = Robot(options.seed, options.namespace, options.rate)
    missing = "; left out: " + ", ".join(optional.left_out()) if optional.left_out() else ""
    sys.stdout.write(f"robot ready: {robot.node_count} nodes, seed {options.seed}{missing}\n")
    sys.stdout.flush()
    try:
        robot.run(stop.is_requested)
    finally:
        robot.close()


def _options():
    parser = argparse.ArgumentParser(prog="ros2_mcp_demo", description="A simulated robot of ROS 2 nodes.")
    parser.add_argument("--seed", type=int, default=7, help="of all noise (default %(default)s)")
    parser.add_argument("--namespace", default="", help="put all nodes and topics under this name")
    parser.add_argument("--rate", type=_rate, default=50.0, help="steps a second, 10 to 100 (default %(default)s)")
    parser.add_argument("--until-stdin-closes", action="store_true", help="end when standard input does")
    return parser.parse_args()


def _rate(text):
    rate = float(text)
    if not 10.0 <= rate <= 100.0:
        raise argparse.ArgumentTypeError("must be between 10 and 100")
    return rate


class _StopRequest:
    """Whether it is time to leave."""

    def __init__(self, watch_stdin):
        self._requested = False
        self._watch_stdin = watch_stdin
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def is_requested(self):
        return self._requested or (self._watch_stdin and self._stdin_has_ended())

    def _on_signal(self, _number, _frame):
        self._requested = True

    def _stdin_has_ended(self):
        try:
            readable, _, _ = select.select([0], [], [], 0)
            return bool(readable) and os.read(0, 4096) == b""
        except OSError:
            return True


if __name__ == "__main__":
    main()
