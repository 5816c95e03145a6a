"""A simulated quadcopter: `python -m ros2_mcp_demo --robot drone`.

It stands at (0, 0) on a meadow, looking north, with a light wind and gusts. It takes velocity commands of its own on
/X3/cmd_vel, as Gazebo's quadcopter does, and orders through MAVROS's topics and services, behind which is an autopilot
that does what ArduCopter does: arming, modes, take-off, missions, landing, a ceiling, and what it refuses.
"""

# pyright: basic
from __future__ import annotations

from .. import optional
from .body import Quadcopter
from .simulation import DroneSimulation

GOES_WITHOUT = ((optional.tf2_msgs, "/tf and /tf_static (no tf2_msgs)"),)


def build(seed, namespace):
    """The simulation, and its nodes in the order in which they tick."""
    simulation = DroneSimulation(seed)
    parts = [Quadcopter(simulation, namespace)]
    return simulation, [*parts, *late(simulation, namespace, parts)]


def late(simulation, namespace, parts):
    """MAVROS, as soon as its interfaces have been built; nothing until then, and where it is there already."""
    is_there = len(parts) > 1
    if is_there or not (optional.arrived("geographic_msgs", "msg") and optional.arrived("mavros_msgs", "msg", "srv")):
        return []
    from .mavros import Mavros  # it imports what an installation may lack

    return [Mavros(simulation, namespace)]
