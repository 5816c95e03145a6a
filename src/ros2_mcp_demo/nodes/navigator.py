"""/navigator: the action /navigate_to, which drives to a position in the map around walls and obstacles."""

# pyright: basic
from __future__ import annotations

import math
from typing import Any

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Path
from rclpy.action.server import GoalResponse

from .. import optional
from ..drive import Drive, Goal, Surroundings
from ..simulation import AUTONOMOUS, IDLE, MAP_RESOLUTION
from .goal_server import GoalServer
from .part import OK, RobotPart

COMMAND_RATE = 10.0  # Hz; the base stops after 0.5 s without a command
FEEDBACK_RATE = 5.0
SMALLEST_TOLERANCE = 0.05


class Navigator(RobotPart):
    """Drives to one goal at a time; a new goal replaces the old one."""

    def __init__(self, robot, namespace):
        super().__init__("navigator", robot, namespace)
        self.declare_number("max_linear_speed", 0.4, 0.05, 1.0, "Fastest driving speed [m/s]")
        self.declare_number("max_angular_speed", 1.2, 0.1, 3.0, "Fastest turning speed [rad/s]")
        cells, origin = robot.map
        self._surroundings = Surroundings(cells, origin, MAP_RESOLUTION)
        self._commands = self.create_publisher(Twist, "cmd_vel_nav", 10)
        self._plans = self.create_publisher(Path, "plan", 10)
        self._action = optional.demo_actions.NavigateTo
        self._server = GoalServer(self, self._action, "navigate_to", self._judge, self._begin)
        self._handle: Any = None
        self._drive: Any = None
        self._shown_path = None
        self._started, self._travelled_before = 0.0, 0.0

    def tick(self, stamp):
        """Continue the drive and send feedback, or stop."""
        if self._handle is None:
            return
        if self._handle.is_cancel_requested:
            if self.robot.is_moving() and self.robot.mode == AUTONOMOUS:
                self._command(0.0, 0.0)
            else:
                self._end("canceled", "canceled; the robot stands")
            return
        if self.robot.driver is not self:
            self._end("abort", "replaced by a goal for /navigate_to_pose")
            return
        if self.is_due(COMMAND_RATE, "command"):
            self._drive_on(stamp)
        if self._handle and self.is_due(FEEDBACK_RATE, "feedback"):
            self._handle.publish_feedback(self._feedback())

    def diagnosis(self):
        """Return the state of the navigator."""
        return OK, self._drive.state if self._drive else "no goal", {}

    def _judge(self, goal):
        reason = self._why_not(goal)
        if reason is None:
            return GoalResponse.ACCEPT
        self.get_logger().warning(f"goal rejected: {reason}")
        return GoalResponse.REJECT

    def _why_not(self, goal):
        numbers = (goal.x, goal.y, goal.tolerance, goal.yaw if goal.use_yaw else 0.0)
        if not all(map(math.isfinite, numbers)):
            return "x, y, yaw and tolerance must be finite numbers"
        if goal.tolerance < 0.0:
            return "tolerance must not be negative"
        if self.robot.mode == IDLE:
            return "the robot is idle; set the mode to manual or autonomous first"
        cells, (x, y) = self.robot.map
        row, column = math.floor((goal.y - y) / MAP_RESOLUTION), math.floor((goal.x - x) / MAP_RESOLUTION)
        rows, columns = cells.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return f"({goal.x:g}, {goal.y:g}) is outside the map"
        return None

    def _begin(self, handle):
        if self._handle is not None:
            self._end("abort", "replaced by a new goal")
        request = handle.request
        yaw = request.yaw if request.use_yaw else None
        goal = Goal(request.x, request.y, yaw, max(request.tolerance, SMALLEST_TOLERANCE))
        self._handle = handle
        self._drive = Drive(goal, self._surroundings, self.robot.now)
        self._started, self._travelled_before = self.robot.now, self.robot.base.travelled
        self.robot.mode, self.robot.driver = AUTONOMOUS, self
        self.get_logger().info(f"driving to ({goal.x:g}, {goal.y:g})")

    def _drive_on(self, stamp):
        stopped = self.robot.why_not_driving()
        if stopped is None and self.robot.mode != AUTONOMOUS:
            stopped = f"the mode became {self.robot.mode}"
        if stopped:
            self._end("abort", stopped)
            return
        if self.robot.ranges is not None:
            self._surroundings.see(self.robot.scan_points(self.robot.ranges), self.robot.now)
        drive, base = self._drive, self.robot.base
        fastest, turning = self.setting("max_linear_speed"), self.setting("max_angular_speed")
        self._command(*drive.step(base.pose, self.robot.now, base.blocked, fastest, turning))
        if drive.path is not self._shown_path:
            self._shown_path = drive.path
            path = self.headed(Path(), stamp, "map")
            path.poses = [PoseStamped(header=path.header) for _ in drive.path]
            for point, (x, y) in zip(path.poses, drive.path):  # noqa: B905 (3.8)
                point.pose.position.x, point.pose.position.y = float(x), float(y)
            self._plans.publish(path)
        if drive.outcome:
            self._end("succeed" if drive.outcome[0] else "abort", drive.outcome[1])

    def _end(self, how, reason):
        """End the goal; `how` is the name of the goal handle's method: succeed, abort or canceled."""
        if self.robot.mode == AUTONOMOUS and self.robot.driver is self:
            self._command(0.0, 0.0)
        pose = self.robot.base.pose
        result = self._action.Result(
            reached=how == "succeed",
            reason=reason,
            distance_travelled=self.robot.base.travelled - self._travelled_before,
            duration=self.robot.now - self._started,
            final_x=pose.x,
            final_y=pose.y,
            final_yaw=pose.yaw,
        )
        handle = self._handle
        self._handle = self._drive = None
        self.get_logger().info(f"goal ended: {reason}")
        getattr(handle, how)()
        self._server.finish(handle, result)

    def _feedback(self):
        pose, drive = self.robot.base.pose, self._drive
        remaining = drive.remaining(pose)
        left = remaining / self.setting("max_linear_speed")
        return self._action.Feedback(
            state=drive.state,
            distance_remaining=remaining,
            estimated_time_remaining=Duration(sec=int(left), nanosec=int(left % 1 * 1e9)),
            x=pose.x,
            y=pose.y,
            yaw=pose.yaw,
            replans=max(drive.replans, 0),
        )

    def _command(self, linear, angular):
        command = Twist()
        command.linear.x, command.angular.z = float(linear), float(angular)
        self._commands.publish(command)
