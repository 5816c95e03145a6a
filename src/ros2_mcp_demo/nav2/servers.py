"""Nav2's driving servers: a controller, a navigator that sends goals to it, and behaviours.

As in Nav2, the controller continues to follow a path when the navigator is gone.
"""

# pyright: basic
from __future__ import annotations

import math
from typing import Any

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Twist
from rclpy.action.client import ActionClient
from rclpy.action.server import GoalResponse

from ..base import Pose, wrapped
from ..drive import Drive, Goal
from ..nodes.convert import place
from ..nodes.goal_server import GoalServer
from ..nodes.lifecycle_part import LifecyclePart
from ..nodes.nav2 import NO_PROGRESS, TOLERANCE, ControllerServer, Impossible, PlannerServer

COMMAND_RATE, FEEDBACK_RATE = 10.0, 5.0
SPIN_RAD_S = 0.8


class Managed:
    """A lifecycle node that a lifecycle manager brings up, and whose configuration may fail."""

    fails = ""
    """Why the configuration fails; "" if it succeeds."""
    starved = False
    """Whether the node misses its heartbeats."""

    def start(self):
        """Do nothing: the lifecycle manager brings the node up."""

    def on_configure(self, state):
        """Configure the node, or log why that fails."""
        if self.fails:
            self.get_logger().error(self.fails)  # pyright: ignore[reportAttributeAccessIssue]
            from rclpy.lifecycle import TransitionCallbackReturn

            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)  # pyright: ignore[reportAttributeAccessIssue]


class Planner(Managed, PlannerServer):
    """The planner. Its costmap is published by the costmap's own node, and is unknown from x = `unknown_from_m` on."""

    unknown_from_m = math.inf

    def _grid(self, stamp):
        grid = super()._grid(stamp)
        known = (self.unknown_from_m - grid.info.origin.position.x) / grid.info.resolution
        for index in range(len(grid.data)) if known < grid.info.width else ():
            if index % grid.info.width >= known:
                grid.data[index] = -1
        return grid


class Controller(Managed, ControllerServer):
    """Serves /follow_path. `most_hz` is the rate that its computer is able to keep, in Hz."""

    most_hz = math.inf

    def __init__(self, robot, namespace, navigation, action, **parameters):
        super().__init__(robot, namespace, navigation)
        declare(self, parameters)
        self._action, self._handle = action, None
        self._drive: Any = None
        self._server = GoalServer(self, action, "follow_path", self._judge, self._begin)

    def tick(self, stamp):  # noqa: ARG002
        """Follow the path."""
        if self._handle is None:
            return
        if self._handle.is_cancel_requested:
            if self.robot.is_moving():
                self.command(0.0, 0.0)
            else:
                self._end("canceled")
            return
        if not self.is_active:
            self._end("abort", NO_PROGRESS, "the controller server is not active")
        elif self.is_due(min(self.setting("controller_frequency"), self.most_hz), "command"):
            self._drive_on()
        if self._handle and self.is_due(FEEDBACK_RATE, "feedback"):
            left = self._drive.remaining(self.robot.believed())
            self._handle.publish_feedback(
                self._action.Feedback(distance_to_goal=float(left), speed=float(abs(self.robot.base.linear)))
            )

    def _drive_on(self):
        self._navigation.look()
        try:
            self.follow(self._drive)
        except Impossible as error:
            self.get_logger().error(str(error))
            self._end("abort", error.code, str(error))
            return
        if self._drive.outcome:
            reached, reason = self._drive.outcome
            if not reached:
                self.get_logger().error("Failed to make progress")
            self._end("succeed" if reached else "abort", 0 if reached else NO_PROGRESS, "" if reached else reason)

    def _judge(self, _):
        return GoalResponse.ACCEPT if self.is_active else GoalResponse.REJECT

    def _begin(self, handle):
        if self._handle is not None:
            self._end("abort")
        last = handle.request.path.poses[-1].pose
        yaw = 2 * math.atan2(last.orientation.z, last.orientation.w)
        self._handle = handle
        goal = Goal(last.position.x, last.position.y, yaw, TOLERANCE)
        self._drive = Drive(goal, self._navigation.surroundings, self.robot.now)

    def _end(self, how, code=0, reason=""):
        handle, self._handle, self._drive = self._handle, None, None
        self.command(0.0, 0.0)
        getattr(handle, how)()
        self._server.finish(handle, self._action.Result(error_code=code, error_msg=reason))


