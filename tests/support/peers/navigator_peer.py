"""Nav2's navigator alone, so that it can be killed or frozen while its servers go on: a JSON list per line in, a JSON
value out. It has the controller follow a path to each goal of /navigate_to_pose, and of the topic /goal_pose.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import FollowPath, NavigateToPose, Spin
from nav2_msgs.msg import BehaviorTreeLog, BehaviorTreeStatusChange
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

STEP_S = 0.1


class Navigator:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = node = Node("bt_navigator")
        group = ReentrantCallbackGroup()
        self._refuses, self._longer_m, self._recovers, self._gives_up = False, 0.0, False, False
        self._misses: list[float] = []
        self._goals: list[float] = []
        self._follow = ActionClient(node, FollowPath, "follow_path", callback_group=group)
        self._spin = ActionClient(node, Spin, "spin", callback_group=group)
        self._self = ActionClient(node, NavigateToPose, "navigate_to_pose", callback_group=group)
        self._log = node.create_publisher(BehaviorTreeLog, "behavior_tree_log", 10)
        node.create_subscription(PoseStamped, "goal_pose", self._on_goal_pose, 10, callback_group=group)
        ActionServer(
            node,
            NavigateToPose,
            "navigate_to_pose",
            execute_callback=self._navigate,
            cancel_callback=lambda _: CancelResponse.REJECT if self._refuses else CancelResponse.ACCEPT,
            callback_group=group,
        )
        self._executor = MultiThreadedExecutor(8)
        self._executor.add_node(node)
        self._spinning = threading.Thread(target=self._executor.spin, daemon=True)
        self._spinning.start()
        assert self._follow.wait_for_server(30.0) and self._spin.wait_for_server(30.0)

    def put(
        self,
        refuses: bool = False,
        longer_m: float = 0.0,
        recovers: bool = False,
        misses: tuple[float, ...] = (),
        gives_up: bool = False,
    ) -> None:
        """Whether it refuses to cancel, how much longer its way becomes every other second, and then stays where it
        is; whether it spins after a second, which it tells each second; the goals (by their x) to which it finds no
        path. What is told again is for those who subscribe late. Whether it gives up after two seconds, while the
        controller goes on.
        """
        self._gives_up = gives_up
        self._refuses, self._longer_m, self._recovers, self._misses = refuses, longer_m, recovers, list(misses)

    def goals(self) -> list[float]:
        """The x of all goals that it has begun."""
        return self._goals

    def leave(self) -> None:
        """Say goodbye to ROS."""
        self._executor.shutdown(1.0)
        self._spinning.join(2.0)  # else it may still use the node that is destroyed here
        self._node.destroy_node()
        rclpy.shutdown()

    def _on_goal_pose(self, pose: PoseStamped) -> None:
        self._self.send_goal_async(NavigateToPose.Goal(pose=pose))

    def _navigate(self, handle: Any) -> Any:
        goal = handle.request.pose
        self._goals.append(round(goal.pose.position.x, 3))
        if any(abs(goal.pose.position.x - x) < 1e-6 for x in self._misses):
            handle.abort()
            return NavigateToPose.Result(error_code=208, error_msg="no valid path")
        request = FollowPath.Goal()
        request.path.poses = [goal]
        child = self._wait(self._follow.send_goal_async(request))
        ended, count = child.get_result_async(), 0
        left_m = abs(goal.pose.position.x)
        while not ended.done():
            time.sleep(STEP_S)
            count += 1
            if handle.is_cancel_requested:
                self._wait(child.cancel_goal_async())
                self._wait(ended)
                handle.canceled()
                return NavigateToPose.Result()
            if count == 20 and self._gives_up:
                handle.abort()
                return NavigateToPose.Result()
            if count % 10 == 0 and self._recovers:
                self._tell("Spin", "IDLE", "RUNNING")
            if count == 10 and self._recovers:
                self._spin.send_goal_async(Spin.Goal(target_yaw=4.0))
            feedback = NavigateToPose.Feedback(number_of_recoveries=int(self._recovers and count > 10))
            left_m -= 0.0 if self._longer_m else 0.3 * STEP_S
            feedback.distance_remaining = max(0.0, left_m) + (self._longer_m if count // 10 % 2 else 0.0)
            handle.publish_feedback(feedback)
        handle.succeed()
        return NavigateToPose.Result()

    def _tell(self, name: str, before: str, after: str) -> None:
        change = BehaviorTreeStatusChange(node_name=name, previous_status=before, current_status=after)
        self._log.publish(BehaviorTreeLog(event_log=[change]))

    @staticmethod
    def _wait(future: Any) -> Any:
        while not future.done():
            time.sleep(0.01)
        return future.result()


def main() -> None:
    navigator = Navigator()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(navigator, command)(**arguments)), flush=True)
    navigator.leave()


if __name__ == "__main__":
    main()
