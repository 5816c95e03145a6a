"""The rover: a round base with laser scanner, camera, IMU, gripper and navigation, in a walled room."""

# pyright: basic
from __future__ import annotations

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

GOES_WITHOUT = (
    (optional.tf2_msgs, "/tf and /tf_static (no tf2_msgs)"),
    (optional.demo_services, "/set_mode, /spawn_obstacle, /slow_echo (no ros2_mcp_demo_interfaces)"),
    (optional.demo_actions, "/navigate_to (no ros2_mcp_demo_interfaces)"),
    (optional.is_expected("nav2_msgs") or None, "/navigate_to_pose, /compute_path_to_pose (no nav2_msgs)"),
    (optional.lifecycle, "/gripper_driver (no rclpy.lifecycle)"),
    (optional.pillow, "/camera/image_raw/compressed (no Pillow)"),
)


def build(seed, namespace):
    """Return the simulation, and the nodes in the order in which they tick: commands are applied before measuring."""
    simulation = Simulation(seed)
    classes = [BaseController, Lidar, Camera, ImuDriver, BatteryMonitor, MapServer, Localization, RobotStatePublisher]
    if optional.demo_actions:
        classes.append(Navigator)
    if optional.demo_services:
        classes += [Simulator, EchoServer]
    if optional.lifecycle:
        from .nodes.gripper_driver import GripperDriver  # it inherits from a class that may be missing

        classes.append(GripperDriver)
    parts = [part(simulation, namespace) for part in classes]
    if optional.lifecycle:
        parts[-1].start()
    return simulation, [*parts, Health(simulation, namespace, parts)]


def late(simulation, namespace, parts):
    """Return the nodes that join once their interfaces have been built; an empty list before. `parts` are the existing
    nodes."""
    if not optional.lifecycle:
        return []
    from .nodes import nav2  # it inherits from a class that may be missing

    joining = nav2.parts(simulation, namespace)
    parts[-1].watch(joining)
    return joining
