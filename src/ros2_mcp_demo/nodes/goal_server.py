"""An action server that a node's own loop serves."""

# pyright: basic
from __future__ import annotations

from rclpy.action.server import ActionServer, CancelResponse

from .part import never_called


class GoalServer(ActionServer):
    """Calls `begin(goal_handle)` for every accepted goal; the owner later calls `finish`.

    rclpy would run a callback for as long as a goal takes, and an executor that waits for it would be busy.
    """

    def __init__(self, node, action_type, name, judge, begin):
        callbacks = {"goal_callback": judge, "cancel_callback": lambda _: CancelResponse.ACCEPT}
        super().__init__(node, action_type, name, never_called, **callbacks)
        self._begin = begin

    def notify_execute(self, goal_handle, execute_callback):  # noqa: ARG002
        """The goal is now executing."""
        self._begin(goal_handle)

    def finish(self, goal_handle, result):
        """Give clients the result of a goal that has succeeded, was aborted or canceled."""
        super().notify_execute(goal_handle, lambda _: result)
