"""Client leases: what a client over HTTP keeps moving ends, with its zero, when that client has gone.

A client that closes an open response is gone at once, unless it has another one open. Of one whose network has gone
nothing is heard: its lease is over 2 s after its last sign of life, which is a request, or an open response whose
bytes it acknowledges (`mcp/transports/http/presence.py`). stdio needs no lease: the end of the stream is enough.
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
"""Without a sign of life. A lost packet is sent again within 0.2 s, then 0.4 s: four signs may fail on a bad wireless
network before a robot is stopped, and one at walking pace has gone 2 m at most."""
UNRENEWED_REPEAT_S = 10.0
"""How long a repeat of motion lasts without a request or an answered ping: the kernel of a client that is stopped or
hangs acknowledges for it, so that an open response does not show that anybody is there."""
ALIVE_S = 0.5
"""Between two comments on an open event stream while its client moves something: four of them in a lease."""
PING_S = 2.0
"""Between two pings: four may go unanswered before a repeat is ended."""
_LOOK_S = 0.05
"""Between two looks at the leases: how late the end of one may be noticed, of the 0.3 s that a zero may take."""
_LATE_S = 0.5
"""A look that comes so much too late shows that this process did not run: the silence was its own."""
_CLOSED = "The client closed the response before its result was sent."
_GONE = "the end of its client, which closed its last open response"
_UNHEARD = f"the client lease: nothing was received from its client for {CLIENT_LEASE_S:g} s"
RESPONSE = "ros2_mcp.response"
"""The key of a request's scope under which its `OpenResponse` is found."""
_ACCEPTED = "ros2_mcp.accepted"
"""The key under which is noted when all of a request had come."""

Context = ServerRequestContext[Any, Any]
_logger = logging.getLogger(__name__)


class OpenResponse(Protocol):
    """The response to one HTTP request, from its arrival on.

    `listens` says that it carries what the server tells unasked: who closes that, goes.
    """

    listens: bool

    @property
    def is_open(self) -> bool:
        """Whether it is neither complete nor closed."""
        ...

    @property
    def was_closed(self) -> bool:
        """Whether its client has closed it before it was complete."""
        ...

    def heard_at(self) -> float:
        """When its client last acknowledged or sent anything (monotonic, s); now, where nobody can tell; 0 where it has
        closed the connection, which `closed` is told a moment later.
        """
        ...

    async def show_alive(self) -> None:
        """Sends something that says nothing, so that its client has something to acknowledge."""
        ...


class Connected(OpenResponse, Protocol):
    """A client at a connection of its own, which carries all its requests and their answers."""

    principal: Principal


@dataclass(eq=False)
class Call:
    """One call of a tool that is under way, and the response that carries its result. `acts` if the tool can; `about`
    names the robot, where there are several and it names one.
    """

    scope: anyio.CancelScope
    response: OpenResponse | None = None
    ping: Callable[[], Awaitable[object]] | None = None
    acts: bool = False
    about: str = ""
    pinged_at: float = 0.0
    end_reason: str = ""

    def end(self, reason: str) -> None:
        """Cancels it: nobody awaits its result."""
        self.end_reason = self.end_reason or reason
        self.scope.cancel()


