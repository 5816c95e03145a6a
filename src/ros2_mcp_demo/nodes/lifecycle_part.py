"""A node of the robot that is a lifecycle node."""

# pyright: basic
from __future__ import annotations

from rclpy.lifecycle import LifecycleNode

from .part import RobotPart


class LifecyclePart(RobotPart, LifecycleNode):
    """A lifecycle node; `is_active` between activation and deactivation. Impossible transitions are refused and
    logged."""

    def __init__(self, name, robot, namespace):
        super().__init__(name, robot, namespace)
        self.is_active = False
        self._refuse_impossible_transitions()

    def start(self):
        """Configure and activate the node, as Nav2's lifecycle manager does at the start."""
        self.trigger_configure()
        self.trigger_activate()

    def on_activate(self, state):
        """Start working."""
        self.is_active = True
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Stop working."""
        self.is_active = False
        return super().on_deactivate(state)

    def _refuse_impossible_transitions(self):
        """Refuse transitions that do not start in the present state; rclpy would raise and never answer the request."""
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
