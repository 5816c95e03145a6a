"""A part of the robot that is a lifecycle node."""

# pyright: basic
from __future__ import annotations

from rclpy.lifecycle import LifecycleNode

from .part import RobotPart


class LifecyclePart(RobotPart, LifecycleNode):
    """`is_active` between activating and deactivating. A transition that is impossible is refused, and logged."""

    def __init__(self, name, robot, namespace):
        super().__init__(name, robot, namespace)
        self.is_active = False
        self._refuse_impossible_transitions()

    def start(self):
        """Configure and activate it, as Nav2's lifecycle manager does at the start."""
        self.trigger_configure()
        self.trigger_activate()

    def on_activate(self, state):
        """It works from now on."""
        self.is_active = True
        return super().on_activate(state)

    def on_deactivate(self, state):
        """It stops working."""
        self.is_active = False
        return super().on_deactivate(state)

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
