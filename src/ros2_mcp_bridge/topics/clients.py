"""Service calls: serialized request in, serialized response out, many at once."""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from rclpy.qos import QoSProfile, QoSReliabilityPolicy

from ros2_mcp_bridge.exit.failsafes import FailSafes, Motion, begun_by, ended_by
from ros2_mcp_bridge.exit.lifeline import Lifeline
from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.exit.speed_limit import SpeedLimits
from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import interfaces, rcl
from ros2_mcp_bridge.topics.pace import Pace
from ros2_mcp_bridge.topics.pool import Pool
from ros2_mcp_common.policy import stamps
from ros2_mcp_common.policy.flight import SET_MODE, brakes
from ros2_mcp_common.policy.verbs import CANCEL_GOAL, READING_TYPES
from ros2_mcp_common.wire import protocol
from ros2_mcp_common.wire.protocol import CallReply

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.node import Node
    from rclpy.task import Future

# The polling period of a call: an answer wakes its request, this only detects that the server has gone or time is up.
POLL_S = 0.1
# The polling period while a server is awaited: rclpy does not report that it appears.
APPEARS_POLL_S = 0.005
# A server that has just started drops its answer if it has not discovered our client yet. If it was there at once, or
# came within JUST_STARTED_S, it has had time to discover the client; otherwise it is given KNOWS_US_S.
JUST_STARTED_S = 0.3
KNOWS_US_S = 0.5
# Fast DDS drops an answer if the server has not discovered our reader 0.1 s after the request came. Discovery repairs
# its own losses within 3 s. Then a request that changes nothing is sent once more, unless the server has answered
# before.
ASKS_AGAIN_S = 3.0
# The longest wait for the answer to a request to cancel the goals of others.
CANCELLED_S = 1.0
# Discovery can lose a server for a short time; a server missing for longer than this is gone.
GONE_AFTER_S = 0.3
# The default depth of 10 loses responses if more arrive at the same moment.
MANY_AT_ONCE = QoSProfile(depth=500, reliability=QoSReliabilityPolicy.RELIABLE)

ServiceKey = tuple[str, str]


