"""An action server whose goals run in the loop of its node."""

# pyright: basic
from __future__ import annotations

from rclpy.action.server import ActionServer, CancelResponse

from .part import never_called


class GoalServer(ActionServer):
    """Calls `begin(goal_handle)` for every accepted goal; the node calls `finish` later.

    rclpy would run a callback during the whole goal, which would block the executor.
    """

    def __init__(self, node, action_type, name, judge, begin):
        callbacks = {"goal_callback": judge, "cancel_callback": lambda _: CancelResponse.ACCEPT}
        super().__init__(node, action_type, name, never_called, **callbacks)
        self._begin = begin

    def notify_execute(self, goal_handle, execute_callback):  # noqa: ARG002
        """Start a goal: call `begin` instead of rclpy's callback."""
        self._begin(goal_handle)

    def finish(self, goal_handle, result):
        """Send clients the result of a goal that succeeded, was aborted or was canceled."""
        super().notify_execute(goal_handle, lambda _: result)
