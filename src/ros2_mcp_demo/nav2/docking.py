"""Nav2's docking server: has the navigator drive to the place before a dock, then drives to the dock itself."""

# pyright: basic
from __future__ import annotations

import math
from typing import Any

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.action.client import ActionClient
from rclpy.action.server import GoalResponse

from ..base import Pose, wrapped
from ..nodes.convert import place
from ..nodes.goal_server import GoalServer
from ..nodes.lifecycle_part import LifecyclePart
from .servers import Managed, declare

STAGING, PERCEPTION, CONTROLLING, CHARGE, RETRY = 1, 2, 3, 4, 5
NOT_IN_DB, NOT_VALID, NO_STAGE, NOT_DETECTED, NO_CHARGE = 901, 902, 903, 904, 906
RATE = 10.0
BEFORE_M = 0.7
"""Distance of the staging pose from the dock's."""
SPEED, TURNING = 0.15, 0.8
NEAR_M = 0.04
LOOKS_S, CHARGES_S = 0.5, 2.0
MOST_RETRIES = 1
CHARGER, FLOOR = "charging_dock", "parking_spot"
DOCKS = {"charger": (CHARGER, (-1.7, 0.0, math.pi)), "parking": (FLOOR, (1.0, 2.3, math.pi / 2))}
"""Name → type and pose of the robot when it is docked, in the map (m, rad)."""
CONTACT_M = 0.1
"""Distance of the base from the charger's pose within which the battery charges."""


