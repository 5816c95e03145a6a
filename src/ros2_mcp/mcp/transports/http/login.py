"""The login over HTTP: a request without a known token is refused, whatever its path and method."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from mcp.server.auth.middleware.bearer_auth import AuthenticatedUser
from mcp.server.auth.provider import AccessToken
from starlette.responses import PlainTextResponse

from ros2_mcp.guard.tokens import LOGIN, Login, Tokens

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

_IN_QUERY = frozenset({"access_token", "token", "bearer_token", "api_key", "authorization"})
"""Query parameters in which clients wrongly put tokens: addresses are logged, and kept in histories."""
_HOW = (
    "A token is asked for: Authorization: Bearer TOKEN. ros2-mcp config CLIENT --http prints a client's configuration."
)


class LoginLayer:
    """The ASGI layer that requires a token, and stores its login in the request."""

    def __init__(self, app: ASGIApp, tokens: Tokens | None) -> None:
        self._app = app
        self._tokens = tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        app = self._app
        if scope["type"] == "http" and self._tokens:
            found = _logged_in(scope, self._tokens)
            if isinstance(found, Login):
                scope[LOGIN] = found
                # The SDK takes it as the user: a session can only be used by the user who began it.
                token = AccessToken(token="", client_id=found.name, scopes=sorted(found.scopes))
                scope["user"] = AuthenticatedUser(token)
            else:
                app = found
        await app(scope, receive, send)


def _logged_in(scope: Scope, tokens: Tokens) -> Login | PlainTextResponse:
    """Return the login of a request's token, or the refusal."""
    presented = [value for name, value in scope["headers"] if name == b"authorization"]
    query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
    if any(name.lower() in _IN_QUERY for name, _ in query):
        return _refusal(400, "invalid_request", "A token belongs in the header Authorization, never in the address.")
    if len(presented) > 1:
        return _refusal(400, "invalid_request", "The header Authorization is given twice.")
    scheme, _, token = presented[0].strip().partition(b" ") if presented else (b"", b"", b"")
    if scheme.lower() != b"bearer":
        return _refusal(401, "", _HOW)
    return tokens.login(token.strip()) or _refusal(401, "invalid_token", f"This token is not known. {_HOW}")


def _refusal(status: int, error: str, text: str) -> PlainTextResponse:
    return PlainTextResponse(text, status, {"WWW-Authenticate": challenge(error)})


def challenge(error: str, scope: str = "") -> str:
    """Return the header `WWW-Authenticate` of a refusal."""
    more = {"error": error, "scope": scope}
    return ", ".join(['Bearer realm="ros2-mcp"', *(f'{name}="{value}"' for name, value in more.items() if value)])