@dataclass(eq=False)
class Client:
    """One client over HTTP. Times are monotonic, in s.

    `has_gone` from the time on at which what it moves is ended, until it asks for something: it is ended once.
    `ends_for` are, for each robot on which it is being ended, the reasons that are still to be carried out.
    `has_closed` if it has closed a response that shows its going, and not asked for anything since.
    """

    principal: Principal
    asked_at: float
    granted_at: float = 0.0
    """Its lease is not over sooner than this and the lease's length: set when it begins to move something."""
    credited_until: float = 0.0
    """Nor sooner than this: set when this process was late."""
    credited_at: float = 0.0
    """When it was last heard of before the silence for which lateness is credited, of which `credit_s` is left."""
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
        """The last sign of its life."""
        return max(self.asked_at, self.granted_at, *(response.heard_at() for response in self.responses))

    def lease_ends_at(self) -> float:
        """When its lease is over, unless it is heard of again."""
        return max(self.heard_at() + CLIENT_LEASE_S, self.credited_until)

    def credit(self, late_s: float, now: float) -> None:
        """Makes good for what this process was late, in one silence of its client by the length of a lease at most."""
        if (heard_at := self.heard_at()) > self.credited_at + _LOOK_S:  # the kernel counts ms: the same time differs
            self.credited_at, self.credit_s = heard_at, CLIENT_LEASE_S
        if (credit_s := min(late_s, self.credit_s)) > 0:
            self.credit_s -= credit_s
            ends_at = self.lease_ends_at()
            self.credited_until = max(ends_at + credit_s, min(ends_at + late_s, now + credit_s))


