"""/echo_server: the service /slow_echo, which answers after a delay without blocking anything."""

# pyright: basic
from __future__ import annotations

import math
import time

from rclpy.parameter import Parameter

from .. import optional
from .part import RobotPart, never_called

LONGEST_DELAY_S = 600.0
MOST_WAITING = 100


class EchoServer(RobotPart):
    """Not on an executor: `tick` takes requests, and answers each when its delay is over.

    Without an executor a node serves nothing else, so it has no other services.
    """

    needs_executor = False

    def __init__(self, robot, namespace):
        quiet = Parameter("start_type_description_service", value=False)
        super().__init__("echo_server", robot, namespace, start_parameter_services=False, parameter_overrides=[quiet])
        self._type = optional.demo_services.SlowEcho
        self._service = self.create_service(self._type, "slow_echo", never_called)
        self._waiting = []

    def tick(self, stamp):  # noqa: ARG002
        """Take new requests, and answer those that are due."""
        while self._take():
            pass
        now = time.monotonic()
        for entry in [entry for entry in self._waiting if entry[0] <= now]:
            self._waiting.remove(entry)
            _, arrived, request, header = entry
            self._service.send_response(self._type.Response(text=request.text, elapsed=now - arrived), header)

    def _take(self):
        if len(self._waiting) >= MOST_WAITING:
            return False
        with self._service.handle:
            request, header = self._service.handle.service_take_request(self._type.Request)
        if header is None:
            return False
        delay = request.delay if math.isfinite(request.delay) else 0.0
        arrived = time.monotonic()
        self._waiting.append((arrived + max(0.0, min(delay, LONGEST_DELAY_S)), arrived, request, header))
        return True
