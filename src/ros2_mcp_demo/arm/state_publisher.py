"""/robot_state_publisher: publishes the arm's description and the transforms of its links."""

# pyright: basic
from __future__ import annotations

import math

from geometry_msgs.msg import Quaternion
from std_msgs.msg import String

from .. import optional
from ..nodes.convert import transform
from ..nodes.part import RobotPart
from .description import FIXED, JOINTS, description

RATE = 20.0


class StatePublisher(RobotPart):
    """Publishes /robot_description and /tf_static once, /tf continuously."""

    def __init__(self, robot, namespace):
        super().__init__("robot_state_publisher", robot, namespace)
        self._text = description(self.frame(""))
        self.declare_fact("robot_description", self._text, "The URDF")
        self._description = self.create_latched_publisher(String, "robot_description")
        message = optional.tf2_msgs and optional.tf2_msgs.TFMessage
        self._static = message and self.create_latched_publisher(message, "/tf_static")
        self._tf = message and self.create_publisher(message, "/tf", 100)
        self._published = False

    def tick(self, stamp):
        """Publish the fixed transforms on the first call, and the moving ones when they are due."""
        if not self._published:
            self._published = True
            self._description.publish(String(data=self._text))
            if self._static:
                fixed = [
                    transform(stamp, self.frame(parent), self.frame(child), *map(float, xyz))
                    for _, parent, child, xyz in FIXED
                ]
                self._static.publish(optional.tf2_msgs.TFMessage(transforms=fixed))
        if self._tf and self.is_due(RATE):
            self._tf.publish(optional.tf2_msgs.TFMessage(transforms=list(self._moving(stamp))))

    def _moving(self, stamp):
        names, positions, _ = self.robot.measured()
        at = dict(zip(names, positions))  # noqa: B905 (3.8)
        for joint in JOINTS:
            yield self._placed(stamp, joint, at[joint.name], joint.child, 1.0)
            if joint.kind == "prismatic":
                yield self._placed(stamp, joint, at[joint.name], "right_finger", -1.0)

    def _placed(self, stamp, joint, position, child, direction):
        axis = [direction * float(word) for word in joint.axis.split()]
        xyz = list(map(float, joint.xyz))
        if joint.kind == "prismatic":
            xyz = [at + position * along for at, along in zip(xyz, axis)]  # noqa: B905 (3.8)
            return transform(stamp, self.frame(joint.parent), self.frame(child), *xyz)
        message = transform(stamp, self.frame(joint.parent), self.frame(child), *xyz)
        sine = math.sin(position / 2)
        x, y, z = (sine * part for part in axis)
        message.transform.rotation = Quaternion(x=x, y=y, z=z, w=math.cos(position / 2))
        return message
