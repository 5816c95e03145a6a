"""/health: publishes the diagnoses of all nodes and a heartbeat; its self test always fails."""

# pyright: basic
from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import String
from std_srvs.srv import Trigger

from .part import RobotPart


class Health(RobotPart):
    """Publishes /diagnostics and /heartbeat once a second."""

    def __init__(self, robot, namespace, parts):
        super().__init__("health", robot, namespace)
        self._parts = list(parts)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._heartbeat = self.create_publisher(String, "heartbeat", 10)
        self._levels = {}
        self.create_service(Trigger, "self_test", self._self_test)

    def watch(self, parts):
        """Include these nodes, too."""
        self._parts += parts

    def tick(self, stamp):
        """Publish when it is due."""
        if not self.is_due(1.0):
            return
        message = DiagnosticArray(status=[*filter(None, map(self._status, self._parts))])
        message.header.stamp = stamp
        self._diagnostics.publish(message)
        self._heartbeat.publish(String(data=self.robot.heartbeat()))

    def _status(self, part):
        """Return a node's diagnosis as a status, or None; changes of its level are logged."""
        diagnosis = part.diagnosis()
        if diagnosis is None:
            return None
        level, text, values = diagnosis
        name = part.get_name()
        if self._levels.get(name, DiagnosticStatus.OK) != level:
            if level == DiagnosticStatus.OK:  # rclpy: a line of code that logs must always log at the same level
                part.get_logger().info(text)
            else:
                part.get_logger().warning(text)
        self._levels[name] = level
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        about = {"name": f"{name}: status", "hardware_id": "ros2_mcp_demo"}
        return DiagnosticStatus(level=level, message=text, values=pairs, **about)

    def _self_test(self, _, response):
        response.success = False
        response.message = "self test failed: the wheel encoders were last calibrated 412 days ago (limit 365)"
        return response
