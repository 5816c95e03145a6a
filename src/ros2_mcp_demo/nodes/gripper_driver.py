"""/gripper_driver: a lifecycle node; its gripper answers and tells its state only while active."""

# pyright: basic
from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from ..base import approach
from .part import OK, RobotPart

OPEN, CLOSED = 0.08, 0.0
SPEED = 0.04
RATE = 10.0


class GripperDriver(RobotPart, LifecycleNode):
    """Starts unconfigured; configure and activate it, then /gripper/close and /gripper/joint_states work."""

    def __init__(self, robot, namespace):
        super().__init__("gripper_driver", robot, namespace)
        self._active = False
        self._opening = self._target = OPEN
        self._publisher: Any = None
        self._service: Any = None
        self._refuse_impossible_transitions()

    def on_configure(self, state):
        """Offer the topic and the service."""
        self._publisher = self.create_lifecycle_publisher(JointState, "gripper/joint_states", 10)
        self._service = self.create_service(SetBool, "gripper/close", self._close)
        return super().on_configure(state)

    def on_activate(self, state):
        """Power the gripper."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Take the power away; the gripper stays as it is."""
        self._active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state):  # noqa: ARG002
        """Take back the topic and the service, from any state."""
        self._active = False
        if self._publisher is not None:
            self.destroy_lifecycle_publisher(self._publisher)
            self.destroy_service(self._service)
        self._publisher = self._service = None
        return TransitionCallbackReturn.SUCCESS

    on_shutdown = on_cleanup

    def tick(self, stamp):
        """Move the fingers and tell where they are."""
        if not (self._active and self.is_due(RATE)):
            return
        before = self._opening
        self._opening = approach(self._opening, self._target, SPEED / RATE)
        message = JointState(name=[self.frame("gripper_joint")])
        message.header.stamp = stamp
        message.position, message.velocity = [self._opening], [(self._opening - before) * RATE]
        self._publisher.publish(message)

    def diagnosis(self):
        """How far it is open."""
        message = "active" if self._active else "not active"
        return OK, message, {"opening [m]": f"{self._opening:.3f}"}

    def _refuse_impossible_transitions(self):
        """rclpy raises, and never answers, where a transition does not start in the present state."""
        service = next(s for s in self.services if s.service_name.endswith("/change_state"))
        change = service.callback

        def change_or_refuse(request, response):
            try:
                return change(request, response)
            except RuntimeError as error:
                self.get_logger().warning(f"transition refused: {error}")
                response.success = False
                return response

        service.callback = change_or_refuse

    def _close(self, request, response):
        response.success = self._active
        if self._active:
            self._target = CLOSED if request.data else OPEN
            response.message = "closing" if request.data else "opening"
        else:
            response.message = "the gripper driver is not active"
        return response
