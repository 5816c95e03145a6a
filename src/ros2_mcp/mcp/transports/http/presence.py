"""Whether an HTTP client is alive: its open responses, and the kernel's record of its connection (`connections.py`)."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from starlette.requests import Request

from ros2_mcp.mcp.leases import RESPONSE, Leases, principal_of_session, session_of
from ros2_mcp.mcp.scopes import login_of

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from ros2_mcp.mcp.transports.http.connections import Connections

_ALIVE = b": alive\r\n\r\n"
"""A comment of an event stream, which readers skip."""
_EVENTS = b"text/event-stream"


class Presence:
    """The ASGI layer below the MCP transports that reports requests and closed responses to the leases."""

    def __init__(self, app: ASGIApp, leases: Leases, connections: Connections) -> None:
        self._app = app
        self.leases = leases
        self.connections = connections

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        self.connections.trust(scope)
        response = _Response(self, scope, receive, send)
        scope[RESPONSE] = response
        try:
            await self._app(scope, response.receive, response.send)
        finally:
            response.end()


class _Response:
    """An `OpenResponse`: forwards the messages between application and client, and records its end."""

    def __init__(self, layer: Presence, scope: Scope, receive: Receive, send: Send) -> None:
        self._leases = layer.leases
        self._connections = layer.connections
        self._scope = scope
        self._receive = receive
        self._send = send
        self._request = Request(scope)
        self._sending = asyncio.Lock()
        self._has_begun = False
        self._is_stream = False
        self._is_ours = False
        self._held = b""
        self.is_open = True
        self.was_closed = False
        self.listens = scope["method"] == "GET"

    def heard_at(self) -> float:
        """Return when the client last acknowledged or sent anything (monotonic clock, s), as `Connections.heard_at`."""
        return self._connections.heard_at(self._scope)

    async def receive(self) -> Message:
        """Return the client's next message; if it closes the response, record that first."""
        message = await self._receive()
        if message["type"] == "http.disconnect" and self.is_open:
            self.is_open, self.was_closed = False, True
            self._leases.closed(self)
        return message

    async def send(self, message: Message) -> None:
        """Send a message of the application to the client."""
        async with self._sending:
            if message["type"] == "http.response.start":
                self._note_start(message)
                if self._is_ours:
                    return  # `show_alive` has begun an event stream already
            elif self._is_ours and not self._is_stream:
                message = self._as_event(message)
            is_last = message["type"] == "http.response.body" and not message.get("more_body")
            if is_last:
                self.end()
            await self._send(message)

    async def show_alive(self) -> None:
        """Send a comment, unless another message is being sent, which the client has to acknowledge as well.

        A response that has not begun becomes an event stream: MCP clients accept both kinds.
        """
        if self._sending.locked():
            return
        async with self._sending:
            if self.is_open and not self._has_begun:
                self._has_begun = self._is_ours = True
                headers = [(b"content-type", _EVENTS), (b"cache-control", b"no-cache, no-transform")]
                await self._send({"type": "http.response.start", "status": 200, "headers": headers})
            if self.is_open and (self._is_stream or self._is_ours):
                await self._send({"type": "http.response.body", "body": _ALIVE, "more_body": True})

    def end(self) -> None:
        """Record that the response is complete."""
        if self.is_open:
            self.is_open = False
            self._leases.finished(self)

    def _note_start(self, message: Message) -> None:
        """Record the start of the response. An accepted request is a sign of life of its session's client; DELETE ends
        the session.
        """
        self._has_begun = True
        self._is_stream = any(
            name.lower() == b"content-type" and value.startswith(_EVENTS) for name, value in message["headers"]
        )
        session = session_of(self._request)
        if not session or message["status"] >= 400:
            return
        principal = principal_of_session(session, login_of(self._request))
        self._leases.asked(principal, self)
        if self._scope["method"] == "DELETE":
            self._leases.left(principal)

    def _as_event(self, message: Message) -> Message:
        """Return a JSON answer as the one event of the stream that was begun for it."""
        self._held += message.get("body", b"")
        if message.get("more_body"):
            return {"type": "http.response.body", "body": b"", "more_body": True}
        return {"type": "http.response.body", "body": b"event: message\r\ndata: " + self._held + b"\r\n\r\n"}
