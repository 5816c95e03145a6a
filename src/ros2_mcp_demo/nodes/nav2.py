"""Navigation with Nav2's interfaces: /bt_navigator, /planner_server and /controller_server, three lifecycle nodes.

They share one `Navigation`, the state that Nav2's servers exchange. Failures are reported as by Nav2: with an error
code of the server that failed, and in its log. Needs nav2_msgs, which may be installed later than the rest.
"""

# pyright: basic
from __future__ import annotations

import array
import math
from typing import Any

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.action.server import GoalResponse

from .. import optional
from ..base import Pose, wrapped
from ..costs import costs
from ..drive import Drive, Goal, Surroundings
from ..planner import RESOLUTION, plan
from ..simulation import AUTONOMOUS, IDLE, MAP_RESOLUTION
from .convert import place, quaternion
from .lifecycle_part import LifecyclePart
from .navigator import GoalServer
from .part import OK, WARN

COMMAND_RATE, FEEDBACK_RATE, COSTMAP_RATE = 10.0, 5.0, 1.0
POSE_AGE_S = 1.0
"""Age from which the robot's pose counts as unknown."""
SENSOR_AGE_S = 1.5
"""Age of the last scan from which the robot must not drive."""
TOLERANCE = 0.15
SPACING = 0.1

# Codes of nav2_msgs, as Jazzy has them.
NO_PLANNER, NO_TRANSFORM, START_OUTSIDE, GOAL_OUTSIDE = 201, 202, 203, 204
START_OCCUPIED, GOAL_OCCUPIED, TOO_SLOW, NO_PATH = 205, 206, 207, 208
LOST, NO_PROGRESS, CONTROLLER_TIMED_OUT = 102, 105, 107


class Impossible(Exception):
    """A path or pose that does not exist; `code` is Nav2's error code."""

    def __init__(self, code, reason):
        super().__init__(reason)
        self.code = code


def parts(robot, namespace):
    """Return the three nodes; an empty list while nav2_msgs is missing."""
    interfaces = optional.arrived("nav2_msgs", "action", "srv")
    if not interfaces:
        return []
    actions, services = interfaces
    navigation = Navigation(robot)
    planner = PlannerServer(robot, namespace, navigation, actions.ComputePathToPose, services.ClearEntireCostmap)
    controller = ControllerServer(robot, namespace, navigation)
    return [BtNavigator(robot, namespace, navigation, actions.NavigateToPose, planner, controller), planner, controller]


class Navigation:
    """The robot's estimated pose, its surroundings, and paths through them."""

    def __init__(self, robot):
        self.robot = robot
        self._cells, self._origin = robot.map
        self.surroundings = Surroundings(self._cells, self._origin, MAP_RESOLUTION)
        self.seen_at = -math.inf

    def look(self):
        """Process the latest scan."""
        if self.robot.ranges is not None:
            self.surroundings.see(self.robot.scan_points(self.robot.ranges), self.robot.now)
            self.seen_at = self.robot.now

    def forget(self):
        """Forget the obstacles that were seen."""
        self.surroundings = Surroundings(self._cells, self._origin, MAP_RESOLUTION)

    def pose(self):
        """Return the robot's estimated pose in the map; raises `Impossible` if it is not localised."""
        if self.robot.now - self.robot.localized_at > POSE_AGE_S:
            raise Impossible(NO_TRANSFORM, "no transform from map to base_link that is newer than 1 s")
        return self.robot.believed()

    def in_map(self, stamped, part):
        """Convert a PoseStamped to a pose in the map; raises `Impossible`."""
        at, turn, frame = stamped.pose.position, stamped.pose.orientation, stamped.header.frame_id
        if not all(map(math.isfinite, (at.x, at.y, turn.x, turn.y, turn.z, turn.w))):
            raise Impossible(GOAL_OUTSIDE, "the pose has numbers that are not finite")
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
        named = {"map": Pose, "base_link": self.pose, "odom": self._odom_in_map}
        origins: Any = {part.frame(name): origin for name, origin in named.items()}
        if frame not in origins:
            raise Impossible(NO_TRANSFORM, f"no transform from {frame!r} to map: there is no such frame")
        origin = origins[frame]()
        cos, sin = math.cos(origin.yaw), math.sin(origin.yaw)
        return Pose(origin.x + cos * at.x - sin * at.y, origin.y + sin * at.x + cos * at.y, wrapped(origin.yaw + yaw))

    def _odom_in_map(self):
        pose, odometry = self.pose(), self.robot.base.odometry
        yaw = wrapped(pose.yaw - odometry.yaw)
        cos, sin = math.cos(yaw), math.sin(yaw)
        return Pose(pose.x - cos * odometry.x + sin * odometry.y, pose.y - sin * odometry.x - cos * odometry.y, yaw)

    def way(self, start, goal):
        """Return a path [(x, y), …] in m; raises `Impossible` with the planner's code."""
        costmap: Any = self.surroundings.costmap()
        for pose, name, outside, occupied in (
            (start, "start", START_OUTSIDE, START_OCCUPIED),
            (goal, "goal", GOAL_OUTSIDE, GOAL_OCCUPIED),
        ):
            row, column = costmap.cell(pose.x, pose.y)
            if not costmap.holds(row, column):
                raise Impossible(outside, f"the {name} ({pose.x:.2f}, {pose.y:.2f}) is outside of the map")
            # A start within the inflation is allowed, as a robot close to a wall must be able to leave it.
            closed = costmap.blocked if name == "goal" else costmap.occupied
            if closed[row, column]:
                raise Impossible(occupied, f"the {name} ({pose.x:.2f}, {pose.y:.2f}) is in an occupied cell")
        path = plan(costmap, (start.x, start.y), (goal.x, goal.y))
        if path is None:
            raise Impossible(NO_PATH, f"no valid path to ({goal.x:.2f}, {goal.y:.2f})")
        return path


