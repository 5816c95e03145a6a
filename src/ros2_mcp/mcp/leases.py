"""Client leases: when a client over HTTP has gone, the motion that it commanded is stopped.

A client that closes an open response has gone, unless it has another one open. A client whose network fails sends
nothing: its lease ends 2 s after its last sign of life, which is a request, or an open response whose bytes it
acknowledges (`mcp/transports/http/presence.py`). stdio needs no lease: the end of the stream is enough.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import Awaitable, Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol

import anyio
from anyio.abc import TaskGroup
from mcp.server.context import CallNext, ServerRequestContext
from mcp.shared.message import ServerMessageMetadata
from mcp.types import EmptyResult, PingRequest
from mcp_types.version import HANDSHAKE_PROTOCOL_VERSIONS
from starlette.requests import Request

from ros2_mcp.guard.tokens import Login
from ros2_mcp.mcp.scopes import login_of
from ros2_mcp.model.commands import LOCAL, Principal
from ros2_mcp.ops.topics.publish import Repetition
from ros2_mcp.robot import Robot
from ros2_mcp.robot.stops import Accepted, Stops

if TYPE_CHECKING:
    from starlette.types import Scope

CLIENT_LEASE_S = 2.0
"""The longest time without a sign of life. TCP repeats a lost packet after 0.2 s, then 0.4 s: four signs may be lost on
a bad wireless network before a robot is stopped. At walking pace the robot has then moved 2 m at most.
"""
UNRENEWED_REPEAT_S = 10.0
"""How long a repeat of motion lasts without a request or an answered ping. The kernel acknowledges even if the client
process hangs or is stopped, so an open response is no proof that the client works.
"""
ALIVE_S = 0.5
"""Time between two comments on an open event stream while its client moves something: four in a lease."""
PING_S = 2.0
"""Time between two pings: four may go unanswered before a repeat is ended."""
_LOOK_S = 0.05
"""Time between two checks of the leases, and so the delay with which the end of a lease may be noticed. A zero may take
0.3 s in total.
"""
_LATE_S = 0.5
"""A check that is late by more than this shows that this process did not run, so that it may have missed signs of life.
"""
_CLOSED = "The client closed the response before its result was sent."
_GONE = "the end of its client, which closed its last open response"
_UNHEARD = f"the client lease: nothing was received from its client for {CLIENT_LEASE_S:g} s"
RESPONSE = "ros2_mcp.response"
"""The key of the `OpenResponse` in a request's ASGI scope."""
_ACCEPTED = "ros2_mcp.accepted"
"""The key in a request's ASGI scope for the stop epochs at which all of the request had arrived."""

Context = ServerRequestContext[Any, Any]
_logger = logging.getLogger(__name__)


class OpenResponse(Protocol):
    """The response to one HTTP request, from the arrival of the request on.

    `listens`: the response carries the server's unsolicited messages; a client that closes it has gone.
    """

    listens: bool

    @property
    def is_open(self) -> bool:
        """Whether the response is neither complete nor closed."""
        ...

    @property
    def was_closed(self) -> bool:
        """Whether the client has closed the response before it was complete."""
        ...

    def heard_at(self) -> float:
        """Return when the client last acknowledged or sent anything (monotonic clock, s): the current time if unknown;
        0 if the client has closed the connection, which `closed` reports shortly after.
        """
        ...

    async def show_alive(self) -> None:
        """Send a comment without content, so that the client has something to acknowledge."""
        ...


class Connected(OpenResponse, Protocol):
    """A client with a connection of its own. The connection carries all its requests and their answers."""

    principal: Principal


@dataclass(eq=False)
class Call:
    """One running call of a tool, and the response that carries its result. `acts`: the tool can change, move or stop
    something. `about` is the name of the robot that the call names, or "".
    """

    scope: anyio.CancelScope
    response: OpenResponse | None = None
    ping: Callable[[], Awaitable[object]] | None = None
    acts: bool = False
    about: str = ""
    pinged_at: float = 0.0
    end_reason: str = ""

    def end(self, reason: str) -> None:
        """Cancel the call: its result is no longer awaited."""
        self.end_reason = self.end_reason or reason
        self.scope.cancel()