class Clients:
    """Pooled clients of services, including the services of actions."""

    def __init__(
        self, node: Node, failsafes: FailSafes, limiter: Limiter, lifeline: Lifeline, speed_limits: SpeedLimits
    ) -> None:
        self._node = node
        self._lifeline = lifeline
        self._failsafes = failsafes
        self._limiter = limiter
        self._speed_limits = speed_limits
        self.pool: Pool[ServiceKey, Client] = Pool(node.destroy_client)
        self._awaited: dict[Future, tuple[Request, Pace]] = {}
        self._paces: WeakKeyDictionary[Client, Pace] = WeakKeyDictionary()

    def call(self, request: Request) -> Steps[tuple[CallReply, bytes]]:
        """Return steps that send a request and wait for its response."""
        return self.answered(request, request.number("timeout_s"))

    def answered(self, request: Request, timeout_s: float) -> Steps[tuple[CallReply, bytes]]:
        """Steps that send a request, and wait for its response, at most `timeout_s` seconds.

        Raises:
            OperationError: of kind `not_found`, `timeout` or `server_gone`, if there is no response.
            Cancelled: if the request must not act any more.
        """
        service, wait_s = request.text("service"), request.number("wait_s", 0.0)
        started = time.monotonic()
        latest = started + request.number("within_s", wait_s + timeout_s)
        with self._use(request) as (client, message):
            yield from _wait_server(client, service, wait_s, latest)
            yield from self._speed_limits.tell(request)
            pace = self._paces.setdefault(client, Pace())
            yield from pace.wait_turn(request, latest)
            sent_at = time.monotonic()
            if sent_at >= latest:
                too_late = f"The server of {service} appeared too late: nothing was sent."
                raise OperationError("timeout", too_late, "Try again: it is there now.")
            request.leave()
            futures: list[Future] = []

            def send() -> None:
                futures.append(self._send(client, request, message))
                self._awaited[futures[-1]] = request, pace

            again_at, deadline = sent_at + ASKS_AGAIN_S, min(sent_at + timeout_s, latest)
            may_be_lost = request.text("type") in READING_TYPES and not pace.has_answered and again_at < deadline
            try:
                send()
                if may_be_lost and not (yield from _wait_response(client, service, futures, again_at)):
                    send()
                if not (yield from _wait_response(client, service, futures, deadline)):
                    raise OperationError("timeout", f"{service} did not answer within {timeout_s:g} s.")
                body = rcl.serialize(next(future for future in futures if future.done()).result())
            finally:
                for future in futures:
                    self._awaited.pop(future, None)
                    client.remove_pending_request(future)
        elapsed_s = round(time.monotonic() - sent_at, 6)
        return {"waited_s": round(sent_at - started, 6), "elapsed_s": elapsed_s}, body

    def cancel_all(self, action: str) -> Steps[None]:
        """Steps that ask the server of an action to cancel all of its goals."""
        head = {"op": "call", "service": f"{action}/_action/cancel_goal", "type": CANCEL_GOAL}
        interface = interfaces.load(CANCEL_GOAL)
        request = Request(head, rcl.serialize(interface.Request()))  # no goal and no time stand for all goals
        request.interface = interface
        yield from self.answered(request, CANCELLED_S)

    def look(self) -> None:
        """Wake the requests whose answers have come.

        Called after each turn, because rclpy's callbacks take two turns more.
        """
        for future in [future for future in self._awaited if future.done()]:
            request, pace = self._awaited.pop(future)
            pace.answered(request)
            request.wake()

    def unserved(self) -> set[ServiceKey]:
        """Return the services, as (name, type), of which this bridge has a client but that have no server."""
        return {key for key, client in self.pool.entities().items() if not client.service_is_ready()}

    def failsafe(self, request: Request) -> Steps[protocol.Cancelled]:
        """Steps that keep a fail-safe in force: a request that cancels a goal, or stops a vehicle, is sent at the end.

        It is sent when the server is gone, if the service is available, unless this request is cancelled before. If
        this process and the server die together, a stopper sends it. No other kind of request is accepted, because it
        is sent even while the latch is set.
        """
        with self._use(request) as (client, message):
            service, type_name = request.text("service"), request.text("type")
            ends = ended_by(service, type_name, message)
            if ends is None:
                problem = f"{service} neither cancels goals nor stops a vehicle, so it cannot be a fail-safe."
                raise OperationError("bad_request", problem)

            def call_if_ready() -> Future | None:
                return self._send(client, request, message) if client.service_is_ready() else None

            with self._lifeline.leaving(service, type_name, request.body):
                return (yield from self._failsafes.until_cancelled(request, call_if_ready, ends))

    def _send(self, client: Client, request: Request, message: Any) -> Future:
        """Send a request; the exit of requests.

        Raises:
            OperationError: if the policy refuses it, or if it would start a motion without a fail-safe that ends it.
        """
        motion = begun_by(request.text("service"), request.text("type"), message)
        if motion and _can_be_ended(motion):
            self._failsafes.check_held(motion)
        self._limiter.check_call(request, message, leaves=True)
        return client.call_async(message)

    @contextmanager
    def _use(self, request: Request) -> Generator[tuple[Client, Any], None, None]:
        """A context manager that gives the pooled client of the service that a request
        names, and the message to send.
        """
        service, type_name = request.text("service"), request.text("type")
        try:
            message = rcl.deserialize(request.body, request.interface.Request)
        except Exception as error:  # the middlewares raise errors of many kinds
            problem = f"{request.op}: the body is not a request of {type_name}: {error}"
            raise OperationError("bad_request", problem) from error
        if request.flag("brakes") and not brakes(service, type_name, message):
            raise OperationError("bad_request", f"This request to {service} does not stop a vehicle: it is an order.")
        stamps.zero(message)  # in any case, a trajectory begins when it arrives
        self._limiter.check_call(request, message, leaves=False)  # before anything is created, or waited for
        create = partial(rcl.client, self._node, request.interface, service, MANY_AT_ONCE)
        with self.pool.use((service, type_name), create) as (client, _):
            yield client, message


def _can_be_ended(motion: Motion) -> bool:
    """Return whether a fail-safe for this motion is possible: without SetMode installed, no request stops a vehicle."""
    if motion.goal_id:
        return True
    try:
        interfaces.load(SET_MODE)
    except OperationError:
        return False
    return True


def _wait_server(client: Client, service: str, wait_s: float, latest: float) -> Steps[None]:
    started = time.monotonic()
    deadline = started + wait_s
    while not client.service_is_ready():
        if time.monotonic() >= deadline:
            raise OperationError("not_found", f"No server of {service} appeared within {wait_s:g} s.")
        yield APPEARS_POLL_S
    if time.monotonic() - started > JUST_STARTED_S:
        yield min(KNOWS_US_S, max(0.0, latest - time.monotonic()))


def _wait_response(client: Client, service: str, futures: Sequence[Future], until: float) -> Steps[bool]:
    """Steps that return whether one of the requests was answered before `until` (monotonic, s).

    Raises:
        OperationError: of kind `server_gone`, if the server disappears.
    """
    last_ready = time.monotonic()
    while not any(future.done() for future in futures):
        now = time.monotonic()
        if client.service_is_ready():
            last_ready = now
        if now - last_ready > GONE_AFTER_S:
            raise OperationError("server_gone", f"The server of {service} disappeared before it answered.")
        if now >= until:
            return False
        yield min(POLL_S, until - now)
    return True
