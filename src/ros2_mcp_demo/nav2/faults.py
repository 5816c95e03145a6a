"""Faults that can be planted by name in the rover with all of Nav2: causes that stop robots, and decoys.

A fault is a pair of functions: one plants it, the other heals it (None: only a restart does). The numbers are those of
the list of causes from which `ros2_nav_check` was written.
"""

# pyright: basic
from __future__ import annotations

import math

from rclpy.qos import DurabilityPolicy

from ..world import Pillar
from .chain import Teleop
from .localisation import UNKNOWN_FROM_M

PLANTED: list = []
"""The names given at the start."""


def _parameter(part, name, wrong, right):
    return (lambda stack: stack.set(part, name, wrong)), (lambda stack: stack.set(part, name, right))


def _parameters(part, values):
    """Return the fault that sets several parameters of a part: name → (wrong, right)."""

    def plant(stack, which):
        for name, pair in values.items():
            stack.set(part, name, pair[which])

    return (lambda stack: plant(stack, 0)), (lambda stack: plant(stack, 1))


def _attribute(part, name, wrong, right):
    return (lambda stack: setattr(stack.parts[part], name, wrong)), (
        lambda stack: setattr(stack.parts[part], name, right)
    )


def _of_base(name, wrong, right):
    """Return the fault of the simulated wheels or encoders."""
    return (lambda stack: setattr(stack.base.robot.base, name, wrong)), (
        lambda stack: setattr(stack.base.robot.base, name, right)
    )


def _joins(make):
    """Return the fault that adds a node; healing removes it."""
    made = []

    def plant(stack):
        made.append(make(stack))
        stack.joined.append(made[-1])

    return plant, lambda stack: stack.left.append(made.pop())


def _dies(part):
    """Return the fault that removes a node, as if its process had died."""

    def plant(stack):
        stack.parts[part].is_gone = True
        stack.left.append(stack.parts[part])

    return plant, None


def _static_map_to_odom(stack):
    from ..nodes.convert import transform
    from ..nodes.part import RobotPart
    from ..optional import tf2_msgs

    node = RobotPart("map_odom_static", stack.base.robot)
    stamp = node.get_clock().now().to_msg()
    publisher = node.create_latched_publisher(tf2_msgs.TFMessage, "/tf_static")
    publisher.publish(tf2_msgs.TFMessage(transforms=[transform(stamp, "map", "odom")]))
    return node


def _post_ahead(distance_m, radius):
    """Return the fault that places a post this far ahead of the robot's centre, wherever the robot is."""

    def plant(stack):
        robot = stack.base.robot
        x = robot.base.pose.x + distance_m * math.cos(robot.base.pose.yaw)
        y = robot.base.pose.y + distance_m * math.sin(robot.base.pose.yaw)
        robot.world.place(Pillar("planted", x, y, radius, 0.7, (200, 30, 200)))

    return plant, lambda stack: stack.base.robot.world.place(Pillar("planted", 5.8, -2.8, 0.1, 0.7, (200, 30, 200)))


def _both(*pairs):
    def plant(stack):
        for one, _ in pairs:
            one(stack)

    def heal(stack):
        for _, other in pairs:
            other(stack)

    return plant, heal


def _blind_behind(stack):
    """Make the map unknown beyond a line, and forbid the planner to enter unknown space."""
    cells, (x, _) = stack.base.robot.map
    stack.hidden = cells[:, int((UNKNOWN_FROM_M - x) / 0.05) :].copy()
    cells[:, int((UNKNOWN_FROM_M - x) / 0.05) :] = -1
    stack.set("planner", "GridBased.allow_unknown", False)
    stack.planner.unknown_from_m = UNKNOWN_FROM_M
    stack.map_server.publish()


def _known_again(stack):
    cells, (x, _) = stack.base.robot.map
    cells[:, int((UNKNOWN_FROM_M - x) / 0.05) :] = stack.hidden
    stack.set("planner", "GridBased.allow_unknown", True)
    stack.planner.unknown_from_m = math.inf
    stack.map_server.publish()


def _old_plugin(stack):
    stack.navigation.reset()
    stack.planner.fails = (
        "Failed to create global planner. Exception: According to the loaded plugin descriptions the class "
        "nav2_navfn_planner/NavfnPlanner with base class type nav2_core::GlobalPlanner does not exist."
    )
    stack.set("planner", "GridBased.plugin", "nav2_navfn_planner/NavfnPlanner")
    stack.navigation.bring_up()


def _new_plugin(stack):
    stack.planner.fails = ""
    stack.set("planner", "GridBased.plugin", "nav2_navfn_planner::NavfnPlanner")
    stack.navigation.bring_up()


def _never_comes(stack):
    stack.navigation.reset()
    stack.set("navigation", "node_names", [*stack.navigation.setting("node_names"), "route_server"])
    stack.navigation.bring_up()


def _not_wanted(stack):
    stack.set("navigation", "node_names", stack.navigation.setting("node_names")[:-1])
    stack.navigation.bring_up()


def _fed_again(stack):
    stack.navigator.starved = False
    stack.navigation.bring_up()


def _renamed_scan(stack):
    stack.local_costmap.listen("scan")
    stack.set("local_costmap", "obstacle_layer.scan.topic", "scan")


def _deaf_map(stack):
    stack.map_server.publish_as(DurabilityPolicy.VOLATILE)


