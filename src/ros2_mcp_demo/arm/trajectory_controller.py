"""/arm_controller and /gripper_controller: the topic and the action of ros2_control's joint_trajectory_controller."""

# pyright: basic
from __future__ import annotations

import math
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action.server import GoalResponse
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from .. import optional
from ..nodes.goal_server import GoalServer
from ..nodes.part import OK, WARN, RobotPart

FEEDBACK_RATE = 10.0


class TrajectoryController(RobotPart):
    """Follows one trajectory at a time; a new one, by topic or action, replaces it.

    Like the real controller it requires all of its joints in each trajectory, unless `allow_partial_joints_goal` is
    set.
    """

    def __init__(self, robot, namespace, which):
        super().__init__(f"{which}_controller", robot, namespace)
        self._controller = robot.controllers[which]
        joints = [self.frame(name) for name in self._controller.names]
        self.declare_parameter("joints", joints, ParameterDescriptor(description="The joints", read_only=True))
        self.declare_switch("allow_partial_joints_goal", False, "Whether a trajectory may leave joints out")
        self.declare_number("goal_tolerance", 0.02, 0.001, 1.0, "How far off a joint may be at the end [rad or m]")
        self.declare_number("goal_time", 1.0, 0.1, 60.0, "How much later than planned the goal may be reached [s]")
        self.declare_text("stuck_joint", "", "Simulated fault: this joint does not move any more")
        self.create_subscription(JointTrajectory, "~/joint_trajectory", self._on_trajectory, 10)
        self._action: Any = None
        self._server: Any = None
        self._handle: Any = None
        self._tolerances, self._time_tolerance = {}, 0.0

    def tick(self, stamp):
        """Check whether the trajectory is over, and publish feedback."""
        if self._server is None and self.is_due(1.0, "action"):
            self._offer_action()
        for name, joint in self.robot.joints.items():
            if name in self._controller.names:
                joint.stuck = self.frame(name) == self.setting("stuck_joint")
        if self._handle is None:
            return
        if self._handle.is_cancel_requested:
            self._controller.hold()
            self._end("canceled", 0, "canceled; the joints hold where they are")
            return
        if self._controller.is_over():
            self._judge_end()
        if self._handle and self.is_due(FEEDBACK_RATE, "feedback"):
            self._handle.publish_feedback(self._feedback(stamp))

    def diagnosis(self):
        """Return what the controller does."""
        if stuck := self.setting("stuck_joint"):
            return WARN, f"{stuck} does not move", {}
        return OK, "holding" if self._controller.is_over() else "following a trajectory", {}

    def _offer_action(self):
        """Offer the action once its interfaces are installed, which may be built while the robot runs."""
        for actions in optional.arrived("control_msgs", "action"):
            self._action = actions.FollowJointTrajectory
            self._server = GoalServer(self, self._action, "~/follow_joint_trajectory", self._judge, self._begin)

    def _on_trajectory(self, message):
        reason = self._why_not(message)
        if reason:
            self.get_logger().error(f"trajectory ignored: {reason[1]}")
            return
        if self._handle:
            self._end("abort", -1, "replaced by a trajectory on the topic")
        self._follow(message)

    def _judge(self, goal):
        reason = self._why_not(goal.trajectory)
        if reason is None:
            return GoalResponse.ACCEPT
        self.get_logger().error(f"goal rejected: {reason[1]}")
        return GoalResponse.REJECT

    def _why_not(self, trajectory):
        """Return why a trajectory is rejected, as error code and text; None if it is accepted."""
        names, known = list(trajectory.joint_names), [self.frame(name) for name in self._controller.names]
        if not names or not trajectory.points:
            return -1, "it has no joints, or no points"
        if unknown := [name for name in names if name not in known]:
            return -2, f"there is no joint {unknown[0]}; the joints are {', '.join(known)}"
        if len(names) < len(known) and not self.setting("allow_partial_joints_goal"):
            return -2, f"{', '.join(name for name in known if name not in names)} left out, all joints are needed"
        times = [_seconds(point.time_from_start) for point in trajectory.points]
        if any(times[index] <= times[index - 1] for index in range(1, len(times))):
            return -1, "the times of the points do not rise"
        for point in trajectory.points:
            numbers = [*point.positions, *point.velocities]
            if len(point.positions) != len(names) or len(point.velocities) not in (0, len(names)):
                return -1, "a point has not as many positions or velocities as there are joints"
            if not all(map(math.isfinite, numbers)):
                return -1, "a number is not finite"
        start = trajectory.header.stamp.sec + trajectory.header.stamp.nanosec * 1e-9
        if start and start + times[-1] < self.get_clock().now().nanoseconds * 1e-9:
            return -3, "it ends in the past"
        return None

    def _follow(self, trajectory):
        bare = {self.frame(name): name for name in self._controller.names}
        points = [
            (_seconds(point.time_from_start), list(point.positions), list(point.velocities) or None)
            for point in trajectory.points
        ]
        self._controller.follow([bare[name] for name in trajectory.joint_names], points)

    def _begin(self, handle):
        if self._handle:
            self._end("abort", -1, "replaced by a new goal")
        goal = handle.request
        self._tolerances = {tolerance.name: tolerance.position for tolerance in goal.goal_tolerance}
        self._time_tolerance = _seconds(goal.goal_time_tolerance)
        self._handle = handle
        self._follow(goal.trajectory)

    def _judge_end(self):
        """Succeed if every joint is within its tolerance and stands; abort and hold if that takes too long."""
        far = {}
        for name, error in self._controller.errors().items():
            shown = self.frame(name)
            most = self._tolerances.get(shown) or self.setting("goal_tolerance")
            if abs(error) > most or abs(self.robot.joints[name].velocity) > most:
                far[shown] = error
        late = self.robot.now - self._controller.began - self._controller.trajectory.duration
        if not far:
            self._end("succeed", 0, "")
        elif late > (self._time_tolerance or self.setting("goal_time")):
            self._controller.hold()
            worst = max(far, key=lambda name: abs(far[name]))
            self._end("abort", -5, f"{worst} is {far[worst]:.3f} from its goal")

    def _end(self, how, code, text):
        """End the goal; `how` is the name of the goal handle's method: succeed, abort or canceled."""
        handle, self._handle = self._handle, None
        self.get_logger().info(f"goal ended: {how}{': ' + text if text else ''}")
        getattr(handle, how)()
        self._server.finish(handle, self._action.Result(error_code=code, error_string=text))

    def _feedback(self, stamp):
        wanted, rates = self._controller.wanted()
        joints = [self.robot.joints[name] for name in self._controller.names]
        feedback = self._action.Feedback(joint_names=[self.frame(name) for name in self._controller.names])
        feedback.header.stamp = stamp
        feedback.desired = JointTrajectoryPoint(positions=list(wanted), velocities=list(rates))
        feedback.actual = JointTrajectoryPoint(positions=[joint.position for joint in joints])
        feedback.actual.velocities = [joint.velocity for joint in joints]
        errors = [want - joint.position for want, joint in zip(wanted, joints)]  # noqa: B905 (3.8)
        feedback.error = JointTrajectoryPoint(positions=errors)
        return feedback


def _seconds(duration):
    return duration.sec + duration.nanosec * 1e-9
