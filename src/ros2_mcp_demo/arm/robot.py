"""The complete arm: `python -m ros2_mcp_demo --robot arm`.

It stands on a table in `world`; `tool_link` is its last link. /arm_controller moves the six joints, /gripper_controller
the fingers (0 closed, 0.04 m open).
"""

# pyright: basic
from __future__ import annotations

from .. import optional
from ..nodes.health import Health
from .joint_state_broadcaster import JointStateBroadcaster
from .simulation import Simulation
from .state_publisher import StatePublisher
from .trajectory_controller import TrajectoryController

GOES_WITHOUT = (
    (optional.tf2_msgs, "/tf and /tf_static (no tf2_msgs)"),
    (
        optional.is_expected("control_msgs") or None,
        "the actions /…_controller/follow_joint_trajectory (no control_msgs)",
    ),
)


def build(seed, namespace):
    """Return the simulation, and its nodes in the order in which they tick."""
    simulation = Simulation(seed)
    controllers = [TrajectoryController(simulation, namespace, which) for which in simulation.controllers]
    parts = [*controllers, JointStateBroadcaster(simulation, namespace), StatePublisher(simulation, namespace)]
    return simulation, [*parts, Health(simulation, namespace, parts)]
