"""MCP over HTTP, guarded at every address: only known Host and Origin headers and known tokens are accepted."""

from __future__ import annotations

import logging
import socket
from collections import Counter
from contextlib import asynccontextmanager, contextmanager
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import anyio
import uvicorn
import uvicorn.config
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from mcp.server.transport_security import (
    TransportSecurityMiddleware,
    TransportSecuritySettings,
)
from mcp.types import INVALID_REQUEST, JSONRPCNotification, JSONRPCRequest
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response

from ros2_mcp.mcp.leases import session_of
from ros2_mcp.mcp.scopes import login_of
from ros2_mcp.mcp.transports.http.connections import Connections
from ros2_mcp.mcp.transports.http.login import LoginLayer, challenge
from ros2_mcp.mcp.transports.http.presence import Presence
from ros2_mcp.mcp.transports.http.sessions import MOST_SESSIONS, REQUEST, ReadRequest, Sessions
from ros2_mcp.mcp.transports.jsonrpc import Refusal, read_message
from ros2_mcp.model.aside import LARGE, READING, aside

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable, Generator

    from mcp.server.lowlevel import Server
    from mcp.types import JSONRPCMessage
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from ros2_mcp.guard.entrance import Entrance
    from ros2_mcp.mcp.leases import Leases
    from ros2_mcp.mcp.scopes import Scopes
    from ros2_mcp.settings import Settings


_MESSAGE_PATH = "/mcp"
"""The prefix of the path to which messages are posted; a prefix, because the path with a line feed appended is routed
to the same place.
"""
_MOST_BYTES = 1_000_000
"""The largest body. The SDK parses it a second time on the event loop, which takes 0.01 to 0.13 s at this size. The
link lease is 1 s.
"""
_TOO_LARGE = f"A request over HTTP has at most {_MOST_BYTES:,} bytes: send smaller requests, or use stdio."
_MOST_NESTED = 50_000
"""The most lists and objects in a body, including brackets within texts. Each is an object that the garbage collector
visits while the event loop waits: 400,000 of them in 0.8 MB take 0.5 s, and twelve such bodies delayed a stop by 3 s. A
megabyte of points or poses has 40,000 at most.
"""
_TOO_NESTED = (
    f"A request over HTTP has at most {_MOST_NESTED:,} objects and lists: send smaller requests, or use stdio."
)
_SMALL_BYTES = 4000
"""A body up to this size is always read, and by one parser only (`incoming.LARGE`): a stop has about 200 bytes."""
_MOST_HELD_BYTES = 64_000_000
"""The most bytes of bodies that are read or answered at the same time: 64 of the largest."""
_LET_PASS_S = 3.0
"""The longest wait of a large body for stops that are running, so that a client that stops all the time does not block
the others.
"""
_BUSY = "Too many large requests are being processed: repeat this one in 1 s."
_CANCELLED = 0
"""The SDK's error code for a request that its client has cancelled."""
_Key = tuple[str, str]
"""A session, and the id of a request in it."""


async def serve_http(
    server: Server[Any],
    leases: Leases,
    scopes: Scopes,
    *,
    settings: Settings,
    entrance: Entrance,
    announce: Callable[[str], None],
) -> None:
    """Serve `/mcp` (streamable HTTP) until cancelled. `announce` is called with the address when the server listens.

    Raises:
        BadInput: if it cannot listen at the address and port of the settings.
    """
    guard = TransportSecuritySettings(
        enable_dns_rebinding_protection=True,
        allowed_hosts=list(entrance.hosts),
        allowed_origins=list(entrance.origins),
    )
    connections = Connections()
    listeners = await connections.listen(settings.host.strip("[]"), settings.port)
    async with _transport(server, guard, settings, entrance) as app:
        readable = _Readable(app, leases, scopes)
        config = uvicorn.Config(
            _KnownHosts(LoginLayer(Presence(readable, leases, connections), entrance.tokens), guard),
            ssl_certfile=settings.tls_cert and settings.tls_cert.expanduser(),
            ssl_keyfile=settings.tls_key and settings.tls_key.expanduser(),
            ws="none",  # WebSocket bypasses the guards and the leases, and is not tested
            log_level=settings.log_level,
            log_config=_log_config(),
            http=connections.protocol(),
            proxy_headers=False,  # such headers come from the client, and prove nothing
        )
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(leases.keep)
            tasks.start_soon(connections.keep)
            await _Announced(config, lambda: announce(entrance.url)).serve(listeners)
            tasks.cancel_scope.cancel()