@dataclass(eq=False)
class Client:
    """One client over HTTP. Times are on the monotonic clock, in s.

    `has_gone` is set when the end of its motion begins, and reset by its next request, so that the motion is ended
    once. `ends_for` holds, for each robot on which its motion is being ended, the reasons that are still to be carried
    out. `has_closed`: it has closed a response in a way that shows that it has gone, and has sent no request since.
    """

    principal: Principal
    asked_at: float
    granted_at: float = 0.0
    """When the client began to move something: its lease lasts at least `CLIENT_LEASE_S` from then on."""
    credited_until: float = 0.0
    """The lease does not end before this time; set when this process was late."""
    credited_at: float = 0.0
    """The last sign of life before the present silence; `credit_s` is the credit that is left for it."""
    credit_s: float = CLIENT_LEASE_S
    shown_alive_at: float = 0.0
    responses: set[OpenResponse] = field(default_factory=set[OpenResponse])
    calls: set[Call] = field(default_factory=set[Call])
    ends_for: dict[Robot, list[str]] = field(default_factory=dict[Robot, list[str]])
    is_moving: bool = False
    has_closed: bool = False
    has_failed: bool = False
    has_gone: bool = False

    def heard_at(self) -> float:
        """Return the time of the client's last sign of life."""
        return max(self.asked_at, self.granted_at, *(response.heard_at() for response in self.responses))

    def lease_ends_at(self) -> float:
        """Return when the client's lease ends, unless there is another sign of life."""
        return max(self.heard_at() + CLIENT_LEASE_S, self.credited_until)

    def credit(self, late_s: float, now: float) -> None:
        """Extend the lease by the time that this process was late, but in one silence of the client by at most
        one lease.
        """
        if (heard_at := self.heard_at()) > self.credited_at + _LOOK_S:  # the kernel's ms make it vary
            self.credited_at, self.credit_s = heard_at, CLIENT_LEASE_S
        if (credit_s := min(late_s, self.credit_s)) > 0:
            self.credit_s -= credit_s
            ends_at = self.lease_ends_at()
            self.credited_until = max(ends_at + credit_s, min(ends_at + late_s, now + credit_s))


