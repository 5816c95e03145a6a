"""A docking server alone, so that it can be killed while its robot drives: one JSON list per line in, a JSON value out.

Its action /dock_here has the navigator drive to the dock's pose, and never ends by itself.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import rclpy
from nav2_msgs.action import DockRobot, NavigateToPose
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

STEP_S = 0.2


class Docking:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = Node("dock_peer")
        group = ReentrantCallbackGroup()
        self._navigator = ActionClient(node, NavigateToPose, "navigate_to_pose", callback_group=group)
        ActionServer(
            node,
            DockRobot,
            "dock_here",
            execute_callback=self._dock,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
        )
        executor = MultiThreadedExecutor(4)
        executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()
        assert self._navigator.wait_for_server(30.0)

    def _dock(self, handle: Any) -> Any:
        self._navigator.send_goal_async(NavigateToPose.Goal(pose=handle.request.dock_pose))
        while not handle.is_cancel_requested:
            handle.publish_feedback(DockRobot.Feedback(state=DockRobot.Feedback.NAV_TO_STAGING_POSE))
            time.sleep(STEP_S)
        handle.canceled()
        return DockRobot.Result()


def main() -> None:
    """Obey the lines of standard input."""
    docking = Docking()
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        name, arguments = json.loads(line)
        print(json.dumps(getattr(docking, name)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
