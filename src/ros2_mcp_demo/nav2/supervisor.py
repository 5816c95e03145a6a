"""Nav2's lifecycle manager: brings up its nodes in order, and takes all of them down when one is lost."""

# pyright: basic
from __future__ import annotations

from contextlib import suppress

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import Trigger

from ..nodes.part import RobotPart
from .servers import declare

BOND_S = 4.0
STARTUP, PAUSE, RESUME, RESET, SHUTDOWN = range(5)


class Supervisor(RobotPart):
    """A lifecycle manager; `servers` are its nodes, in the order of the bring-up."""

    def __init__(self, name, robot, namespace, servers, service):
        super().__init__(name, robot, namespace)
        self.servers = list(servers)
        self._names = {server: server.get_name() for server in self.servers}
        declare(self, {"node_names": list(self._names.values()), "autostart": True, "bond_timeout": BOND_S})
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.is_up = False
        self._missed_at = None
        self.create_service(Trigger, f"{name}/is_active", self._is_active)
        self.create_service(service, f"{name}/manage_nodes", self._manage)

    def tick(self, stamp):
        """Check the heartbeats of all nodes, and publish diagnostics once a second."""
        lost = [one for one in self.servers if getattr(one, "is_gone", False) or one.starved]
        if self.is_up and lost:
            self._missed_at = self._missed_at or self.robot.now
            if self.robot.now - self._missed_at >= self.setting("bond_timeout"):
                self._take_down(lost[0])
        else:
            self._missed_at = None
        if self.is_due(1.0):
            said = f"Managed nodes are {'active' if self.is_up else 'inactive'}"
            status = DiagnosticStatus(level=DiagnosticStatus.OK, name=f"{self.get_name()}: Nav2 Health", message=said)
            message = DiagnosticArray(status=[status])
            message.header.stamp = stamp
            self._diagnostics.publish(message)

    def bring_up(self):
        """Configure all nodes, then activate all; stop at the first failure. Return whether all are active."""
        missing = [name for name in self.setting("node_names") if name not in self._names.values()]
        if missing:
            self.get_logger().info(f"Waiting for service {missing[0]}/get_state...")
            return False
        for step in ("trigger_configure", "trigger_activate"):
            for server in self.servers:
                if getattr(server, "is_gone", False):
                    return False
                with suppress(RuntimeError):  # already configured or active
                    getattr(server, step)()
                if server.fails:
                    self.get_logger().error(f"Failed to change state for node: {self._names[server]}")
                    self.get_logger().error("Failed to bring up all requested nodes. Aborting bringup.")
                    return False
        self.is_up = True
        self.get_logger().info("Managed nodes are active")
        return True

    def pause(self):
        """Deactivate all nodes."""
        self._all_down("trigger_deactivate")
        self.get_logger().info("Managed nodes have been paused")

    def reset(self):
        """Deactivate and clean up all nodes."""
        self._all_down("trigger_deactivate")
        self._all_down("trigger_cleanup")

    def _take_down(self, lost):
        text = f"SERVER {self._names[lost]} IS DOWN after not receiving a heartbeat for {BOND_S * 1000:.0f} ms"
        self.get_logger().error(f"CRITICAL FAILURE: {text}. Shutting down related nodes.")
        self.reset()

    def _all_down(self, step):
        self.is_up = False
        for server in reversed(self.servers):
            if not getattr(server, "is_gone", False):
                with suppress(RuntimeError):  # already down
                    getattr(server, step)()

    def _is_active(self, _, response):
        response.success = self.is_up
        return response

    def _manage(self, request, response):
        response.success = True
        if request.command in (STARTUP, RESUME):
            response.success = self.bring_up()
        elif request.command == PAUSE:
            self.pause()
        else:
            self.reset()
        return response