@asynccontextmanager
async def _transport(
    server: Server[Any], guard: TransportSecuritySettings, settings: Settings, entrance: Entrance
) -> AsyncGenerator[ASGIApp]:
    """Return the ASGI app that answers messages; it runs within this context."""
    in_session = server.streamable_http_app(
        host=settings.host,
        transport_security=guard,
        max_sessions=MOST_SESSIONS * max(1, len(entrance.tokens or ())),
        max_request_body_size=_MOST_BYTES,
    )
    without_session = StreamableHTTPSessionManager(server, stateless=True, security_settings=guard)
    async with without_session.run():
        yield Sessions(in_session, without_session.handle_request)


class _WithoutQuery(logging.Filter):
    """Removes the query from addresses in uvicorn's access log: clients write tokens and session ids there."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Remove the query; always keep the line."""
        if isinstance(record.args, tuple):  # client, method, address, version, status
            record.args = tuple(one.partition("?")[0] if isinstance(one, str) else one for one in record.args)
        return True


def _log_config() -> dict[str, Any]:
    """Return uvicorn's log configuration, with an access log without queries."""
    config = deepcopy(uvicorn.config.LOGGING_CONFIG)
    config["filters"] = {"without_query": {"()": _WithoutQuery}}
    config["loggers"]["uvicorn.access"]["filters"] = ["without_query"]
    return config


