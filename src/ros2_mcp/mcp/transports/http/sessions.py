"""Limits the HTTP sessions of each login, and lets a stop pass without a session.

A login's sessions are its own: other logins neither fill nor end them. Among them, a silent session makes room for a
new one. A stop is carried out even if its session has ended, or no session can be begun.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

from mcp_types.version import HANDSHAKE_PROTOCOL_VERSIONS
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

from ros2_mcp.mcp.leases import CLIENT_LEASE_S
from ros2_mcp.mcp.scopes import login_name

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_SESSIONS = 16
"""The most sessions of one login: more than the programs that use one robot. Each holds a few hundred kB in this
server.
"""
REQUEST = "ros2_mcp.request"
"""The key of the `ReadRequest` in a request's ASGI scope."""
_SESSION = "mcp-session-id"
_WITHOUT_SESSION = frozenset({"notifications/initialized", "ping", "tools/list"})
"""What a client with a handshake but without a session may ask, besides `ros2_stop`."""
_FULL = (
    "Too many open sessions of this login: without a session ros2_stop alone is answered. Connect again when one has "
    "ended."
)
_NO_SESSION = (404, 503)
"""The HTTP statuses with which the SDK refuses an unknown session, or a session that cannot be begun."""


@dataclass(frozen=True, slots=True)
class ReadRequest:
    """A parsed request. `stops`: it is a stop, small enough to be read by one parser only."""

    method: str
    stops: bool
    body: bytes


@dataclass(slots=True)
class _Session:
    """A session. `ending` is the scope of the request that ends it, `login` the name of the token that began it."""

    login: str
    ending: Scope
    used_at: float = field(default_factory=monotonic)
    open: int = 0


class Sessions:
    """The ASGI layer that counts the sessions of streamable HTTP.

    A session without an open response that was silent for a client lease moves nothing; of these, the one of the login
    that was silent for the longest is ended for a new session. If there is none, the new client gets a handshake
    without a session, in which it can only stop the robot. `without_session` is the app that answers it.
    """

    def __init__(self, app: ASGIApp, without_session: ASGIApp) -> None:
        self._app = app
        self._without_session = without_session
        self._known: dict[str, _Session] = {}
        self._beginning: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or _is_modern(scope):
            await self._app(scope, receive, send)
            return
        named = Headers(scope=scope).get(_SESSION, "")
        read: ReadRequest | None = scope.get(REQUEST)
        if read and read.stops:
            await self._stop(read, named, scope, receive, send)
        elif named:
            await self._in_session(named, scope, receive, send)
        elif read and read.method in _WITHOUT_SESSION:
            await self._without_session(scope, receive, send)
        elif await self._has_room(login_name(scope)):
            await self._begin(scope, receive, send)
        elif read and read.method == "initialize":
            await self._without_session(scope, receive, send)
        else:
            await PlainTextResponse(_FULL, 503, {"Retry-After": "1"})(scope, receive, send)

    async def _stop(self, read: ReadRequest, named: str, scope: Scope, receive: Receive, send: Send) -> None:
        """Carry out a stop in its session, or without one if the session no longer exists."""
        has_no_session = not named

        async def unless_refused(message: Message) -> None:
            nonlocal has_no_session
            if message["type"] == "http.response.start" and message["status"] in _NO_SESSION:
                has_no_session = True
            if not has_no_session:
                await send(message)

        if named:
            await self._in_session(named, scope, receive, unless_refused)
        if has_no_session:
            await self._without_session(scope, _replayed(read.body, receive), send)

    async def _in_session(self, named: str, scope: Scope, receive: Receive, send: Send) -> None:
        session = self._known.get(named)
        if not session or session.login != login_name(scope):  # the SDK refuses it
            await self._app(scope, receive, send)
            return

        async def note(message: Message) -> None:
            if message["type"] == "http.response.start":
                status = message["status"]
                if status == 404 or (scope["method"] == "DELETE" and status < 400):
                    self._known.pop(named, None)
            await send(message)

        session.open += 1
        try:
            await self._app(scope, receive, note)
        finally:
            session.open -= 1
            session.used_at = monotonic()

    async def _begin(self, scope: Scope, receive: Receive, send: Send) -> None:
        login, is_counted = login_name(scope), False

        async def note(message: Message) -> None:
            nonlocal is_counted
            if message["type"] == "http.response.start" and message["status"] < 400 and not is_counted:
                begun = Headers(raw=message["headers"]).get(_SESSION, "")
                if begun:
                    self._known[begun] = _Session(login, _ending(scope, begun))
                    self._beginning[login] -= 1
                    is_counted = True
            await send(message)

        self._beginning[login] += 1
        try:
            await self._app(scope, receive, note)
        finally:
            if not is_counted:
                self._beginning[login] -= 1

    async def _has_room(self, login: str) -> bool:
        """Return whether a login may begin one more session; end a silent session for it if needed."""
        while True:
            own = {name: session for name, session in self._known.items() if session.login == login}
            if len(own) + self._beginning[login] < MOST_SESSIONS:
                return True
            silent_since = monotonic() - CLIENT_LEASE_S
            silent = [name for name, session in own.items() if not session.open and session.used_at < silent_since]
            if not silent:
                return False
            await self._end(min(silent, key=lambda name: own[name].used_at))

    async def _end(self, name: str) -> None:
        """End a session as its client would."""

        async def unheard(_: Any) -> None: ...

        await self._app(self._known.pop(name).ending, _replayed(b""), unheard)


def _is_modern(scope: Scope) -> bool:
    """Return whether a request is of the modern era, which has no sessions."""
    version = Headers(scope=scope).get("mcp-protocol-version")
    return version is not None and version not in HANDSHAKE_PROTOCOL_VERSIONS


def _replayed(body: bytes, then: Receive | None = None) -> Receive:
    """Return a `Receive` that first gives a body that has been read, and then what `then` gives."""
    first: Message | None = {"type": "http.request", "body": body, "more_body": False}

    async def receive() -> Message:
        nonlocal first
        message, first = first, None
        return message or (await then() if then else {"type": "http.disconnect"})

    return receive


_OF_A_REQUEST = ("type", "asgi", "http_version", "path", "raw_path", "root_path", "scheme", "client", "server", "user")


def _ending(begun_by: Scope, session: str) -> Scope:
    """Return the scope of the DELETE request with which a client ends the session that it began with `begun_by`."""
    kept = {key: begun_by[key] for key in _OF_A_REQUEST if key in begun_by}
    headers = [(key, value) for key, value in begun_by["headers"] if key == b"host"]
    headers.append((_SESSION.encode(), session.encode()))
    return {**kept, "method": "DELETE", "query_string": b"", "headers": headers}
