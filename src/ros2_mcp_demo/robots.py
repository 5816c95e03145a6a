"""The simulated robots by name. A robot is a module with `build(seed, namespace)` and `GOES_WITHOUT`.

`build` gives its simulation, which has `step(dt)`, `now` in s and `heartbeat()`, and its nodes, each a `RobotPart`, in
the order in which they tick. `GOES_WITHOUT` has pairs of a module that may be missing (then None) and what is left out.
A module that has a `STACK` can be given faults by name: parts that join it or leave it are in its `joined` and `left`.
A module may have `late(simulation, namespace, parts)`, which is asked once a second until it gives nodes that join.
"""

# pyright: basic
from __future__ import annotations

import importlib

ROBOTS = {
    "rover": "ros2_mcp_demo.rover",
    "arm": "ros2_mcp_demo.arm.robot",
    "drone": "ros2_mcp_demo.drone.robot",
    "nav2": "ros2_mcp_demo.nav2.robot",
}
"""Name and module of each. `ros2_mcp.commands.simulation` has the interface packages that each wants."""


def named(name):
    """The module of the robot of that name; it is imported now, after rclpy."""
    return importlib.import_module(ROBOTS[name])


def left_out(robot):
    """What a robot goes without on this installation, one phrase for each missing package."""
    return [what for package, what in robot.GOES_WITHOUT if package is None]