class PlannerServer(LifecyclePart):
    """Serves /compute_path_to_pose, and publishes the global costmap."""

    def __init__(self, robot, namespace, navigation, action, clearing, costmap=None):
        """Create the server; `costmap` is the publisher of the global costmap if that has its own node."""
        super().__init__("planner_server", robot, namespace)
        self.declare_parameter("planner_plugins", ["GridBased"])
        self.declare_number("max_planning_time", 5.0, 0.0, 60.0, "A search that takes longer fails [s]")
        self._navigation, self._action = navigation, action
        self._costmap = costmap or self.create_latched_publisher(OccupancyGrid, "global_costmap/costmap")
        self._plans = self.create_publisher(Path, "plan", 10)
        self._server = GoalServer(self, action, "compute_path_to_pose", self._judge, self._begin)
        self.create_service(clearing, "global_costmap/clear_entirely_global_costmap", self._clear)
        self.start()

    def tick(self, stamp):
        """Process the latest scan, and publish the costmap when it is due."""
        if self.is_active and self.is_due(COSTMAP_RATE):
            self._navigation.look()
            self._costmap.publish(self._grid(stamp))

    def diagnosis(self):
        """Return whether the server is active."""
        return OK if self.is_active else WARN, "active" if self.is_active else "not active", {}

    def search(self, start, goal):
        """Plan a path and publish it; raises `Impossible`, which is logged."""
        try:
            if not self.is_active:
                raise Impossible(NO_PLANNER, "the planner server is not active")
            path = self._navigation.way(start, goal)
            if self.setting("max_planning_time") <= 0.0:
                raise Impossible(TOO_SLOW, "planning took longer than max_planning_time")
        except Impossible as error:
            self.tell(error, start, goal)
            raise
        message = self.path_of(path, goal.yaw)
        self._plans.publish(message)
        return message

    def tell(self, error, start, goal):
        """Log why there is no path."""
        ends = f"from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f})"
        self.get_logger().warning(f"GridBased planner failed to plan {ends}: {error}")

    def path_of(self, points, yaw):
        """Return a path as a message: a pose every 0.1 m that faces along the path, the last one with the goal's
        heading."""
        path: Any = self.headed(Path(), self.get_clock().now().to_msg(), "map")
        for i in range(len(points) - 1):
            (x, y), (to_x, to_y) = points[i], points[i + 1]
            heading = math.atan2(to_y - y, to_x - x)
            steps = max(1, math.ceil(math.dist(points[i], points[i + 1]) / SPACING))
            for step in range(steps):
                share = step / steps
                path.poses.append(self._stamped(path, Pose(x + share * (to_x - x), y + share * (to_y - y), heading)))
        path.poses.append(self._stamped(path, Pose(points[-1][0], points[-1][1], yaw)))
        return path

    def _stamped(self, path, pose):
        stamped = PoseStamped(header=path.header)
        stamped.pose.position.x, stamped.pose.position.y = float(pose.x), float(pose.y)
        stamped.pose.orientation = quaternion(pose.yaw)
        return stamped

    def _grid(self, stamp):
        costmap = self._navigation.surroundings.costmap()
        cells: Any = costs(costmap.occupied)
        grid = self.headed(OccupancyGrid(), stamp, "map")
        grid.info.map_load_time, grid.info.resolution = stamp, RESOLUTION
        grid.info.height, grid.info.width = cells.shape
        grid.info.origin.position.x, grid.info.origin.position.y = costmap.origin
        grid.data = array.array("b", cells.tobytes())
        return grid

    def _judge(self, _):
        if self.is_active:
            return GoalResponse.ACCEPT
        self.get_logger().error("the planner server is not active: goal rejected")
        return GoalResponse.REJECT

    def _begin(self, handle):
        request, result = handle.request, self._action.Result()
        try:
            start = self._navigation.in_map(request.start, self) if request.use_start else self._navigation.pose()
            goal = self._navigation.in_map(request.goal, self)
            self._navigation.look()
            if request.planner_id not in ("", "GridBased"):
                raise Impossible(NO_PLANNER, f"there is no planner {request.planner_id!r}; there is GridBased")
            result.path = self.search(start, goal)
            handle.succeed()
        except Impossible as error:
            result.error_code, result.error_msg = error.code, str(error)
            handle.abort()
        self._server.finish(handle, result)

    def _clear(self, _, response):
        self._navigation.forget()
        self.get_logger().info("the global costmap was cleared")
        return response


