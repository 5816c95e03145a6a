"""/gripper_driver: a lifecycle node; its gripper moves and publishes its state only while active."""

# pyright: basic
from __future__ import annotations

from typing import Any

from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from ..base import approach
from .lifecycle_part import LifecyclePart
from .part import OK

OPEN, CLOSED = 0.08, 0.0
SPEED = 0.04
RATE = 10.0


class GripperDriver(LifecyclePart):
    """Offers /gripper/close and /gripper/joint_states while it is active, as it is from the start."""

    def __init__(self, robot, namespace):
        super().__init__("gripper_driver", robot, namespace)
        self._opening = self._target = OPEN
        self._publisher: Any = None
        self._service: Any = None

    def on_configure(self, state):
        """Create the topic and the service."""
        self._publisher = self.create_lifecycle_publisher(JointState, "gripper/joint_states", 10)
        self._service = self.create_service(SetBool, "gripper/close", self._close)
        return super().on_configure(state)

    def on_cleanup(self, state):  # noqa: ARG002
        """Remove the topic and the service, from any state."""
        self.is_active = False
        if self._publisher is not None:
            self.destroy_lifecycle_publisher(self._publisher)
            self.destroy_service(self._service)
        self._publisher = self._service = None
        return TransitionCallbackReturn.SUCCESS

    on_shutdown = on_cleanup

    def tick(self, stamp):
        """Move the fingers and publish their position."""
        if not (self.is_active and self.is_due(RATE)):
            return
        before = self._opening
        self._opening = approach(self._opening, self._target, SPEED / RATE)
        message = JointState(name=[self.frame("gripper_joint")])
        message.header.stamp = stamp
        message.position, message.velocity = [self._opening], [(self._opening - before) * RATE]
        self._publisher.publish(message)

    def diagnosis(self):
        """Return the opening."""
        message = "active" if self.is_active else "not active"
        return OK, message, {"opening [m]": f"{self._opening:.3f}"}

    def _close(self, request, response):
        response.success = self.is_active
        if self.is_active:
            self._target = CLOSED if request.data else OPEN
            response.message = "closing" if request.data else "opening"
        else:
            response.message = "the gripper driver is not active"
        return response
