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
from .nodes.health import Health
from .nodes.imu_driver import ImuDriver
from .nodes.lidar import Lidar
from .nodes.localization import Localization
from .nodes.map_server import MapServer
from .nodes.robot_state_publisher import RobotStatePublisher
from .simulation import Simulation

FALLEN_BEHIND_S = 0.25


class Robot:
    """All nodes in one process. `rate` times a second the world moves on and nodes publish what is due."""

    def __init__(self, seed=7, namespace="", rate=50.0):
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._simulation = Simulation(seed)
        self._period = 1.0 / rate
        self._clock = Clock()
        self._parts = _parts(self._simulation, namespace)
        self._idle_parts = _parts_without_executor(self._simulation, namespace)
        self._executor = _executor()
        for part in self._parts:
            self._executor.add_node(part)

    @property
    def node_count(self):
        """How many nodes the robot has."""
        return len(self._parts) + len(self._idle_parts)

    def run(self, should_stop):
        """Live until `should_stop()`; a computer that is too slow makes the robot slow, not jumpy."""
        due = time.monotonic()
        while not should_stop():
            self._tick()
            due = max(due + self._period, time.monotonic() - FALLEN_BEHIND_S)
            self._answer_until(due)

    def close(self):
        """Leave the graph in order."""
        for part in self._parts:
            self._executor.remove_node(part)
        self._executor.shutdown()
        for part in (*self._parts, *self._idle_parts):
            part.destroy_node()
        try_shutdown()

    def _tick(self):
        self._simulation.step(self._period)
        stamp = self._clock.now().to_msg()
        for part in (*self._parts, *self._idle_parts):
            part.tick(stamp)

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
    lidar, map_server = Lidar(simulation, namespace), MapServer(simulation, namespace)
    parts = [
        BaseController(simulation, namespace),
        lidar,
        Camera(simulation, namespace),
        ImuDriver(simulation, namespace),
        BatteryMonitor(simulation, namespace),
        map_server,
        Localization(simulation, namespace),
        RobotStatePublisher(simulation, namespace),
    ]
    if optional.demo_actions:
        from .nodes.navigator import Navigator

        parts.append(Navigator(simulation, namespace, lidar, map_server))
    if optional.demo_services:
        from .nodes.simulator import Simulator

        parts.append(Simulator(simulation, namespace))
    if optional.lifecycle:
        from .nodes.gripper_driver import GripperDriver

        parts.append(GripperDriver(simulation, namespace))
    return [*parts, Health(simulation, namespace, parts)]


def _parts_without_executor(simulation, namespace):
    if not optional.demo_services:
        return []
    from .nodes.echo_server import EchoServer

    return [EchoServer(simulation, namespace)]


def _executor():
    """The events executor, by far the cheapest; older ROS installations have only the other one."""
    experimental = optional.module("rclpy.experimental")
    if experimental is not None and hasattr(experimental, "EventsExecutor"):
        return experimental.EventsExecutor()
    return SingleThreadedExecutor()