class ControllerServer(LifecyclePart):
    """Follows a path by publishing velocities."""

    def __init__(self, robot, namespace, navigation):
        super().__init__("controller_server", robot, namespace)
        self.declare_number("max_linear_speed", 0.4, 0.05, 1.0, "Fastest driving speed [m/s]")
        self.declare_number("max_angular_speed", 1.2, 0.1, 3.0, "Fastest turning speed [rad/s]")
        self._navigation = navigation
        self._commands = self.create_publisher(Twist, "cmd_vel_nav", 10)
        self._limit = math.inf
        if messages := optional.arrived("nav2_msgs", "msg"):
            self.create_subscription(messages[0].SpeedLimit, "speed_limit", self._take_limit, 10)
        self.start()

    def _take_limit(self, message):
        share = self.setting("max_linear_speed") / 100 if message.percentage else 1.0
        self._limit = share * message.speed_limit or math.inf

    def follow(self, drive):
        """Publish the next command of a drive; raises `Impossible`."""
        robot = self.robot
        if not self.is_active:
            raise Impossible(NO_PROGRESS, "the controller server is not active")
        if robot.now - self._navigation.seen_at > SENSOR_AGE_S:
            age = robot.now - self._navigation.seen_at
            raise Impossible(CONTROLLER_TIMED_OUT, f"the costmap has had no laser scan for {age:.1f} s")
        try:
            pose = self._navigation.pose()
        except Impossible as error:
            raise Impossible(LOST, str(error)) from error
        fastest, turning = min(self._limit, self.setting("max_linear_speed")), self.setting("max_angular_speed")
        self.command(*drive.step(pose, robot.now, robot.base.blocked, fastest, turning))

    def command(self, linear, angular):
        """Publish a velocity."""
        command = Twist()
        command.linear.x, command.angular.z = float(linear), float(angular)
        self._commands.publish(command)

    def diagnosis(self):
        """Return whether the server is active."""
        return OK if self.is_active else WARN, "active" if self.is_active else "not active", {}