class _Announced(uvicorn.Server):
    """A uvicorn server that calls `announce` when it listens."""

    def __init__(self, config: uvicorn.Config, announce: Callable[[], None]) -> None:
        super().__init__(config)
        self._announce = announce

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen, then call `announce`."""
        await super().startup(sockets)
        if self.started:
            self._announce()


class _KnownHosts:
    """Refuses requests with a foreign Host or Origin, or with an ambiguous length, before any other layer sees them,
    whatever their path and method.
    """

    def __init__(self, app: ASGIApp, settings: TransportSecuritySettings) -> None:
        self._app = app
        self._security = TransportSecurityMiddleware(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        answer: ASGIApp | None = None
        if scope["type"] == "http":
            request = Request(scope)
            if any(len(request.headers.getlist(name)) > 1 for name in ("host", "origin")):
                answer = Response(
                    "The header Host or Origin is given twice.", status_code=400
                )  # the SDK reads the first one only
            elif "transfer-encoding" in request.headers and "content-length" in request.headers:
                # A proxy in front may use the length, and this server the chunks: bytes after the shorter of the two
                # would be a second request (RFC 9112, section 6.1). Nothing more is read from this connection.
                answer = Response(
                    "The headers Content-Length and Transfer-Encoding exclude each other.", 400, {"Connection": "close"}
                )
            else:
                answer = await self._security.validate_request(request)
        await (answer or self._app)(scope, receive, send)


class _Readable:
    """Answers requests that cannot be read, or whose id belongs to another unanswered request of the same session.

    Of two such requests, the transport of the handshake era would answer the later one only.
    """

    def __init__(self, app: ASGIApp, leases: Leases, scopes: Scopes) -> None:
        self._app = app
        self._leases = leases
        self._scopes = scopes
        self._held_bytes = 0
        self._in_flight: set[_Key] = set()
        self._being_read: Counter[str] = Counter()
        self._cancelled: set[_Key] = set()
        self._stops: set[anyio.Event] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "POST" or not scope["path"].startswith(_MESSAGE_PATH):
            await self._app(scope, receive, send)
            return
        request = Request(scope, receive)
        held = min(_declared_bytes(request), _MOST_BYTES)
        if held > _SMALL_BYTES and self._held_bytes + held > _MOST_HELD_BYTES:
            await PlainTextResponse(_BUSY, 503, {"Retry-After": "1"})(scope, receive, send)
            return
        self._held_bytes += held
        try:
            await self._take(request, send)
        finally:
            self._held_bytes -= held

    async def _take(self, request: Request, send: Send) -> None:
        try:
            body = await _body_of(request)
        except ClientDisconnect:  # before all of it had arrived: there is no client to answer
            return
        if body is None:
            await PlainTextResponse(_TOO_LARGE, 413)(request.scope, request.receive, send)
            return
        if body.count(b"[") + body.count(b"{") > _MOST_NESTED:
            await PlainTextResponse(_TOO_NESTED, 400)(request.scope, request.receive, send)
            return
        self._leases.received(request.scope)
        await self._answer(body, request.scope, request.receive, send)

    async def _answer(self, body: bytes, scope: Scope, receive: Receive, send: Send) -> None:
        session, login = session_of(Request(scope)), login_of(Request(scope))
        if session and login:  # unchecked so far: the token's name keeps the sessions of different tokens apart
            session = f"{login.name} {session}"
        message = await self._read(body, session)
        first: Message | None = {"type": "http.request", "body": body, "more_body": False}

        async def replay() -> Message:
            nonlocal first
            message, first = first, None
            return message or await receive()

        if isinstance(message, JSONRPCRequest) and (
            lacking := self._scopes.lacking(login, message.method, message.params)
        ):
            answer = Refusal(message.id, INVALID_REQUEST, self._scopes.refuse(lacking, login, message.params)).answer
            why = {"WWW-Authenticate": challenge("insufficient_scope", lacking)}
            await JSONResponse(answer, 403, why)(scope, receive, send)
            return
        if isinstance(message, (JSONRPCRequest, JSONRPCNotification)):
            stops = len(body) <= _SMALL_BYTES and self._scopes.stops(message.method, message.params)
            scope[REQUEST] = ReadRequest(message.method, stops, body)
            if stops:
                with self._stop_under_way():
                    await self._pass_on(message, session, scope, replay, send)
                return
        await self._pass_on(message, session, scope, replay, send)

    @contextmanager
    def _stop_under_way(self) -> Generator[None]:
        ended = anyio.Event()
        self._stops.add(ended)
        try:
            yield
        finally:
            self._stops.discard(ended)
            ended.set()

    async def _let_stops_pass(self) -> None:
        """Wait until no stop is running: the SDK parses large bodies on the event loop, where stops run, too."""
        with anyio.move_on_after(_LET_PASS_S):
            while self._stops:
                await next(iter(self._stops)).wait()

    async def _pass_on(
        self, message: JSONRPCMessage | list[Refusal], session: str, scope: Scope, replay: Receive, send: Send
    ) -> None:
        """Pass a request to the transport unless an unanswered request has the same id; answer other messages that
        cannot be read.
        """
        if isinstance(message, JSONRPCRequest) and session:
            key = _key(session, message.id)
            if key in self._in_flight:
                message = [Refusal(message.id, INVALID_REQUEST, "A request with this id has not been answered yet")]
            else:
                self._in_flight.add(key)
                try:
                    await self._app(scope, replay, send)
                finally:
                    self._in_flight.discard(key)
                return
        if isinstance(message, list) and message:
            answers = [refusal.answer for refusal in message]
            await JSONResponse(answers[0] if len(answers) == 1 else answers, 400)(scope, replay, send)
        else:
            await self._app(scope, replay, send)

    async def _read(self, body: bytes, session: str) -> JSONRPCMessage | list[Refusal]:
        """Return the message, or the refusals to send. Record cancellations while a large message is parsed."""
        self._being_read[session] += 1
        try:
            message = await aside(len(body), read_message, body, turn=READING)
            if len(body) > LARGE:
                await self._let_stops_pass()
            if isinstance(message, JSONRPCRequest) and _key(session, message.id) in self._cancelled:
                return [Refusal(message.id, _CANCELLED, "Request cancelled")]
        finally:
            self._being_read[session] -= 1
            if not self._being_read[session]:
                del self._being_read[session]
                self._cancelled = {key for key in self._cancelled if key[0] != session}
        if isinstance(message, JSONRPCNotification) and message.method == "notifications/cancelled":
            key = _key(session, (message.params or {}).get("requestId"))
            if session and session in self._being_read and key not in self._in_flight:
                self._cancelled.add(key)
        return message


def _key(session: str, request_id: object) -> _Key:
    return session, str(request_id)  # the SDK does not distinguish 7 from "7"


async def _body_of(request: Request) -> bytes | None:
    """Return the whole body; None if it is too large. Raises `ClientDisconnect`."""
    if _declared_bytes(request) > _MOST_BYTES and "transfer-encoding" not in request.headers:
        return None
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _MOST_BYTES:
            return None
    return bytes(body)


def _declared_bytes(request: Request) -> int:
    """Return the declared length of a body; more than the limit if there is none."""
    declared = request.headers.get("content-length", "")
    return int(declared[:20]) if declared.isdecimal() else _MOST_BYTES + 1
