"""`python -m ros2_mcp_demo`: run a simulated robot until a signal, or the end of standard input, stops it."""

# pyright: basic
from __future__ import annotations

import argparse
import os
import select
import signal
import sys
import threading

from .robots import ROBOTS, left_out, named

# Fast DDS hangs in about one of a hundred shutdowns and blocks Python; then the kernel ends the process. A robot
# normally ends within a second, later on a busy machine. See docs/known-races.md.
LEAVES_S = 8.0


def main():
    """Run the robot until SIGINT, SIGTERM or, with --until-stdin-closes, the end of standard input."""
    parser = argparse.ArgumentParser(prog="ros2_mcp_demo", description="A simulated robot of ROS 2 nodes.")
    parser.add_argument("--robot", choices=ROBOTS, default="rover", help="which one (default %(default)s)")
    parser.add_argument("--seed", type=int, default=7, help="of all noise (default %(default)s)")
    parser.add_argument("--namespace", default="", help="put all nodes and topics under this name")
    parser.add_argument("--rate", type=_rate, default=50.0, help="steps a second, 10 to 100 (default %(default)s)")
    parser.add_argument("--faults", default="", help="of the robot nav2: names to plant, separated by semicolons")
    parser.add_argument("--until-stdin-closes", action="store_true", help="end when standard input does")
    options = parser.parse_args()
    signalled = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: signalled.set())
    # Imported after the signal handlers: it takes a second or more, and a signal must end the robot cleanly meanwhile.
    from .robot import Robot

    chosen = named(options.robot)
    if options.faults:
        from .nav2.faults import FAULTS, PLANTED, unknown

        PLANTED.extend(options.faults.split(";"))
        for name in PLANTED:
            if name not in FAULTS:
                parser.error(unknown(name))
    robot = Robot(chosen, options.seed, options.namespace, options.rate)
    missing = "; left out: " + ", ".join(left_out(chosen)) if left_out(chosen) else ""
    sys.stdout.write(f"robot ready: {robot.node_count} nodes, seed {options.seed}{missing}\n")
    sys.stdout.flush()
    try:
        robot.run(lambda: signalled.is_set() or (options.until_stdin_closes and _stdin_has_ended(chosen)))
    finally:
        signal.setitimer(signal.ITIMER_REAL, LEAVES_S)
        robot.close()


def _rate(text):
    rate = float(text)
    if not 10.0 <= rate <= 100.0:
        raise argparse.ArgumentTypeError("must be between 10 and 100")
    return rate


def _stdin_has_ended(chosen):
    """Whether standard input has ended. A robot with faults also executes its lines `plant NAME` and `heal NAME`."""
    try:
        readable, _, _ = select.select([0], [], [], 0)
        if not readable:
            return False
        text = os.read(0, 4096)
    except OSError:
        return True
    for line in text.decode().splitlines() if hasattr(chosen, "STACK") else ():
        from .nav2.faults import obey

        sys.stdout.write(f"{obey(chosen.STACK, line)}\n")
        sys.stdout.flush()
    return text == b""


if __name__ == "__main__":
    main()