FAULTS = {
    "1 stamped against unstamped": (
        lambda stack: stack.base.follow_stamped(),
        lambda stack: stack.base.follow(),
    ),
    "2 unconnected output": (
        lambda stack: stack.monitor.publish_on("cmd_vel_out"),
        lambda stack: stack.monitor.publish_on("cmd_vel"),
    ),
    "3 rival": _joins(lambda stack: Teleop(stack.base.robot, "")),
    "4 monitor holds": _both(
        _post_ahead(0.36, 0.06),
        _parameter(
            "monitor",
            "PolygonStop.points",
            "[[0.4, 0.3], [0.4, -0.3], [-0.3, -0.3], [-0.3, 0.3]]",
            "[[0.22, 0.22], [0.22, -0.22], [-0.22, -0.22], [-0.22, 0.22]]",
        ),
        _parameter("local_costmap", "obstacle_layer.scan.obstacle_min_range", 0.65, 0.0),
    ),
    "5 source missing": _parameter("monitor", "observation_sources", ["scan", "pointcloud"], ["scan"]),
    "8 clock behind": _attribute("base", "stamp_offset_s", -1.8, 0.0),
    "8 clock ahead": _attribute("base", "stamp_offset_s", 0.9, 0.0),
    "9 wheels silent": _attribute("base", "is_silent", True, False),
    "10 simulated time": _parameter("ekf", "use_sim_time", True, False),
    "11 no odometry transform": _parameter("ekf", "publish_tf", False, True),
    "12 no initial pose": (
        lambda stack: (setattr(stack.amcl, "is_told", False), stack.set("amcl", "set_initial_pose", False)),
        None,
    ),
    "13 static and moving": _joins(_static_map_to_odom),
    "14 frame name": _parameter("local_costmap", "robot_base_frame", "base_footprint", "base_link"),
    "15 topic in a namespace": (_renamed_scan, lambda stack: stack.local_costmap.listen("../scan")),
    "17 parameters not applied": _parameters(
        "local_costmap",
        {
            "width": (5, 3),
            "height": (5, 3),
            "resolution": (0.1, 0.05),
            "robot_radius": (0.1, 0.2),
            "rolling_window": (False, True),
        },
    ),
    "18 old plugin name": (_old_plugin, _new_plugin),
    "19 never comes": (_never_comes, _not_wanted),
    "20 bond lost": (lambda stack: setattr(stack.navigator, "starved", True), _fed_again),
    "20 server died": _dies("planner"),
    "21 acknowledged too late": _parameter("navigator", "default_server_timeout", 1, 200),
    "22 rate missed": _attribute("controller", "most_hz", 3.0, math.inf),
    "23 sees itself": _attribute("lidar", "sees_itself", True, False),
    "26 lidar turned": _attribute("lidar", "turned_deg", 180, 0),
    "26 lidar turned a little": _attribute("lidar", "turned_deg", 40, 0),
    "27 odometry turns the wrong way": _of_base("turns", -1.0, 1.0),
    "27 odometry counts half": _of_base("counts", 0.5, 1.0),
    "27 wheels exchanged": _of_base("are_exchanged", True, False),
    "28 lost": _attribute("amcl", "off", (1.1, 0.8, 0.9), (0.0, 0.0, 0.0)),
    "30 progress": _parameters(
        "controller",
        {"progress_checker.movement_time_allowance": (3.0, 10.0), "FollowPath.desired_linear_vel": (0.1, 0.4)},
    ),
    "32 unknown space": (_blind_behind, _known_again),
    "map is volatile": (
        _deaf_map,
        lambda stack: stack.map_server.publish_as(DurabilityPolicy.TRANSIENT_LOCAL),
    ),
    "no map": _dies("map_server"),
    "lidar silent": _parameter("lidar", "enabled", False, True),
    "motors off": (
        lambda stack: setattr(stack.base.robot, "motors_enabled", False),
        lambda stack: setattr(stack.base.robot, "motors_enabled", True),
    ),
    "paused": (lambda stack: stack.navigation.pause(), lambda stack: stack.navigation.bring_up()),
    "navigator died": _dies("navigator"),
    "dock unseen": _attribute("docking", "is_unseen", True, False),
    "dock unpowered": _attribute("docking", "is_unpowered", True, False),
    "decoy: fresh initial pose": _attribute("amcl", "deviation_m", 0.5, 0.0),
    "decoy: false rate warning": (
        lambda stack: stack.controller.get_logger().warning(
            "Control loop missed its desired rate of 10.0000 Hz. Current loop rate is 9.1 Hz."
        ),
        None,
    ),
    "decoy: message filter": (
        lambda stack: stack.local_costmap.get_logger().warning(
            "Message Filter dropping message: frame 'laser' at time 1.000 for reason 'the timestamp on the message is "
            "earlier than all the data in the transform cache'"
        ),
        None,
    ),
}


def at_start(stack):
    """Plant the faults given at the start."""
    for name in PLANTED:
        FAULTS[name][0](stack)


def obey(stack, line):
    """Carry out a line such as `plant NAME` or `heal NAME`; return what was done, or what would be right. A fault is
    healed only if that is possible without a restart.
    """
    verb, _, name = line.partition(" ")
    if verb not in ("plant", "heal"):
        return f"{line!r}: write 'plant NAME' or 'heal NAME'"
    if name not in FAULTS:
        return unknown(name)
    plant, heal = FAULTS[name]
    if verb == "plant":
        plant(stack)
    elif heal:
        heal(stack)
    return f"{line}: done"


def unknown(name):
    """Say which faults there are."""
    return f"There is no fault {name!r}. There are: {'; '.join(FAULTS)}"
