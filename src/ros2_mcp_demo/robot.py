"""The robot put together: its nodes, its loop, its start and its end."""

# pyright: basic
from __future__ import annotations

import time

import rclpy
from rclpy.clock import Clock
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from . import optional
from .nodes.base_controller import BaseController
from .nodes.battery_monitor import BatteryMonitor
from .nodes.camera import Camera
from .nodes.echo_server import EchoServer
from .nodes.health import Health
from .nodes.imu_driver import ImuDriver
from .nodes.lidar import Lidar
from .nodes.localization import Localization
from .nodes.map_server import MapServer
from .nodes.navigator import Navigator
from .nodes.robot_state_publisher import RobotStatePublisher
from .nodes.simulator import Simulator
from .simulation import Simulation

FALLEN_BEHIND_S = 0.25  # more than that is not made up for: the steps would come in a jump


class Robot:
    """All nodes in one process. `rate` times a second the world moves on and nodes publish what is due."""

    def __init__(self, seed=7, namespace="", rate=50.0):
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._simulation = Simulation(seed)
        self._period = 1.0 / rate
        self._clock = Clock()
        self._parts = _parts(self._simulation, namespace)
        # The events executor is by far the cheapest; older ROS installations have only the other one.
        experimental = optional.module("rclpy.experimental")
        self._executor = getattr(experimental, "EventsExecutor", SingleThreadedExecutor)()
        self._spun = [part for part in self._parts if part.needs_executor]
        for part in self._spun:
            self._executor.add_node(part)

    @property
    def node_count(self):
        """How many nodes the robot has."""
        return len(self._parts)

    def run(self, should_stop):
        """Live until `should_stop()`; a computer that is too slow makes the robot slow, not jumpy."""
        due = time.monotonic()
        while not should_stop():
            self._simulation.step(self._period)
            stamp = self._clock.now().to_msg()
            for part in self._parts:
                part.tick(stamp)
            due = max(due + self._period, time.monotonic() - FALLEN_BEHIND_S)
            self._answer_until(due)

    def close(self):
        """Leave the graph in order."""
        for part in self._spun:
            self._executor.remove_node(part)
        self._executor.shutdown()
        for part in self._parts:
            part.destroy_node()
        try_shutdown()

    def _answer_until(self, due):
        """Handle commands, requests and goals; at least one, however late it is."""
        while True:
            left = due - time.monotonic()
            try:
                self._executor.spin_once(timeout_sec=max(left, 0.0))
            except (RuntimeError, ValueError, TypeError) as error:  # one bad request does not end the robot
                self._parts[0].get_logger().error(f"a callback failed: {error!r}")
            if left <= 0.0:
                return


def _parts(simulation, namespace):
    """The nodes in the order in which they tick: commands are followed before anything is measured."""
    classes = [BaseController, Lidar, Camera, ImuDriver, BatteryMonitor, MapServer, Localization, RobotStatePublisher]
    if optional.demo_actions:
        classes.append(Navigator)
    if optional.demo_services:
        classes += [Simulator, EchoServer]
    if optional.lifecycle:
        from .nodes.gripper_driver import GripperDriver  # it inherits from what an installation may lack

        classes.append(GripperDriver)
    parts = [part(simulation, namespace) for part in classes]
    return [*parts, Health(simulation, namespace, parts)]
