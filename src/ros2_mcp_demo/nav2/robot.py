"""The complete rover with all of Nav2, which joins when nav2_msgs is installed."""

# pyright: basic
from __future__ import annotations

from .. import optional
from ..nodes import nav2
from ..nodes.battery_monitor import BatteryMonitor
from ..nodes.health import Health
from ..nodes.imu_driver import ImuDriver
from ..nodes.lidar import Lidar
from ..nodes.robot_state_publisher import RobotStatePublisher
from ..nodes.simulator import Simulator
from ..simulation import Simulation
from .chain import Base, CollisionMonitor, Ekf, Smoother
from .docking import DockingServer
from .localisation import Amcl, Costmap, LocalCostmap, MapSaver, MapServer
from .servers import Behaviors, Controller, Planner, TreeNavigator
from .supervisor import Supervisor

GOES_WITHOUT = (
    (optional.tf2_msgs, "/tf and /tf_static (no tf2_msgs)"),
    (optional.is_expected("nav2_msgs") or None, "all of Nav2 (no nav2_msgs)"),
)

_COSTMAP = {"robot_base_frame": "base_link", "resolution": 0.05, "robot_radius": 0.2}
_SCAN = {
    "obstacle_layer__observation_sources": "scan",
    "obstacle_layer__scan__topic": "/scan",
    "obstacle_layer__scan__min_obstacle_height": 0.0,
    "obstacle_layer__scan__max_obstacle_height": 2.0,
    "obstacle_layer__scan__obstacle_min_range": 0.0,
}
PARAMETERS = {
    "controller": {
        "controller_frequency": 10.0,
        "enable_stamped_cmd_vel": False,
        "FollowPath__plugin": "nav2_regulated_pure_pursuit_controller::RegulatedPurePursuitController",
        "FollowPath__desired_linear_vel": 0.4,
        "progress_checker__plugin": "nav2_controller::SimpleProgressChecker",
        "progress_checker__required_movement_radius": 0.5,
        "progress_checker__movement_time_allowance": 10.0,
    },
    "planner": {"GridBased__plugin": "nav2_navfn_planner::NavfnPlanner", "GridBased__allow_unknown": True},
    "navigator": {
        "global_frame": "map",
        "robot_base_frame": "base_link",
        "default_server_timeout": 200,
        "odom_topic": "odom",
    },
    "behaviors": {"robot_base_frame": "base_link", "global_frame": "map", "enable_stamped_cmd_vel": False},
    "smoother": {"max_velocity": [0.5, 0.0, 1.5], "enable_stamped_cmd_vel": False, "odom_topic": "odom"},
    "monitor": {
        "base_frame_id": "base_link",
        "odom_frame_id": "odom",
        "source_timeout": 2.0,
        "enable_stamped_cmd_vel": False,
        "observation_sources": ["scan"],
        "scan__type": "scan",
        "scan__topic": "scan",
        "polygons": ["PolygonStop"],
        "PolygonStop__type": "polygon",
        "PolygonStop__action_type": "stop",
        "PolygonStop__min_points": 4,
        "PolygonStop__points": "[[0.22, 0.22], [0.22, -0.22], [-0.22, -0.22], [-0.22, 0.22]]",
    },
    "amcl": {
        "base_frame_id": "base_link",
        "odom_frame_id": "odom",
        "global_frame_id": "map",
        "scan_topic": "scan",
        "set_initial_pose": True,
        "transform_tolerance": 1.0,
    },
    "docking": {"base_frame": "base_link", "enable_stamped_cmd_vel": False},
    "local_costmap": {"global_frame": "odom", "rolling_window": True, "width": 3, "height": 3, **_COSTMAP, **_SCAN},
    "global_costmap": {"global_frame": "map", "width": 8, "height": 6, **_COSTMAP, **_SCAN},
}
"""Parameters of Nav2's nodes on a working robot, by part; "__" stands for a dot."""


class Stack:
    """All parts of the robot by name (also as attributes), for planting faults. Parts in `joined` join the robot, parts
    in `left` leave it."""

    def __init__(self):
        self.hidden = None
        self.parts = {}
        self.joined = []
        self.left = []

    def __getattr__(self, name):
        try:
            return self.__dict__["parts"][name]
        except KeyError:
            raise AttributeError(name) from None

    def set(self, name, parameter, value):
        """Set a parameter of a part."""
        from rclpy.parameter import Parameter

        self.parts[name].set_parameters([Parameter(parameter, value=value)])


STACK = Stack()
"""The stack of this process, which has one robot."""


def build(seed, namespace):
    """Return the simulation, and the nodes that do not need nav2_msgs."""
    simulation = Simulation(seed)
    classes = {"base": Base, "lidar": Lidar, "imu": ImuDriver, "battery": BatteryMonitor, "ekf": Ekf}
    classes["state_publisher"] = RobotStatePublisher
    if optional.demo_services:
        classes["simulator"] = Simulator
    STACK.parts.update({name: part(simulation, namespace) for name, part in classes.items()})
    parts = list(STACK.parts.values())
    STACK.parts["health"] = Health(simulation, namespace, parts)
    return simulation, [*parts, STACK.parts["health"]]


def late(simulation, namespace, parts):
    """Return Nav2's nodes once nav2_msgs has been built; their lifecycle managers bring them up."""
    interfaces = optional.arrived("nav2_msgs", "action", "srv", "msg")
    if not interfaces or not optional.lifecycle:
        return []
    actions, services, messages = interfaces
    made, navigation = STACK.parts, nav2.Navigation(simulation)

    def parameters(name):
        return dict(PARAMETERS[name])

    made["map_server"] = MapServer(simulation, namespace, services.LoadMap)
    made["map_saver"] = MapSaver(simulation, namespace, services.SaveMap)
    made["amcl"] = Amcl(simulation, namespace, **parameters("amcl"))
    made["global_costmap"] = Costmap("global_costmap", simulation, namespace, **parameters("global_costmap"))
    made["local_costmap"] = LocalCostmap("local_costmap", simulation, namespace, **parameters("local_costmap"))
    made["controller"] = Controller(simulation, namespace, navigation, actions.FollowPath, **parameters("controller"))
    planner = Planner(
        simulation,
        namespace,
        navigation,
        actions.ComputePathToPose,
        services.ClearEntireCostmap,
        made["global_costmap"].grids,
    )
    made["planner"] = planner
    for name, value in parameters("planner").items():
        planner.declare_parameter(name.replace("__", "."), value)
    made["behaviors"] = Behaviors(simulation, namespace, actions, **parameters("behaviors"))
    made["navigator"] = TreeNavigator(simulation, namespace, navigation, planner, actions, **parameters("navigator"))
    made["smoother"] = Smoother(simulation, namespace, **parameters("smoother"))
    made["monitor"] = CollisionMonitor(simulation, namespace, messages.CollisionMonitorState, **parameters("monitor"))
    made["docking"] = DockingServer(simulation, namespace, actions, **parameters("docking"))
    service = services.ManageLifecycleNodes
    localises = [made["map_server"], made["amcl"]]
    drives = [
        made[name] for name in ("controller", "planner", "behaviors", "navigator", "smoother", "monitor", "docking")
    ]
    made["localisation"] = Supervisor("lifecycle_manager_localization", simulation, namespace, localises, service)
    made["navigation"] = Supervisor("lifecycle_manager_navigation", simulation, namespace, drives, service)
    joining = [part for part in made.values() if part not in parts]
    from .faults import at_start

    at_start(STACK)
    for supervisor in (made["localisation"], made["navigation"]):
        supervisor.bring_up()
    return joining