class BtNavigator(LifecyclePart):
    """Serves /navigate_to_pose: one goal at a time; a new one replaces the old one."""

    def __init__(self, robot, namespace, navigation, action, planner, controller):
        super().__init__("bt_navigator", robot, namespace)
        self._navigation, self._planner, self._controller, self._action = navigation, planner, controller, action
        self._server = GoalServer(self, action, "navigate_to_pose", self._judge, self._begin)
        self._handle: Any = None
        self._drive: Any = None
        self._goal = Pose()
        self._began_at = 0.0
        self._shown_path = None
        self.start()

    def tick(self, stamp):
        """Continue the drive and send feedback, or stop."""
        if self._handle is None:
            return
        if self._handle.is_cancel_requested:
            if self.robot.is_moving() and self.robot.mode == AUTONOMOUS:
                self._controller.command(0.0, 0.0)
            else:
                self._end("canceled")
            return
        if self.robot.driver is not self:
            self.get_logger().warning("the goal is replaced by one for /navigate_to")
            self._end("abort")
            return
        if self.is_due(COMMAND_RATE, "command"):
            self._drive_on()
        if self._handle and self.is_due(FEEDBACK_RATE, "feedback"):
            self._handle.publish_feedback(self._feedback(stamp))

    def diagnosis(self):
        """Return the state of the navigator."""
        if not self.is_active:
            return WARN, "not active", {}
        return OK, self._drive.state if self._drive else "no goal", {}

    def _judge(self, goal):
        try:
            if not self.is_active:
                raise Impossible(0, "the action server is not active")
            if goal.behavior_tree:
                raise Impossible(0, f"there is no behaviour tree {goal.behavior_tree!r}")
            self._navigation.pose()
            self._navigation.in_map(goal.pose, self)
        except Impossible as error:
            self.get_logger().error(f"goal rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _begin(self, handle):
        if self._handle is not None:
            self.get_logger().info("the goal is preempted by a new one")
            self._end("abort")
        self._handle, self._began_at, self.robot.driver = handle, self.robot.now, self
        self._drive = None
        self._navigation.look()
        try:
            start, goal = self._navigation.pose(), self._navigation.in_map(handle.request.pose, self)
            self._planner.search(start, goal)
        except Impossible as error:
            self._end("abort", error.code, str(error))
            return
        self._goal = goal
        self._drive = Drive(Goal(goal.x, goal.y, goal.yaw, TOLERANCE), self._navigation.surroundings, self.robot.now)
        if self.robot.mode != IDLE:
            self.robot.mode = AUTONOMOUS
        self.get_logger().info(
            f"Begin navigating from current location ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f})"
        )

    def _drive_on(self):
        drive = self._drive
        self._navigation.look()
        try:
            self._controller.follow(drive)
        except Impossible as error:
            self._controller.get_logger().error(str(error))
            self._end("abort", error.code, str(error))
            return
        if drive.path is not self._shown_path and drive.path:
            self._shown_path = drive.path
            self._planner._plans.publish(self._planner.path_of(drive.path, self._goal.yaw))
        if not drive.outcome:
            return
        reached, reason = drive.outcome
        if reached:
            self._end("succeed")
        elif "no free way" in reason:
            self._fail_without_way()
        else:
            self._fail_without_progress()

    def _fail_without_progress(self):
        self._controller.get_logger().error("Failed to make progress")
        self._end("abort", NO_PROGRESS, "Failed to make progress")

    def _fail_without_way(self):
        try:
            self._planner.search(self._navigation.pose(), self._goal)
        except Impossible as error:
            self._end("abort", error.code, str(error))
        else:  # there is a path, so the robot stands still for another reason
            self._fail_without_progress()

    def _end(self, how, code=0, reason=""):
        """End the goal; `how` is the name of the goal handle's method: succeed, abort or canceled."""
        if self.robot.mode == AUTONOMOUS and self.robot.driver is self:
            self._controller.command(0.0, 0.0)
        handle = self._handle
        self._handle = self._drive = None
        tell = {"succeed": "Goal succeeded", "abort": "Goal failed", "canceled": "Goal canceled"}[how]
        if how == "abort":
            self.get_logger().error(f"{tell}: error {code} {reason}".rstrip())
        else:
            self.get_logger().info(tell)
        getattr(handle, how)()
        self._server.finish(handle, self._action.Result(error_code=code, error_msg=reason))

    def _feedback(self, stamp):
        pose, drive = self.robot.believed(), self._drive
        remaining = drive.remaining(pose)
        left = remaining / self._controller.setting("max_linear_speed")
        feedback = self._action.Feedback(
            navigation_time=_duration(self.robot.now - self._began_at),
            estimated_time_remaining=_duration(left),
            number_of_recoveries=drive.recoveries,
            distance_remaining=float(remaining),
        )
        self.headed(feedback.current_pose, stamp, "map")
        place(feedback.current_pose.pose, pose)
        return feedback


def _duration(seconds):
    return Duration(sec=int(seconds), nanosec=int(seconds % 1 * 1e9))
