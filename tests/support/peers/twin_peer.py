"""Two drivers that serve the same service and the same action: a JSON list per line in, a JSON value per line out.

It knows ROS 2 and nothing of this project.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci


class Twins:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._nodes = [Node(name) for name in ("driver_a", "driver_b")]
        self._called: list[str] = []
        self._servers: dict[str, ActionServer] = {}
        for node in self._nodes:
            node.create_service(Trigger, "/reset", lambda _, answer, node=node: self._on_call(node, answer))
            node.create_service(GetParameters, "/read", lambda _, answer: answer)
            self._offer(node, "/spin")
        self._nodes[0].create_service(Trigger, "/alone", lambda _, answer: answer)
        self._offer(self._nodes[0], "/alone")
        executor = MultiThreadedExecutor()
        for node in self._nodes:
            executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def called(self) -> list[str]:
        """Who was called, and whose goals began, since it was asked."""
        called, self._called = self._called, []
        return called

    def leave(self) -> None:
        """The server of /alone goes."""
        self._servers.pop("driver_a/alone").destroy()

    def come(self) -> None:
        """A new one comes, which knows no goal."""
        self._offer(self._nodes[0], "/alone")

    def _offer(self, node: Node, name: str) -> None:
        def execute(handle: Any) -> Any:
            self._called.append(f"{node.get_name()}{name}")
            time.sleep(handle.request.order)
            handle.succeed()
            return Fibonacci.Result()

        group = ReentrantCallbackGroup()
        self._servers[f"{node.get_name()}{name}"] = ActionServer(node, Fibonacci, name, execute, callback_group=group)

    def _on_call(self, node: Node, answer: Any) -> Any:
        self._called.append(node.get_name())
        answer.success, answer.message = True, node.get_name()
        return answer


def main() -> None:
    twins = Twins()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(twins, command)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
