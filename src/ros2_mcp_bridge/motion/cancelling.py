"""Cancelling a goal when a condition on its feedback, or on any topic, holds: evaluated in
the bridge, near the robot.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ros2_mcp_bridge.motion.asking import Asking
from ros2_mcp_bridge.motion.controller import Feed
from ros2_mcp_bridge.motion.motion import LOOK_S
from ros2_mcp_bridge.motion.watching import Ear
from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import interfaces
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.ros.message_types import MessageTypes
from ros2_mcp_bridge.topics.clients import Clients
from ros2_mcp_common.policy.verbs import meaning
from ros2_mcp_common.wire.protocol import CancelWhenReply, RepeatBegun

if TYPE_CHECKING:
    from rclpy.node import Node


class Cancelling:
    """Evaluates conditions for running goals; `send_event` reports to the server that an evaluation has begun."""

    def __init__(
        self, *, node: Node, graph: Graph, clients: Clients, send_event: Callable[[RepeatBegun], None]
    ) -> None:
        self._node = node
        self._graph = graph
        self._clients = clients
        self._send_event = send_event

    def cancel_when(self, request: Request) -> Steps[tuple[CancelWhenReply, bytes]]:
        """Steps that evaluate until the condition is met, then send the cancel request at
        once, and return its response.

        The server cancels this request when the goal ends.

        Raises:
            OperationError: of kind `bad_request`, if the service cancels no goals or the condition is wrong.
        """
        if meaning(request.text("service"), request.text("type")).verb != "cancel":
            raise OperationError("bad_request", f"{request.text('service')} cancels no goals.")
        feed = Feed("condition", request.text("topic"), request.text("topic_type"))
        try:
            asking = _asking(request)
        except ValueError as error:
            raise OperationError("bad_request", f"This condition cannot be asked here: {error}") from error

        def ask(message: Any) -> None:
            asking.ask(message, ear.from_before_s)

        ear, started = Ear(self._node, self._graph, feed), time.monotonic()
        try:
            ear.hear(ask)
            self._send_event(RepeatBegun(event="begun", name=request.text("name")))
            while not asking.is_met:
                yield LOOK_S
                ear.hear(ask)
        finally:
            ear.destroy()
        met_s = round(time.monotonic() - started, 6)
        _, body = yield from self._clients.answered(request, request.number("within_s"))
        return {"met_s": met_s, "report": dict(asking.report())}, body


def _asking(request: Request) -> Asking:
    """Return the condition of a request. With a `goal_id` it is evaluated only on the feedback of that goal."""
    message_class = interfaces.load(request.text("topic_type"))
    text, goal_id = request.text("condition"), request.text("goal_id", "")
    if not goal_id:
        types = MessageTypes(message_class)
        return Asking(types, types.name, text)
    types = MessageTypes(message_class().feedback.__class__)

    def feedback_of(message: Any) -> Any:
        return message.feedback if bytes(message.goal_id.uuid).hex() == goal_id else None

    return Asking(types, types.name, text, feedback_of)
