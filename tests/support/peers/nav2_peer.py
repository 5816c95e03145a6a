"""Nav2 below its navigator, and a base: a JSON list per line in, a JSON value out. It knows nothing of this project.

Nodes: a base with odometry and transforms, a collision monitor before it, controller, behaviours, planner, costmaps,
and a lifecycle manager. The controller follows a path that it was given to its end, as Nav2's does, whoever sent it.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from functools import partial
from typing import Any

import rclpy
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped, Twist
from lifecycle_msgs.msg import State, Transition, TransitionDescription
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from nav2_msgs.action import BackUp, ComputePathToPose, DriveOnHeading, FollowPath, FollowWaypoints, Spin
from nav2_msgs.msg import CollisionMonitorState, MissedWaypoint
from nav2_msgs.srv import ClearEntireCostmap, ManageLifecycleNodes
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

STEP_S = 0.05
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
SPEED = 0.3
SERVERS = ("controller_server", "planner_server", "behavior_server", "bt_navigator")
COMMANDS = {0: "active", 1: "inactive", 2: "active", 3: "unconfigured", 4: "finalized"}
"""What each command of `manage_nodes` makes of the servers."""
TRANSITIONS = {"inactive": ("activate", "cleanup"), "active": ("deactivate",), "unconfigured": ("configure",)}
LEADS_TO = {"activate": "active", "deactivate": "inactive", "configure": "inactive", "cleanup": "unconfigured"}


class Nav2:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        names = ("base", "collision_monitor", "lifecycle_manager_navigation", "amcl", "global_costmap", *SERVERS[:3])
        self._nodes = {name: Node(name) for name in names}
        self._group = ReentrantCallbackGroup()
        self._x = self._y = self._yaw = 0.0
        self._commanded = self._passed = (0.0, 0.0)
        self._commanded_at = 0.0
        self._motors, self._held, self._jump = True, "", 0.0
        self._cancels: list[str] = []
        self._cleared = 0
        self._states = dict.fromkeys(SERVERS, "active")
        self._missed: list[int] = []
        base, monitor, amcl = (self._nodes[name] for name in ("base", "collision_monitor", "amcl"))
        self._odometry = base.create_publisher(Odometry, "/odom", 10)
        self._tf = base.create_publisher(TFMessage, "/tf", 10)
        base.create_subscription(Twist, "/cmd_vel", self._on_passed, 10)
        monitor.create_subscription(Twist, "/cmd_vel_nav", self._on_command, 10)
        self._wheels = monitor.create_publisher(Twist, "/cmd_vel", 10)
        self._monitor_state = monitor.create_publisher(CollisionMonitorState, "/collision_monitor_state", 10)
        self._commands = self._nodes["controller_server"].create_publisher(Twist, "/cmd_vel_nav", 10)
        self._behaviours = self._nodes["behavior_server"].create_publisher(Twist, "/cmd_vel_nav", 10)
        amcl.create_subscription(PoseWithCovarianceStamped, "/initialpose", self._on_initial_pose, 10)
        self._pose = amcl.create_publisher(PoseWithCovarianceStamped, "/amcl_pose", LATCHED)
        self._localised = (0.0, 0.0, 0.0)
        self._grid = self._nodes["global_costmap"].create_publisher(OccupancyGrid, "/global_costmap/costmap", LATCHED)
        clear = "/global_costmap/clear_entirely_global_costmap"
        self._nodes["global_costmap"].create_service(ClearEntireCostmap, clear, self._clear)
        self._serve()
        executor = MultiThreadedExecutor(8)
        for node in self._nodes.values():
            executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()
        threading.Thread(target=self._live, daemon=True).start()

    def _serve(self) -> None:
        self._action("controller_server", FollowPath, "follow_path", self._follow)
        self._action("planner_server", ComputePathToPose, "compute_path_to_pose", self._plan)
        self._action("behavior_server", Spin, "spin", self._spin)
        self._action("behavior_server", BackUp, "backup", partial(self._straight, BackUp, -1))
        self._action("behavior_server", DriveOnHeading, "drive_on_heading", partial(self._straight, DriveOnHeading, 1))
        self._action("behavior_server", FollowWaypoints, "follow_waypoints", self._waypoints)
        manager = self._nodes["lifecycle_manager_navigation"]
        manager.declare_parameter("node_names", list(SERVERS))
        manager.create_service(ManageLifecycleNodes, "~/manage_nodes", self._manage)
        manager.create_service(Trigger, "~/is_active", self._is_active)
        for name in SERVERS[:3]:
            node = self._nodes[name]
            node.create_service(GetState, "~/get_state", partial(self._get_state, name))
            node.create_service(ChangeState, "~/change_state", partial(self._change_state, name))
            node.create_service(GetAvailableTransitions, "~/get_available_transitions", partial(self._possible, name))

    def _action(self, node: str, kind: Any, name: str, execute: Any) -> None:
        def judge(_: Any) -> GoalResponse:
            return GoalResponse.ACCEPT if self._states[node] == "active" else GoalResponse.REJECT

        def cancel(_: Any) -> CancelResponse:
            self._cancels.append(name)
            return CancelResponse.ACCEPT

        ActionServer(
            self._nodes[node],
            kind,
            name,
            execute_callback=execute,
            goal_callback=judge,
            cancel_callback=cancel,
            callback_group=self._group,
        )

    # ── commands ───────────────────────────────────────────────────────────────────────────────────────────────

    def put(self, motors: bool = True, held: str = "", missed: Any = (), x: float = 0.0) -> None:
        """The base at a place, its motors on or off, the collision monitor holding for a polygon or not."""
        self._x, self._y, self._yaw, self._motors = x, 0.0, 0.0, motors
        self._missed = list(missed)
        self._states = dict.fromkeys(SERVERS, "active")
        self._hold(held)
        self._cancels.clear()
        time.sleep(10 * STEP_S)  # until transforms and odometry from there have come

    def hold(self, polygon: str) -> None:
        """Has the collision monitor hold for a polygon; "" lets go."""
        self._hold(polygon)

    def push(self, x: float) -> None:
        """Somebody pushes the base: its wheels turn."""
        self._x = x
        time.sleep(10 * STEP_S)  # as in `put`

    def speed(self) -> float:
        """How fast the base drives, or turns."""
        return max(map(abs, self._driven()))

    def x(self) -> float:
        """Where it is."""
        return self._x

    def cancels(self) -> list[str]:
        """Actions that were asked to cancel since `put`."""
        return self._cancels

    def cleared(self) -> int:
        """How often the costmap was cleared."""
        return self._cleared

    def states(self) -> dict[str, str]:
        """The servers' lifecycle states."""
        return self._states

    # ── the base ───────────────────────────────────────────────────────────────────────────────────────────────

    def _driven(self) -> tuple[float, float]:
        return self._passed if self._motors and time.monotonic() - self._commanded_at < 0.5 else (0.0, 0.0)

    def _on_passed(self, command: Twist) -> None:
        self._passed, self._commanded_at = (command.linear.x, command.angular.z), time.monotonic()

    def _on_command(self, command: Twist) -> None:
        self._wheels.publish(Twist() if self._held else command)

    def _hold(self, polygon: str) -> None:
        if polygon != self._held:
            self._held = polygon
            kind = CollisionMonitorState.STOP if polygon else CollisionMonitorState.DO_NOTHING
            self._monitor_state.publish(CollisionMonitorState(action_type=kind, polygon_name=polygon))

    def _live(self) -> None:
        count = 0
        while True:
            time.sleep(STEP_S)
            count += 1
            linear, angular = self._driven()
            self._x += linear * math.cos(self._yaw) * STEP_S
            self._y += linear * math.sin(self._yaw) * STEP_S
            self._yaw += angular * STEP_S
            stamp = self._nodes["base"].get_clock().now().to_msg()
            odometry = Odometry(child_frame_id="base_link")
            odometry.header.frame_id, odometry.header.stamp = "odom", stamp
            odometry.pose.pose.position.x, odometry.pose.pose.position.y = self._x, self._y
            odometry.pose.pose.orientation.z = math.sin(self._yaw / 2)
            odometry.pose.pose.orientation.w = math.cos(self._yaw / 2)
            odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = linear, angular
            self._odometry.publish(odometry)
            at = (self._x, self._y, self._yaw)
            edges = (("map", "odom", self._localised), ("odom", "base_link", at))
            self._tf.publish(TFMessage(transforms=[_edge(stamp, *edge) for edge in edges]))
            if count % 20 == 1:
                self._grid.publish(_free(stamp))

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose = message.pose.pose
        yaw = 2 * math.atan2(pose.orientation.z, pose.orientation.w) - self._yaw
        x = pose.position.x - (self._x * math.cos(yaw) - self._y * math.sin(yaw))
        y = pose.position.y - (self._x * math.sin(yaw) + self._y * math.cos(yaw))
        self._localised = (x, y, yaw)
        self._pose.publish(message)

    # ── the servers ────────────────────────────────────────────────────────────────────────────────────────────

    def _drive(self, handle: Any, publisher: Any, kind: Any, velocity: tuple[float, float], way: float) -> Any:
        """Sends velocities until the base has come so far or turned so far, unless it is cancelled."""
        result, before = kind.Result(), (self._x, self._y, self._yaw)

        def come() -> float:
            if velocity[1]:
                return abs(self._yaw - before[2])
            return math.hypot(self._x - before[0], self._y - before[1])

        while come() < way and not handle.is_cancel_requested:
            publisher.publish(_twist(*velocity))
            time.sleep(STEP_S)
        publisher.publish(Twist())
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return result

    def _follow(self, handle: Any) -> Any:
        path = handle.request.path.poses
        left_m = path[-1].pose.position.x - self._x if path else 0.0
        return self._drive(handle, self._commands, FollowPath, (math.copysign(SPEED, left_m), 0.0), abs(left_m))

    def _spin(self, handle: Any) -> Any:
        yaw = handle.request.target_yaw
        return self._drive(handle, self._behaviours, Spin, (0.0, math.copysign(0.8, yaw)), abs(yaw))

    def _straight(self, kind: Any, sign: int, handle: Any) -> Any:
        request = handle.request
        speed = abs(request.speed)
        return self._drive(handle, self._behaviours, kind, (sign * speed, 0.0), abs(request.target.x))

    def _plan(self, handle: Any) -> Any:
        path = Path()
        path.header.frame_id = "map"
        for share in range(11):
            pose = PoseStamped(header=path.header)
            pose.pose.position.x = self._x + (handle.request.goal.pose.position.x - self._x) * share / 10
            pose.pose.orientation.w = 1.0
            path.poses.append(pose)
        handle.succeed()
        return ComputePathToPose.Result(path=path, planning_time=Duration(nanosec=1_000_000))

    def _waypoints(self, handle: Any) -> Any:
        handle.succeed()
        poses = handle.request.poses
        missed = [MissedWaypoint(index=one, goal=poses[one], error_code=208) for one in self._missed]
        return FollowWaypoints.Result(missed_waypoints=missed)

    def _clear(self, _: Any, answer: Any) -> Any:
        self._cleared += 1
        return answer

    # ── lifecycle ──────────────────────────────────────────────────────────────────────────────────────────────

    def _manage(self, request: Any, answer: Any) -> Any:
        self._states = dict.fromkeys(SERVERS, COMMANDS[request.command])
        answer.success = True
        return answer

    def _is_active(self, _: Any, answer: Any) -> Any:
        answer.success = set(self._states.values()) == {"active"}
        return answer

    def _get_state(self, name: str, _: Any, answer: Any) -> Any:
        answer.current_state = State(label=self._states[name])
        return answer

    def _possible(self, name: str, _: Any, answer: Any) -> Any:
        for number, label in enumerate(TRANSITIONS.get(self._states[name], ())):
            transition = Transition(id=number + 1, label=label)
            answer.available_transitions.append(TransitionDescription(transition=transition))
        return answer

    def _change_state(self, name: str, request: Any, answer: Any) -> Any:
        self._states[name] = LEADS_TO[request.transition.label]
        answer.success = True
        return answer


def _twist(linear: float, angular: float) -> Twist:
    twist = Twist()
    twist.linear.x, twist.angular.z = linear, angular
    return twist


def _edge(stamp: Any, parent: str, child: str, at: tuple[float, float, float]) -> TransformStamped:
    edge = TransformStamped(child_frame_id=child)
    edge.header.stamp, edge.header.frame_id = stamp, parent
    edge.transform.translation.x, edge.transform.translation.y = at[0], at[1]
    edge.transform.rotation.z, edge.transform.rotation.w = math.sin(at[2] / 2), math.cos(at[2] / 2)
    return edge


def _free(stamp: Any) -> OccupancyGrid:
    grid = OccupancyGrid()
    grid.header.frame_id, grid.header.stamp = "map", stamp
    grid.info.resolution, grid.info.width, grid.info.height = 0.2, 100, 100
    grid.info.origin.position.x = grid.info.origin.position.y = -10.0
    grid.data = [0] * 10_000
    return grid


def main() -> None:
    nav2 = Nav2()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(nav2, command)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
