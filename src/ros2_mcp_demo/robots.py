"""The simulated robots by name. A robot is a module with `build(seed, namespace)` and `GOES_WITHOUT`.

`build` returns its simulation, with `step(dt)`, `now` in s and `heartbeat()`, and its nodes, each a `RobotPart`, in the
order in which they tick. `GOES_WITHOUT` has pairs of a module that may be missing (then None) and the feature that is
then omitted. A module with a `STACK` can be given faults by name: nodes in its `joined` join the robot, those in `left`
leave it. A module may have `late(simulation, namespace, parts)`, which is called once a second until it returns nodes
that join.
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
"""Robot name → module. `ros2_mcp.commands.simulation` has the interface packages that each needs."""


def named(name):
    """Return the module of a robot; it is imported on this call, after rclpy."""
    return importlib.import_module(ROBOTS[name])


def left_out(robot):
    """Return the features that a robot lacks on this installation, one phrase for each missing package."""
    return [what for package, what in robot.GOES_WITHOUT if package is None]
