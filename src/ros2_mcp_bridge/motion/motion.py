"""Motion by feedback: a controller uses topics of the robot, and its velocities leave through the exit of all commands.

A controller is pure: it gets messages and the time, and returns what to command. So it is tested against simulated
physics without ROS. The runner subscribes, decodes, steps and publishes. A stop, the latch, the end of the link lease
and a cancelled request end it like a repeat, with the zero.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, cast

from ros2_mcp_bridge.exit.lifeline import Guarded
from ros2_mcp_bridge.exit.velocities import Velocities
from ros2_mcp_bridge.motion.controller import Controller, Make, Velocity
from ros2_mcp_bridge.motion.watching import Ear
from ros2_mcp_bridge.request import Cancelled, OperationError, Request, Steps
from ros2_mcp_bridge.ros import rcl
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.topics.publishers import FINAL_ACK_S, Publisher
from ros2_mcp_common.policy.fields import put
from ros2_mcp_common.wire.protocol import MotionProgress, MotionReply

if TYPE_CHECKING:
    from rclpy.node import Node

# The period of looks, within which a condition or an obstacle is noticed: half of the 20 ms in which a motion has to
# react, and 1 % of a core.
LOOK_S = 0.01
# The shortest pause, before the moment at which a topic is late.
SOON_S = 0.001
# The longest wait for a first message on every topic: a publisher that missed our announcement is discovered with the
# next one, 3 s later (decision 13).
FIRST_HEARD_S = 5.0
# The period of progress events: as often as a person reads a new line.
TELL_EVERY_S = 0.5
# The path of the velocity in types with a header.
_INNER = {"geometry_msgs/msg/TwistStamped": "twist.", "ackermann_msgs/msg/AckermannDriveStamped": "drive."}
NOBODY = "This command input has no subscriber: nothing was sent."


class Motion:
    """One motion, from its first message to its end."""

    def __init__(self, request: Request, controller: Controller, ears: Sequence[tuple[str, Ear]]) -> None:
        self._request = request
        self._ears = ears
        self._prefix = _INNER.get(request.text("type"), "")
        self._period_s = 1.0 / request.rate()
        self._for_s = request.number("duration_s")
        self.controller = controller
        self.outcome = ""
        self.why = ""
        self.sent = 0
        self.limited = 0
        self.late = 0
        self.started = time.monotonic()

    def wait_heard(self) -> Steps[bool]:
        """Steps that wait until the controller has received what it needs; return whether it has."""
        deadline = time.monotonic() + FIRST_HEARD_S
        while True:
            self._hear()
            awaited = self.controller.awaits()
            if not awaited and not any(ear.is_settling for _, ear in self._ears):
                return True
            if time.monotonic() > deadline:
                self._end("silent", f"In {FIRST_HEARD_S:g} s {awaited}: nothing was sent.")
                return False
            yield LOOK_S

    def run(self, publisher: Publisher, tell: Callable[[], None]) -> Steps[None]:
        """Steps that publish the controller's velocities at the rate, until it ends.

        The first command that moves, and the zero after it, are sent at once.
        """
        if not publisher.matched():
            self._end("no_subscriber", NOBODY)
            return
        self.started = due = told_at = time.monotonic()
        moves = False
        while True:
            now = time.monotonic()
            self._hear()
            velocity = self.controller.step(now)
            if velocity is None:
                self._end(self.controller.outcome, self.controller.why)
                return
            if now - self.started > self._for_s:
                self._end("timeout", f"The duration of {self._for_s:g} s is over.")
                return
            if now >= due or moves != any(velocity.values()):
                self.late += int((now - due) / self._period_s) if now > due else 0
                due = max(due + self._period_s, now + self._period_s / 2)  # missed periods are not made up for
                moves = any(velocity.values())
                if not self._publish(publisher, velocity):
                    return
            if now - told_at >= TELL_EVERY_S:
                told_at = now
                tell()
            yield max(min(LOOK_S, self.controller.late_in_s(time.monotonic())), SOON_S)

    def destroy(self) -> None:
        """Destroy the subscriptions."""
        for _, ear in self._ears:
            ear.destroy()

    def _hear(self) -> None:
        for role, ear in self._ears:

            def take_in(message: Any, role: str = role, ear: Ear = ear) -> None:
                self.controller.hear(role, message, ear.received_at, ear.from_before_s)

            ear.hear(take_in)

    def _publish(self, publisher: Publisher, velocity: Velocity) -> bool:
        """Publish one command. Return False if the policy refuses it; if it refuses the first one, raise."""
        message = self._request.interface()
        if publisher.velocity is not None and publisher.velocity.is_stamped:
            message.header.frame_id = self._request.text("frame", default="")
        put(message, {f"{self._prefix}{name}": float(value) for name, value in velocity.items()})
        try:
            outgoing = publisher.outgoing(rcl.serialize(message), self._request)
            self.limited += publisher.publish(outgoing, self._request)
        except Cancelled:
            raise
        except OperationError as error:
            if not self.sent:
                raise
            self._end("refused", error.message)
            return False
        self.sent += 1
        return True

    def _end(self, outcome: str, why: str) -> None:
        self.outcome, self.why = outcome, why


class Motions:
    """Runs motions. `kinds` makes the controller of each kind.

    `use` gives the publisher of a request, and whether it was created for it.
    """

    def __init__(
        self,
        *,
        node: Node,
        graph: Graph,
        velocities: Velocities,
        use: Callable[[Request], AbstractContextManager[tuple[Publisher, bool]]],
        send_event: Callable[[MotionProgress], None],
        kinds: Mapping[str, Make],
    ) -> None:
        self._node = node
        self._graph = graph
        self._velocities = velocities
        self._use = use
        self._send_event = send_event
        self._kinds = kinds

    def move(self, request: Request) -> Steps[MotionReply]:
        """Steps that move the robot until the controller or something else ends the motion, and then send the zero."""
        motion, wait_match_s = self._made(request), request.number("wait_match_s", 0.0)
        name, ended_by, guarded = request.text("name"), "", Guarded()

        def tell() -> None:
            self._send_event({"event": "motion", "name": name, "report": dict(motion.controller.report())})

        try:
            with self._use(request) as (publisher, created):
                velocity = publisher.velocity
                if velocity is None:
                    problem = f"{request.text('type')} is not a velocity command: no command is known that stops it."
                    raise OperationError("bad_request", problem)
                velocity.check_driven()
                with self._velocities.hold(velocity, request):
                    try:
                        publisher.call_stopper()
                        yield from publisher.wait_match(created, wait_match_s)
                        yield from publisher.wait_clock()
                        if (yield from motion.wait_heard()):
                            guarded = yield from publisher.wait_stopper()
                            yield from motion.run(publisher, tell)
                    except Cancelled as cancelled:
                        ended_by = cancelled.ended_by
                    finally:
                        request.task = None  # it is ending, and cannot be cancelled any more
                        elapsed_s = round(time.monotonic() - motion.started, 6)
                        if motion.sent:
                            velocity.send_zero()
                    matched, ours = publisher.matched(), publisher.ours()
                    yield from publisher.wait_acknowledged(FINAL_ACK_S)
        finally:
            motion.destroy()
        return {
            "outcome": motion.outcome,
            "why": motion.why,
            "report": dict(motion.controller.report()),
            "sent": motion.sent,
            "matched": matched,
            "ours": ours,
            "elapsed_s": elapsed_s,
            "late": motion.late,
            "limited": motion.limited,
            "final_sent": bool(motion.sent),
            "ended_by": ended_by,
            "stopper_s": guarded.waited_s,
            "unguarded": guarded.problem,
        }

    def _made(self, request: Request) -> Motion:
        """Return the motion that the body of a request describes.

        Raise `OperationError` of kind `bad_request` if it is wrong.
        """
        try:
            asked = cast("Mapping[str, Any]", json.loads(request.body))
            controller = self._kinds[asked["kind"]](asked)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise OperationError("bad_request", f"This motion cannot be read: {error!r}") from error
        ears = [(feed.role, Ear(self._node, self._graph, feed)) for feed in controller.feeds]
        return Motion(request, controller, ears)
