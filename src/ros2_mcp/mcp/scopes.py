"""The permissions of a request by its token: to read, to act and to stop, by the declared risk of each tool."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mcp.server.context import CallNext, ServerRequestContext
from mcp.shared.exceptions import MCPError
from mcp.types import INVALID_REQUEST

from ros2_mcp.guard.tokens import LOGIN, Login, may
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.commands import Principal

_FREE = frozenset({"initialize", "server/discover", "ping", "tools/list"})
"""Methods that need no scope: without them no client could connect in order to stop anything. Notifications need none
either.
"""


class Scopes:
    """Checks requests against the scopes of their tokens."""

    def __init__(self, toolset: Toolset) -> None:
        self._toolset = toolset

    def lacking(self, login: Login | None, method: str, params: Mapping[str, Any] | None) -> str:
        """Return the scope that a request lacks; "" if it is allowed. Without a login, all requests are allowed."""
        if login is None or method in _FREE or method.startswith("notifications/"):
            return ""
        if method != "tools/call":
            return may(login.scopes, "read")
        name = (params or {}).get("name")
        return may(login.scopes, self._toolset.risk_of(name) if isinstance(name, str) else "read")

    def refuse(self, lacking: str, login: Login | None, params: Mapping[str, Any] | None) -> str:
        """Return the text of a refusal for a missing scope. Refused calls of tools that act are noted in the audit."""
        words = f"The token of this client lacks the scope {lacking!r}: not done. Use a token that has this scope."
        if login and isinstance(name := (params or {}).get("name"), str):
            principal = Principal(name=login.name, transport="http", login=login.name)
            self._toolset.note_refusal(name, words, principal)
        return words

    def stops(self, method: str, params: Mapping[str, Any] | None) -> bool:
        """Return whether a request calls a tool that stops."""
        name = (params or {}).get("name")
        return method == "tools/call" and isinstance(name, str) and self._toolset.risk_of(name) == "stop"

    async def check(self, ctx: ServerRequestContext[Any, Any], call_next: CallNext) -> Any:
        """Refuse requests that the scopes do not allow, whichever transport read them. A middleware of the server.

        Raises:
            MCPError: naming the missing scope.
        """
        login = _login_in(ctx)
        if lacking := self.lacking(login, ctx.method, ctx.params):
            raise MCPError(INVALID_REQUEST, self.refuse(lacking, login, ctx.params))
        return await call_next(ctx)


def _login_in(context: ServerRequestContext[Any, Any]) -> Login | None:
    return login_of(context.request)


def login_of(request: Any) -> Login | None:
    """Return the login of a request; None over stdio, at a socket, and without a login."""
    scope = getattr(request, "scope", None)
    return scope.get(LOGIN) if scope else None


def login_name(scope: Mapping[str, Any]) -> str:
    """Return the name of the token of an HTTP request; "" without a login."""
    login: Login | None = scope.get(LOGIN)
    return login.name if login else ""