class Leases:
    """The clients over HTTP that were active lately. Ends the motion of those that have gone."""

    def __init__(self, *robots: Robot) -> None:
        self._robots = robots
        self._clients: dict[Principal, Client] = {}
        self._asked = asyncio.Event()
        self._tasks: TaskGroup | None = None

    async def keep(self) -> None:
        """Watch the leases until cancelled. Sleeps while no client sends requests or moves anything."""
        async with anyio.create_task_group() as self._tasks:
            while True:
                await self._asked.wait()
                self._asked.clear()
                looked_at = monotonic()
                while self._look(looked_at):
                    looked_at = monotonic()
                    await anyio.sleep(_LOOK_S)

    def calls_under_way(self, about: str) -> int:
        """Return how many calls about that robot are running; with "", how many that name no robot."""
        return sum(call.about == about for client in self._clients.values() for call in client.calls)

    # ── signs of life ──────────────────────────────────────────────────────────────────────────────────────────

    async def note(self, ctx: Context, call_next: CallNext) -> Any:
        """Record each request, and who sent it. A middleware of the server."""
        if (principal := principal_of(ctx)) != LOCAL:
            response = _response_of(ctx)
            if response and ctx.method == "subscriptions/listen":
                response.listens = True
            self.asked(principal, response)
        return await call_next(ctx)

    def received(self, scope: Scope) -> None:
        """Record that all of a request has arrived: a stop that comes from now on is later than it, even if the request
        has not been parsed yet.
        """
        scope[_ACCEPTED] = {robot.stops: robot.stops.now() for robot in self._robots}

    def asked(self, principal: Principal, response: OpenResponse | None = None) -> None:
        """Record a request of a client, and the open response to the request; the request renews the client's lease.

        A request whose response the client has already closed is no sign of life.
        """
        if response and response.was_closed:
            return
        client = self._clients.setdefault(principal, Client(principal, monotonic()))
        client.asked_at, client.has_gone, client.has_closed = monotonic(), False, False
        if response and response.is_open:
            client.responses.add(response)
        self._asked.set()

    def finished(self, response: OpenResponse) -> None:
        """Record that a response is complete."""
        for client in self._clients.values():
            client.responses.discard(response)

    def closed(self, response: OpenResponse) -> None:
        """Record that a client has closed a response: end its call, and all that the client moves if it has no other
        open response.

        A client that closes the response to a call that only reads cancels that call, and has not gone.
        """
        for client in [client for client in self._clients.values() if response in client.responses]:
            client.responses.discard(response)
            calls = [call for call in client.calls if call.response is response]
            for call in calls:
                call.end(_CLOSED)
            self._note_close(client, shows_going=response.listens or any(call.acts for call in calls))

    def _note_close(self, client: Client, *, shows_going: bool) -> None:
        client.has_closed = client.has_closed or shows_going
        if client.has_closed and not client.responses:
            self._begin_end(client, _GONE)

    def left(self, principal: Principal) -> None:
        """Record that a client has ended its session."""
        if client := self._clients.get(principal):
            self._begin_end(client, "the end of its client, which ended its session")

    @contextmanager
    def attended(self, context: Context, *, acts: bool, about: str = "") -> Generator[Call]:
        """Run the block as a call of a client. The call is cancelled, with a reason, when that client has gone.

        If its response was closed before, it is cancelled from the beginning.
        """
        with anyio.CancelScope() as scope:
            principal = principal_of(context)
            if principal == LOCAL:
                yield Call(scope)
                return
            call = Call(scope, _response_of(context), _ping(context), acts, about)
            client = self._clients.setdefault(principal, Client(principal, monotonic()))
            client.calls.add(call)
            if call.response and call.response.was_closed:
                call.end(_CLOSED)
                self._note_close(client, shows_going=acts)
            try:
                yield call
            finally:
                client.calls.discard(call)

    # ── watching the leases ────────────────────────────────────────────────────────────────────────────────────

    def _look(self, looked_at: float) -> bool:
        """End what has to end. Return whether there is anything left to watch."""
        now = monotonic()
        late_s = now - looked_at - _LOOK_S
        for client in list(self._clients.values()):
            try:
                self._look_at(client, late_s, now)
            except Exception:  # an error caused by one client must not end the watch over the others, nor the server
                if not client.has_failed:  # logged once, not 20 times a second
                    _logger.exception("the watch over %s failed", client.principal.name)
                client.has_failed = True
        return any(
            client.is_moving or client.calls or client.asked_at + CLIENT_LEASE_S > now
            for client in self._clients.values()
        )

    def _look_at(self, client: Client, late_s: float, now: float) -> None:
        was_moving, client.is_moving = client.is_moving, self._is_moving(client)
        if late_s > _LATE_S:
            client.credit(late_s, now)
        if client.is_moving and not was_moving:
            client.granted_at = client.shown_alive_at = now
        # If its motion is being ended on all robots, there is nothing more to end; with a robot that is away, that
        # takes time.
        if client.is_moving and len(client.ends_for) < len(self._robots):
            self._watch(client, now)
        elif not client.calls and not client.responses and now > client.lease_ends_at():
            del self._clients[client.principal]

    def _is_moving(self, client: Client) -> bool:
        """Return whether the client may move something, or has a running call that may: a call that waits may move
        something later.
        """
        if client.has_gone:
            return False
        return any(call.acts for call in client.calls) or any(
            robot.moves_for(client.principal) for robot in self._robots
        )

    def _watch(self, client: Client, now: float) -> None:
        assert self._tasks
        if now > client.lease_ends_at():
            has_closed = client.has_closed or any(not response.heard_at() for response in client.responses)
            self._begin_end(client, _GONE if has_closed else _UNHEARD)
            return
        if now - client.shown_alive_at >= ALIVE_S:
            client.shown_alive_at = now
            for response in client.responses:
                self._tasks.start_soon(_attempt, response.show_alive)
        repeats = [
            job
            for robot in self._robots
            for job in robot.jobs.running(Repetition)
            if job.owner == client.principal and job.is_motion
        ]
        for call in client.calls if repeats else ():
            if call.ping and now - call.pinged_at >= PING_S:
                call.pinged_at = now
                self._tasks.start_soon(_attempt, call.ping)
        for repeat in repeats:
            unrenewed_s = min(now - client.asked_at, repeat.elapsed_s)
            if unrenewed_s > UNRENEWED_REPEAT_S and not repeat.is_stopping:
                self._tasks.start_soon(_end_repeat, repeat)

    def _begin_end(self, client: Client, reason: str) -> None:
        """End the motion of a client that has gone. Done once, until its next request."""
        if not self._tasks or client.has_gone:
            return
        client.has_gone = True
        for robot in self._robots:
            is_ending = robot in client.ends_for
            client.ends_for.setdefault(robot, []).append(reason)
            if not is_ending:
                self._tasks.start_soon(self._end, client, robot)

    async def _end(self, client: Client, robot: Robot) -> None:
        """End the calls of a client that has gone, and what it moves on one robot; repeat that if it goes again
        meanwhile.
        """
        reasons = client.ends_for[robot]
        try:
            while reasons:
                reason = reasons.pop()
                for call in client.calls:
                    call.end(f"This call was ended and its motion stopped by {reason}.")
                if ended := await robot.stop_owned(client.principal, reason):
                    _logger.warning("%s: ended by %s: %s", client.principal.name, reason, ", ".join(ended))
        except Exception:  # an error with one client must not end the watch over the others
            _logger.exception("what %s moves was not ended in good order", client.principal.name)
        finally:
            del client.ends_for[robot]


