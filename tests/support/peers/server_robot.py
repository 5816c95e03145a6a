"""A small robot for the tests: services that answer at once, late or never, and an action that takes its time."""

from __future__ import annotations

import contextlib
import sys
import time

import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci

from support.leaving import leave_on_sigterm

STEP_S = 0.1
SLOW_S = 20.0


class SmallRobot(Node):
    """`/set_lamp` and `/slow_lamp` (20 s) of std_srvs/SetBool; `/fibonacci` takes 0.1 s for each number."""

    def __init__(self) -> None:
        super().__init__("small_robot")
        together = ReentrantCallbackGroup()
        self.create_service(SetBool, "/set_lamp", self.set_lamp, callback_group=together)
        self.create_service(SetBool, "/slow_lamp", self.slow_lamp, callback_group=together)
        self.action = ActionServer(
            self,
            Fibonacci,
            "/fibonacci",
            self.fibonacci,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=together,
        )

    def set_lamp(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = request.data, f"lamp {'on' if request.data else 'off'}"
        return response

    def slow_lamp(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        time.sleep(SLOW_S)
        return self.set_lamp(request, response)

    def fibonacci(self, goal: object) -> Fibonacci.Result:
        numbers = [0, 1]
        for _ in range(goal.request.order):
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence=numbers)
            time.sleep(STEP_S)
            numbers.append(numbers[-1] + numbers[-2] if len(numbers) < 40 else 0)
            goal.publish_feedback(Fibonacci.Feedback(sequence=numbers))
        goal.succeed()
        return Fibonacci.Result(sequence=numbers)


def main() -> None:
    rclpy.init()
    leave_on_sigterm(rclpy.try_shutdown)
    executor = MultiThreadedExecutor(6)
    node = SmallRobot()
    executor.add_node(node)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
