"""A complete robot: its nodes, its loop, its start and its end."""

# pyright: basic
from __future__ import annotations

import time

import rclpy
from rclpy.clock import Clock
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from . import optional

LATE_EVERY_S = 1.0  # period of checking for nodes that could not start with the robot
FALLEN_BEHIND_S = 0.25  # a longer delay is not made up for, to avoid a burst of steps


class Robot:
    """All nodes of one of the `robots`, in one process.

    The simulation advances `rate` times a second, and the nodes publish what is due.
    """

    def __init__(self, robot, seed=7, namespace="", rate=50.0):
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._simulation, self._parts = robot.build(seed, namespace)
        has_late = hasattr(robot, "late")
        self._late = (lambda: robot.late(self._simulation, namespace, self._parts)) if has_late else None
        self._period = 1.0 / rate
        self._clock = Clock()
        # The events executor uses by far the least CPU; older ROS installations have only the other one.
        experimental = optional.module("rclpy.experimental")
        self._executor = getattr(experimental, "EventsExecutor", SingleThreadedExecutor)()
        self._spun = []
        self._stack = getattr(robot, "STACK", None)
        self._spin(self._parts)

    @property
    def node_count(self):
        """The number of the robot's nodes."""
        return len(self._parts)

    def run(self, should_stop):
        """Run until `should_stop()`; on a slow computer the robot becomes slow instead of jumpy."""
        due = look_at = time.monotonic()
        while not should_stop():
            if self._late and time.monotonic() >= look_at:
                look_at = time.monotonic() + LATE_EVERY_S
                self._join(self._late())
            self._change()
            self._simulation.step(self._period)
            stamp = self._clock.now().to_msg()
            for part in self._parts:
                part.tick(stamp)
            due = max(due + self._period, time.monotonic() - FALLEN_BEHIND_S)
            self._answer_until(due)

    def close(self):
        """Leave the graph cleanly."""
        for part in self._spun:
            self._executor.remove_node(part)
        self._executor.shutdown()
        for part in self._parts:
            part.destroy_node()
        try_shutdown()

    def _change(self):
        """Add and remove the nodes of planted faults."""
        if self._stack is None:
            return
        for part in self._stack.left:
            self._executor.remove_node(part)
            self._spun.remove(part)
            self._parts.remove(part)
            for waitable in [*part.waitables]:  # action servers, which a node does not destroy
                getattr(waitable, "destroy", lambda: None)()
            part.destroy_node()
            if machine := getattr(part, "_state_machine", None):  # it keeps a lifecycle node in the graph
                machine.destroy_when_not_in_use()
        if self._stack.joined:
            self._parts += self._stack.joined
            self._spin(self._stack.joined)
        self._stack.joined, self._stack.left = [], []

    def _join(self, parts):
        """Add nodes that could not start with the robot."""
        if parts:
            self._late = None
            self._parts += parts
            self._spin(parts)

    def _spin(self, parts):
        for part in parts:
            if part.needs_executor:
                self._executor.add_node(part)
                self._spun.append(part)

    def _answer_until(self, due):
        """Handle commands, requests and goals until `due`; at least one, however late."""
        while True:
            left = due - time.monotonic()
            try:
                self._executor.spin_once(timeout_sec=max(left, 0.0))
            except (RuntimeError, ValueError, TypeError) as error:  # one bad request does not end the robot
                self._parts[0].get_logger().error(f"a callback failed: {error!r}")
            if left <= 0.0:
                return