class TreeNavigator(Managed, LifecyclePart):
    """Serves /navigate_to_pose: plans, and sends a goal to /follow_path."""

    def __init__(self, robot, namespace, navigation, planner, actions, **parameters):
        super().__init__("bt_navigator", robot, namespace)
        declare(self, parameters)
        self._navigation, self._planner, self._actions = navigation, planner, actions
        self._server = GoalServer(self, actions.NavigateToPose, "navigate_to_pose", self._judge, self._begin)
        self._client = ActionClient(self, actions.FollowPath, "follow_path")
        self._handle: Any = None
        self._sent: Any = None
        self._result: Any = None
        self._left, self._began_at = 0.0, 0.0
        self._is_cancelling = False

    def tick(self, stamp):
        """Check the state of the controller's goal."""
        if self._handle is None:
            return
        if self._sent.done() and self._result is None:
            following = self._sent.result()
            if not following.accepted:
                self._end("abort", NO_PROGRESS, "the controller server rejected the path")
                return
            self._result = following.get_result_async()
        if self._handle.is_cancel_requested and self._result is not None and not self._is_cancelling:
            self._is_cancelling = True
            self._sent.result().cancel_goal_async()
        if self._result is not None and self._result.done():
            answer = self._result.result()
            how = {4: "succeed", 5: "canceled"}.get(answer.status, "abort")
            if how == "canceled" and not self._handle.is_cancel_requested:
                how = "abort"
            self._end(how, answer.result.error_code, answer.result.error_msg)
        elif self.is_due(FEEDBACK_RATE, "feedback"):
            self._handle.publish_feedback(self._feedback(stamp))

    def _judge(self, goal):
        try:
            if not self.is_active:
                raise Impossible(0, "the action server is not active")
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
        self._handle, self._began_at, self._result = handle, self.robot.now, None
        self._is_cancelling, self._sent = False, None
        self._navigation.look()
        try:
            start, goal = self._navigation.pose(), self._navigation.in_map(handle.request.pose, self)
            path = self._planner.search(start, goal)
        except Impossible as error:
            self._end("abort", error.code, str(error))
            return
        self._left = math.dist((start.x, start.y), (goal.x, goal.y))
        self._sent = self._client.send_goal_async(
            self._actions.FollowPath.Goal(path=path), feedback_callback=self._hear
        )
        self.get_logger().info("Begin navigating")

    def _hear(self, message):
        self._left = message.feedback.distance_to_goal

    def _feedback(self, stamp):
        feedback = self._actions.NavigateToPose.Feedback(
            navigation_time=Duration(sec=int(self.robot.now - self._began_at)), distance_remaining=float(self._left)
        )
        self.headed(feedback.current_pose, stamp, "map")
        place(feedback.current_pose.pose, self.robot.believed())
        return feedback

    def _end(self, how, code=0, reason=""):
        handle, self._handle = self._handle, None
        if how == "abort":
            self.get_logger().error("Goal failed")
        getattr(handle, how)()
        self._server.finish(handle, self._actions.NavigateToPose.Result(error_code=code, error_msg=reason))


class Behaviors(Managed, LifecyclePart):
    """Serves /spin and /backup; publishes commands on the controller's topic, by design."""

    def __init__(self, robot, namespace, actions, **parameters):
        super().__init__("behavior_server", robot, namespace)
        declare(self, parameters)
        self._commands = self.create_publisher(Twist, "cmd_vel_nav", 10)
        self._handle: Any = None
        self._from = Pose()
        self._began_at = 0.0
        self._action: Any = None
        self._servers = {
            action: GoalServer(
                self, action, name, self._judge, lambda handle, action=action: self._begin(handle, action)
            )
            for action, name in ((actions.Spin, "spin"), (actions.BackUp, "backup"))
        }

    def tick(self, stamp):  # noqa: ARG002
        """Turn, or drive back."""
        handle = self._handle
        if handle is None:
            return
        goal, pose = handle.request, self.robot.base.odometry
        is_spin = hasattr(goal, "target_yaw")
        done = (
            abs(wrapped(pose.yaw - self._from.yaw))
            if is_spin
            else math.dist((pose.x, pose.y), (self._from.x, self._from.y))
        )
        wanted = abs(goal.target_yaw) if is_spin else abs(goal.target.x)
        if handle.is_cancel_requested:
            self._end("canceled")
        elif done >= wanted:
            self._end("succeed")
        elif self.is_due(COMMAND_RATE, "command"):
            command = Twist()
            command.angular.z = math.copysign(SPIN_RAD_S, goal.target_yaw) if is_spin else 0.0
            command.linear.x = 0.0 if is_spin else -abs(goal.speed)
            self._commands.publish(command)

    def _judge(self, _):
        return GoalResponse.ACCEPT if self.is_active else GoalResponse.REJECT

    def _begin(self, handle, action):
        if self._handle is not None:
            self._end("abort")
        self._handle, self._action, self._began_at = handle, action, self.robot.now
        self._from = Pose(self.robot.base.odometry.x, self.robot.base.odometry.y, self.robot.base.odometry.yaw)

    def _end(self, how):
        handle, self._handle = self._handle, None
        self._commands.publish(Twist())
        getattr(handle, how)()
        elapsed = Duration(sec=int(self.robot.now - self._began_at))
        self._servers[self._action].finish(handle, self._action.Result(total_elapsed_time=elapsed))


def declare(node, parameters):
    """Declare parameters by name and value; `__` in a name stands for a dot."""
    for name, value in parameters.items():
        node.declare_parameter(name.replace("__", "."), value)