class DockingServer(Managed, LifecyclePart):
    """Serves /dock_robot and /undock_robot. `is_unseen`: the docks are not detected; `is_unpowered`: the charger has no
    power."""

    is_unseen = False
    is_unpowered = False

    def __init__(self, robot, namespace, actions, **parameters):
        super().__init__("docking_server", robot, namespace)
        declare(self, parameters)
        declare(self, {"docks": list(DOCKS), "dock_plugins": [CHARGER, FLOOR]})
        for name, (kind, pose) in DOCKS.items():
            declare(self, {f"{name}__type": kind, f"{name}__frame": "map", f"{name}__pose": list(map(float, pose))})
        self._actions = actions
        self._commands = self.create_publisher(Twist, "cmd_vel_nav", 10)
        self._navigator = ActionClient(self, actions.NavigateToPose, "navigate_to_pose")
        self._docking = GoalServer(self, actions.DockRobot, "dock_robot", self._judge, self._begin)
        self._undocking = GoalServer(self, actions.UndockRobot, "undock_robot", self._judge, self._begin)
        self._handle: Any = None
        self._sent: Any = None
        self._driven: Any = None
        self._dock: tuple[str, Pose] | None = None
        self._docked_at: tuple[str, Pose] | None = None
        self._state, self._retries = 0, 0
        self._began_at = self._state_at = 0.0
        self._is_cancelling = False

    def tick(self, stamp):  # noqa: ARG002
        """Go on with the goal, and let the battery charge while the base touches the charger."""
        self._charge()
        if self._handle is None or not self.is_due(RATE, "step"):
            return
        if self._handle.is_cancel_requested:
            self._cancel()
        elif not self.is_active:
            self._end("abort", 999, "the docking server is not active")
        elif self._handle.request.__class__ is self._actions.UndockRobot.Goal:
            self._leave()
        else:
            {STAGING: self._stage, PERCEPTION: self._look, CONTROLLING: self._approach, CHARGE: self._wait}[
                self._state
            ]()
            self._tell()

    def _charge(self):
        kind, at = DOCKS["charger"]
        pose = self.robot.base.pose
        touches = math.dist((pose.x, pose.y), at[:2]) < CONTACT_M and abs(wrapped(pose.yaw - at[2])) < 0.3
        self.robot.battery.is_charging = touches and not self.is_unpowered and kind == CHARGER

    def _judge(self, _):
        return GoalResponse.ACCEPT if self.is_active else GoalResponse.REJECT

    def _begin(self, handle):
        if self._handle is not None:
            self._end("abort", 999, "preempted by another goal")
        self._handle, self._began_at, self._retries = handle, self.robot.now, 0
        self._sent = self._driven = None
        self._is_cancelling = False
        if isinstance(handle.request, self._actions.UndockRobot.Goal):
            if self._docked_at is None and not handle.request.dock_type:
                self._end("abort", NOT_VALID, "the robot was not docked by this server, and no dock type is given")
            return
        self._dock = self._chosen(handle.request)
        if self._dock is None:
            return
        self._enter(STAGING if handle.request.navigate_to_staging_pose else PERCEPTION)
        self._tell()

    def _chosen(self, request):
        if request.use_dock_id:
            if request.dock_id not in DOCKS:
                self._end("abort", NOT_IN_DB, f"dock {request.dock_id} is not in the database")
                return None
            kind, (x, y, yaw) = DOCKS[request.dock_id]
            return kind, Pose(x, y, yaw)
        if request.dock_type not in (CHARGER, FLOOR):
            self._end("abort", NOT_VALID, f"there is no plugin for the dock type {request.dock_type!r}")
            return None
        at, turn = request.dock_pose.pose.position, request.dock_pose.pose.orientation
        return request.dock_type, Pose(at.x, at.y, 2 * math.atan2(turn.z, turn.w))

    def _enter(self, state):
        self._state, self._state_at = state, self.robot.now

    def _stage(self):
        if self._sent is None:
            _, dock = self._dock or ("", Pose())
            goal = PoseStamped()
            goal.header.frame_id = self.frame("map")
            place(goal.pose, dock.moved(-BEFORE_M, 0.0))
            self._driven = None
            self._sent = self._navigator.send_goal_async(self._actions.NavigateToPose.Goal(pose=goal))
        elif self._sent.done() and self._driven is None:
            if not self._sent.result().accepted:
                self._end("abort", NO_STAGE, "the navigator rejected the staging pose")
                return
            self._driven = self._sent.result().get_result_async()
        elif self._driven is not None and self._driven.done():
            if self._driven.result().status != 4:
                self._end("abort", NO_STAGE, "navigation to the staging pose failed")
            else:
                self._sent = None
                self._enter(PERCEPTION)

    def _look(self):
        if self.robot.now - self._state_at < LOOKS_S:
            return
        if not self.is_unseen:
            self._enter(CONTROLLING)
        else:
            self._again(NOT_DETECTED, "the dock was not detected")

    def _approach(self):
        kind, dock = self._dock or ("", Pose())
        if self._drive_to(dock):
            if kind == CHARGER:
                self._enter(CHARGE)
            else:
                self._docked_at = self._dock
                self._end("succeed")

    def _wait(self):
        if self.robot.battery.is_charging:
            self._docked_at = self._dock
            self._end("succeed")
        elif self.robot.now - self._state_at > CHARGES_S:
            self._again(NO_CHARGE, "the battery does not charge")

    def _again(self, code, reason):
        """Try once more from the staging pose, or give up."""
        if self._retries >= MOST_RETRIES:
            self.get_logger().error(reason)
            self._end("abort", code, reason)
            return
        self._retries += 1
        self.get_logger().warning(f"Docking failed, will retry: {reason}")
        self._enter(RETRY)
        self._tell()
        self._enter(STAGING)

    def _leave(self):
        _, dock = self._docked_at or ("", self.robot.base.pose)
        if self._drive_to(dock.moved(-BEFORE_M, 0.0), backwards=True):
            self._docked_at = None
            self._end("succeed")

    def _drive_to(self, goal, backwards=False):
        """Command a step towards a pose, ahead or backwards; return whether it is reached."""
        pose = self.robot.base.pose
        away = math.dist((pose.x, pose.y), (goal.x, goal.y))
        ahead = (goal.x - pose.x) * math.cos(pose.yaw) + (goal.y - pose.y) * math.sin(pose.yaw)
        command = Twist()
        if away < NEAR_M or (backwards and ahead > -NEAR_M) or (not backwards and ahead < NEAR_M):
            self._commands.publish(command)
            return True
        bearing = math.atan2(goal.y - pose.y, goal.x - pose.x) + (math.pi if backwards else 0.0)
        off = wrapped((goal.yaw if away < 0.15 else bearing) - pose.yaw)
        command.angular.z = max(-TURNING, min(TURNING, 2.0 * off))
        command.linear.x = (-SPEED if backwards else SPEED) if abs(off) < 0.3 else 0.0
        self._commands.publish(command)
        return False

    def _tell(self):
        if self._handle is None:
            return
        spent = Duration(sec=int(self.robot.now - self._began_at))
        feedback = self._actions.DockRobot.Feedback(state=self._state, docking_time=spent, num_retries=self._retries)
        self._handle.publish_feedback(feedback)

    def _cancel(self):
        """Cancel the navigator's goal, and stop."""
        self._commands.publish(Twist())
        if self._driven is not None and not self._driven.done():
            if not self._is_cancelling:
                self._is_cancelling = True
                self._sent.result().cancel_goal_async()
        elif not self.robot.is_moving():
            self._end("canceled")

    def _end(self, how, code=0, reason=""):
        handle, self._handle = self._handle, None
        self._commands.publish(Twist())
        is_docking = isinstance(handle.request, self._actions.DockRobot.Goal)
        made = self._actions.DockRobot if is_docking else self._actions.UndockRobot
        result = made.Result(success=how == "succeed", error_code=code, error_msg=reason)
        if is_docking:
            result.num_retries = self._retries
        getattr(handle, how)()
        (self._docking if is_docking else self._undocking).finish(handle, result)