def _response_of(context: Context) -> OpenResponse | None:
    request: Request[Any] | None = context.request
    return _connected(context) or (request.scope.get(RESPONSE) if request else None)


def _connected(context: Context) -> Connected | None:
    """Return the client with a connection of its own from which the request came; None for other transports."""
    return context.request if hasattr(context.request, "principal") else None


async def _end_repeat(repeat: Repetition) -> None:
    try:
        await repeat.stop_for(
            f"the server: over HTTP a repeat of motion lasts at most {UNRENEWED_REPEAT_S:g} s unless its client "
            "sends a request or answers a ping meanwhile, and this client did neither"
        )
    except Exception as error:  # noqa: BLE001 - whatever keeps one from ending must not end the watch over others
        _logger.warning("%s did not end in good order: %s", repeat.id, error)


def _ping(context: Context) -> Callable[[], Awaitable[object]] | None:
    """Return a function that sends a ping on the response of a call; None in the modern era, in which servers send no
    requests.
    """
    session = context.session
    if not session.can_send_request:
        return None

    async def ping() -> None:  # the client's answer is a request, which renews the lease
        on_this_response = ServerMessageMetadata(related_request_id=context.request_id)
        await session.send_request(PingRequest(), EmptyResult, UNRENEWED_REPEAT_S, on_this_response)

    return ping


async def _attempt(sign: Callable[[], Awaitable[object]]) -> None:
    """Send a comment or a ping. A failure is only logged: the missing sign of life has its own effect."""
    try:
        await sign()
    except Exception as error:  # noqa: BLE001 - whatever a dying connection raises must not end the watch over others
        _logger.debug("a sign of life was not sent: %r", error)


# ── principals ───────────────────────────────────────────────────────────────────────────────────────────────────


def principal_of(context: Context) -> Principal:
    """Return the sender of a request: the one client of stdio, a session over HTTP, or a program by its name and
    address.

    HTTP requests of the modern era belong to no session. Their clients are distinguished by token, address and program
    name: two clients with the same program on one machine are the same principal.
    """
    if connected := _connected(context):
        return connected.principal
    request: Request[Any] | None = context.request
    if request is None:
        return LOCAL
    login = login_of(request)
    if session := session_of(request):
        return principal_of_session(session, login)
    params = context.session.client_params
    program = f"{params.client_info.name} {params.client_info.version}" if params else ""
    return _named(f"{request.client.host if request.client else ''} {program}", login)


def accepted_at(context: Context, robot: Robot) -> Accepted | None:
    """Return when an HTTP request had arrived, in the stop epochs of that robot; None if it was not recorded."""
    request: Request[Any] | None = context.request
    noted: Mapping[Stops, Accepted] = {} if request is None or _connected(context) else request.scope.get(_ACCEPTED, {})
    return noted.get(robot.stops)


def session_of(request: Request[Any]) -> str:
    """Return the session id in a request; "" if there is none."""
    version = request.headers.get("mcp-protocol-version")
    is_modern = version is not None and version not in HANDSHAKE_PROTOCOL_VERSIONS  # the modern era has no sessions
    return "" if is_modern else request.headers.get("mcp-session-id", "")


def principal_of_session(session: str, login: Login | None = None) -> Principal:
    """Return the principal of a session. Its name contains a hash of the session id, because the id is a secret."""
    return _named(f"session {session}", login)


def _named(text: str, login: Login | None) -> Principal:
    digest, who = hashlib.sha256(text.encode()).hexdigest()[:8], login.name if login else ""
    return Principal(name=f"{who or 'http'}_{digest}", transport="http", login=who)
