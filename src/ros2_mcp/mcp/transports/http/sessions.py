"""How many sessions there may be over HTTP, for each login; and that a stop needs none.

A login's sessions are its own: no other one fills or ends them. Of those, one of which nothing is heard any more makes
room for a new one. A stop is carried out also where its session has ended, or no session can be had.
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
"""Of one login: more programs than drive one robot; each holds a few hundred kB here."""
REQUEST = "ros2_mcp.request"
"""The key of a request's scope under which is noted what it asks for, a `ReadRequest`."""
_SESSION = "mcp-session-id"
_WITHOUT_SESSION = frozenset({"notifications/initialized", "ping", "tools/list"})
"""What a client asks, besides `ros2_stop`, to which a handshake without a session was given."""
_FULL = (
    "Too many open sessions of this login: without a session ros2_stop alone is answered. Connect again when one has "
    "ended."
)
_NO_SESSION = (404, 503)
"""How the SDK refuses a request whose session it does not know, or cannot begin."""


@dataclass(frozen=True, slots=True)
class ReadRequest:
    """What a request asks for. `stops` if it is a stop, of a size that two parsers read alike."""

    method: str
    stops: bool
    body: bytes


@dataclass(slots=True)
class _Session:
    """`ending` is the scope of the request that ends it, `login` the name of the token that began it."""

    login: str
    ending: Scope
    used_at: float = field(default_factory=monotonic)
    open: int = 0


class Sessions:
    """The ASGI layer that counts the sessions of streamable HTTP.

    A session without an open response of which nothing was heard for a client lease keeps nothing moving; if it is the
    one of its login that was silent for the longest, it is ended for a new one. Where none is, the new client gets a
    handshake without a session, in which it can stop the robot and do nothing else. `without_session` answers it.
    """

    def __init__(self, app: ASGIApp, without_session: ASGIApp) -> None:
        self._app = app
        self._without_session = without_session
        self._known: dict[str, _Session] = {}
        self._beginning: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
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
        """In its session, or, if that is not there any more, without one."""
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
        """Whether a login may begin one more; a silent one is ended for it."""
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
        """Ends a session as its client would."""

        async def unheard(_: Any) -> None: ...

        await self._app(self._known.pop(name).ending, _replayed(b""), unheard)


def _is_modern(scope: Scope) -> bool:
    """Whether a request is of the era that knows no sessions."""
    version = Headers(scope=scope).get("mcp-protocol-version")
    return version is not None and version not in HANDSHAKE_PROTOCOL_VERSIONS


def _replayed(body: bytes, then: Receive | None = None) -> Receive:
    """A body that has been read, once more, and what comes `then`."""
    first: Message | None = {"type": "http.request", "body": body, "more_body": False}

    async def receive() -> Message:
        nonlocal first
        message, first = first, None
        return message or (await then() if then else {"type": "http.disconnect"})

    return receive


_OF_A_REQUEST = ("type", "asgi", "http_version", "path", "raw_path", "root_path", "scheme", "client", "server", "user")


def _ending(begun_by: Scope, session: str) -> Scope:
    """The DELETE with which a client ends the session that it began with that request."""
    kept = {key: begun_by[key] for key in _OF_A_REQUEST if key in begun_by}
    headers = [(key, value) for key, value in begun_by["headers"] if key == b"host"]
    headers.append((_SESSION.encode(), session.encode()))
    return {**kept, "method": "DELETE", "query_string": b"", "headers": headers}
