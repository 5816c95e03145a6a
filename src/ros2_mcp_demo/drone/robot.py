"""A simulated quadcopter: `python -m ros2_mcp_demo --robot drone`.

It starts at (0, 0) on a meadow, facing north, with a light wind and gusts. It accepts velocity commands on /X3/cmd_vel,
as Gazebo's quadcopter does, and orders through MAVROS's topics and services. Its autopilot behaves like ArduCopter:
arming, modes, take-off, missions, landing, a ceiling, and refusals.
"""

# pyright: basic
from __future__ import annotations

from .. import optional
from .body import Quadcopter
from .simulation import DroneSimulation

GOES_WITHOUT = ((optional.tf2_msgs, "/tf and /tf_static (no tf2_msgs)"),)


def build(seed, namespace):
    """Return the simulation, and its nodes in the order in which they tick."""
    simulation = DroneSimulation(seed)
    parts = [Quadcopter(simulation, namespace)]
    return simulation, [*parts, *late(simulation, namespace, parts)]


def late(simulation, namespace, parts):
    """Return MAVROS's node once its interfaces have been built; an empty list before, and if the node already
    exists."""
    is_there = len(parts) > 1
    if is_there or not (optional.arrived("geographic_msgs", "msg") and optional.arrived("mavros_msgs", "msg", "srv")):
        return []
    from .mavros import Mavros  # it imports packages that may be missing

    return [Mavros(simulation, namespace)]
