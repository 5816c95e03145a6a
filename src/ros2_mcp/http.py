"""MCP over HTTP, guarded: only known Host and Origin headers, whatever address it listens on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import anyio
import uvicorn
from mcp.server.sse import SseServerTransport
from mcp.server.transport_security import TransportSecurityMiddleware, TransportSecuritySettings
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route

from ros2_mcp.leases import MESSAGES
from ros2_mcp.presence import Connections, Presence

if TYPE_CHECKING:
    from mcp.server.lowlevel import Server
    from starlette.types import ASGIApp, Receive, Scope, Send

    from ros2_mcp.leases import Leases
    from ros2_mcp.settings import Settings


_HTTP_PORT = 80


async def serve_http(server: Server[Any], leases: Leases, settings: Settings) -> None:
    """Serves `/mcp` (streamable HTTP) or `/sse`, until cancelled."""
    guard = security(settings.host, settings.port)
    if settings.transport == "sse":
        app = _sse_app(server, guard)
    else:
        app = server.streamable_http_app(host=settings.host, transport_security=guard)
    connections = Connections()
    config = uvicorn.Config(
        _KnownHosts(Presence(app, leases, connections), guard),
        host=settings.host.strip("[]"),
        port=settings.port,
        ws="none",  # a way in that no guard, lease or test of ours knows
        log_level=settings.log_level,
        http=connections.protocol(),
        proxy_headers=False,  # they say what the client likes, and connections are found by their real addresses
    )
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(leases.keep)
        await uvicorn.Server(config).serve()
        tasks.cancel_scope.cancel()


def security(host: str, port: int) -> TransportSecuritySettings:
    """The headers that are accepted: this machine's own names and the address listened on."""
    named = ["127.0.0.1", "localhost", "[::1]"]
    host = host.strip("[]")
    if host not in ("0.0.0.0", "::"):
        written = f"[{host}]" if ":" in host else host
        named += [written, written.lower()]  # browsers write names in lower case
    at = [f"{name}:{port}" for name in dict.fromkeys(named)]
    at += named if port == _HTTP_PORT else []  # which nobody writes
    return TransportSecuritySettings(
        enable_dns_rebinding_protection=True,
        allowed_hosts=at,
        allowed_origins=[f"http://{name}" for name in at],
    )


class _KnownHosts:
    """Refuses a request with a foreign Host or Origin, whatever its path and method, before anything else sees it."""

    def __init__(self, app: ASGIApp, settings: TransportSecuritySettings) -> None:
        self._app = app
        self._security = TransportSecurityMiddleware(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        answer: ASGIApp | None = None
        if scope["type"] == "http":
            request = Request(scope)
            if any(len(request.headers.getlist(name)) > 1 for name in ("host", "origin")):
                answer = Response("Host or Origin is given twice", status_code=400)  # the SDK looks at the first alone
            else:
                answer = await self._security.validate_request(request)
        await (answer or self._app)(scope, receive, send)


def _sse_app(server: Server[Any], guard: TransportSecuritySettings) -> Starlette:
    """The application of the older HTTP transport: a stream of events, and a place for messages to it."""
    sse = SseServerTransport(MESSAGES, security_settings=guard)
    routes = [
        # A client that tries the newer transport first must be refused its POST, to fall back to this one.
        Route("/sse", endpoint=_Stream(server, sse), methods=["GET"]),
        Mount(MESSAGES, app=sse.handle_post_message),
    ]
    return Starlette(routes=routes)


class _Stream:
    """One client's stream of events, as an ASGI application: a function would get a request instead of the streams."""

    def __init__(self, server: Server[Any], sse: SseServerTransport) -> None:
        self._server = server
        self._sse = sse

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async with self._sse.connect_sse(scope, receive, send) as (incoming, outgoing):
            await self._server.run(incoming, outgoing, self._server.create_initialization_options())
