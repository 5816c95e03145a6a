"""/joint_state_broadcaster: publishes the joints' positions and velocities on /joint_states."""

# pyright: basic
from __future__ import annotations

from sensor_msgs.msg import JointState

from ..nodes.part import RobotPart


class JointStateBroadcaster(RobotPart):
    """Publishes /joint_states while it is enabled."""

    needs_executor = True

    def __init__(self, robot, namespace):
        super().__init__("joint_state_broadcaster", robot, namespace)
        self.declare_number("rate", 50.0, 1.0, 100.0, "Messages a second")
        self.declare_switch("enabled", True, "Simulated fault: false is silence")
        self._publisher = self.create_publisher(JointState, "joint_states", 10)

    def tick(self, stamp):
        """Publish when it is due."""
        if not self.setting("enabled") or not self.is_due(self.setting("rate")):
            return
        names, positions, velocities = self.robot.measured()
        message = JointState(name=[self.frame(name) for name in names], position=positions, velocity=velocities)
        message.header.stamp = stamp
        self._publisher.publish(message)