class Leases:
    """The clients over HTTP that were heard of lately, and the end of what those keep moving that have gone."""

    def __init__(self, *robots: Robot) -> None:
        self._robots = robots
        self._clients: dict[Principal, Client] = {}
        self._asked = asyncio.Event()
        self._tasks: TaskGroup | None = None

    async def keep(self) -> None:
        """Watches the leases, until cancelled. Rests while no client asks for anything and none moves anything."""
        async with anyio.create_task_group() as self._tasks:
            while True:
                await self._asked.wait()
                self._asked.clear()
                looked_at = monotonic()
                while self._look(looked_at):
                    looked_at = monotonic()
                    await anyio.sleep(_LOOK_S)

    def calls_under_way(self, about: str) -> int:
        """How many calls of tools about that robot wait for their results; of "" those that name none."""
        return sum(call.about == about for client in self._clients.values() for call in client.calls)

    # ── what is heard of clients ───────────────────────────────────────────────────────────────────────────────

    async def note(self, ctx: Context, call_next: CallNext) -> Any:
        """As a middleware of the server: notes who asks, and that he does."""
        if (principal := principal_of(ctx)) != LOCAL:
            response = _response_of(ctx)
            if response and ctx.method == "subscriptions/listen":
                response.listens = True
            self.asked(principal, response)
        return await call_next(ctx)

    def received(self, scope: Scope) -> None:
        """Notes in a request that all of it has come: a stop that comes now is a later one, however long the request
        is still read and waits.
        """
        scope[_ACCEPTED] = {robot.stops: robot.stops.now() for robot in self._robots}

    def asked(self, principal: Principal, response: OpenResponse | None = None) -> None:
        """Notes a request of a client, which renews its lease, and the response that is open for it.

        One whose response the client has closed already says nothing more of the client.
        """
        if response and response.was_closed:
            return
        client = self._clients.setdefault(principal, Client(principal, monotonic()))
        client.asked_at, client.has_gone, client.has_closed = monotonic(), False, False
        if response and response.is_open:
            client.responses.add(response)
        self._asked.set()

    def finished(self, response: OpenResponse) -> None:
        """Notes that a response is complete."""
        for client in self._clients.values():
            client.responses.discard(response)

    def closed(self, response: OpenResponse) -> None:
        """Notes that a client has closed a response: ends its call, and all it moves if no other one is open.

        Who closes the response to what only reads cancels that, and has not gone.
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
        """Notes that a client has ended its session."""
        if client := self._clients.get(principal):
            self._begin_end(client, "the end of its client, which ended its session")

    @contextmanager
    def attended(self, context: Context, *, acts: bool, about: str = "") -> Generator[Call]:
        """The block is a call of a client: it is cancelled, and says why, when that client has gone.

        One whose response was closed before this is cancelled from its beginning on.
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

    # ── the watch ──────────────────────────────────────────────────────────────────────────────────────────────

    def _look(self, looked_at: float) -> bool:
        """Ends what must end; whether there is anything to watch."""
        now = monotonic()
        late_s = now - looked_at - _LOOK_S
        for client in list(self._clients.values()):
            try:
                self._look_at(client, late_s, now)
            except (
                Exception
            ):  # a fault that one client brings out must not end the watch over the others, nor the server
                if not client.has_failed:  # said once, and not 20 times a second
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
        # Where it is being ended on all robots there is nothing to end; one that is away takes its time for it.
        if client.is_moving and len(client.ends_for) < len(self._robots):
            self._watch(client, now)
        elif not client.calls and not client.responses and now > client.lease_ends_at():
            del self._clients[client.principal]

    def _is_moving(self, client: Client) -> bool:
        """Whether it may move something, or a call is under way that may: one that waits moves something later."""
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
        """Ends what a client moves who has gone, once: again only if it has asked for something since."""
        if not self._tasks or client.has_gone:
            return
        client.has_gone = True
        for robot in self._robots:
            is_ending = robot in client.ends_for
            client.ends_for.setdefault(robot, []).append(reason)
            if not is_ending:
                self._tasks.start_soon(self._end, client, robot)

    async def _end(self, client: Client, robot: Robot) -> None:
        """Ends the calls of a client that has gone, and what it keeps moving on one robot; again if it goes again
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
        except Exception:  # a fault in ending what one client moves must not end the watch over the others
            _logger.exception("what %s moves was not ended in good order", client.principal.name)
        finally:
            del client.ends_for[robot]


def _response_of(context: Context) -> OpenResponse | None:
    request: Request[Any] | None = context.request
    return _connected(context) or (request.scope.get(RESPONSE) if request else None)


def _connected(context: Context) -> Connected | None:
    """The client at a connection of its own, if the request came there."""
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
    """Sends a ping on the response of a call; None in the modern era, in which a server asks nothing of clients."""
    session = context.session
    if not session.can_send_request:
        return None

    async def ping() -> None:  # its answer is a request of the client, which renews the lease
        on_this_response = ServerMessageMetadata(related_request_id=context.request_id)
        await session.send_request(PingRequest(), EmptyResult, UNRENEWED_REPEAT_S, on_this_response)

    return ping


async def _attempt(sign: Callable[[], Awaitable[object]]) -> None:
    """A comment or a ping; that it does not arrive is noticed by what is not heard."""
    try:
        await sign()
    except Exception as error:  # noqa: BLE001 - whatever a dying connection raises must not end the watch over others
        _logger.debug("a sign of life was not sent: %r", error)


# ── who asks ─────────────────────────────────────────────────────────────────────────────────────────────────────


def principal_of(context: Context) -> Principal:
    """Who asks: the one client over stdio, a session over HTTP, or a program of that name at an address.

    HTTP requests of the modern era belong to no session. What tells their clients apart is their token, the address
    they come from and what they call themselves: two that run the same program on one machine are the same principal.
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
    """When a request over HTTP had come, as that robot counts it, if that was noted."""
    request: Request[Any] | None = context.request
    noted: Mapping[Stops, Accepted] = {} if request is None or _connected(context) else request.scope.get(_ACCEPTED, {})
    return noted.get(robot.stops)


def session_of(request: Request[Any]) -> str:
    """The id of the session that a request names; empty where it names none."""
    version = request.headers.get("mcp-protocol-version")
    is_modern = version is not None and version not in HANDSHAKE_PROTOCOL_VERSIONS  # which knows no sessions
    return "" if is_modern else request.headers.get("mcp-session-id", "")


def principal_of_session(session: str, login: Login | None = None) -> Principal:
    """The client of a session. Who knows the session's id can use it: the principal is named by a hash of it."""
    return _named(f"session {session}", login)


def _named(text: str, login: Login | None) -> Principal:
    digest, who = hashlib.sha256(text.encode()).hexdigest()[:8], login.name if login else ""
    return Principal(name=f"{who or 'http'}_{digest}", transport="http", login=who)
