"""/simulator: places obstacles in the world, which only a simulation can do."""

# pyright: basic
from __future__ import annotations

from .. import optional
from .part import RobotPart


class Simulator(RobotPart):
    """Serves /spawn_obstacle."""

    def __init__(self, robot, namespace):
        super().__init__("simulator", robot, namespace)
        self._spawned = 0
        self.create_service(optional.demo_services.SpawnObstacle, "spawn_obstacle", self._spawn)

    def _spawn(self, request, response):
        name = request.name or f"obstacle {self._spawned + 1}"
        reason = self.robot.spawn(name, request.x, request.y, request.radius)
        response.success = reason is None
        if reason is None:
            self._spawned += 1
            response.message = f"{name} stands at ({request.x:g}, {request.y:g})"
        else:
            response.message = f"not placed: {reason}"
        return response
