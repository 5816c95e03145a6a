"""What the token of a request allows: reading, acting, stopping, by the risk that each tool declares."""

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
"""What every token may ask: without it no client would come as far as to stop anything. Notifications are free, too."""


class Scopes:
    """What the scopes of a token allow of this server."""

    def __init__(self, toolset: Toolset) -> None:
        self._toolset = toolset

    def lacking(self, login: Login | None, method: str, params: Mapping[str, Any] | None) -> str:
        """The scope that a request lacks; empty if it may be answered. Without a login everything may."""
        if login is None or method in _FREE or method.startswith("notifications/"):
            return ""
        if method != "tools/call":
            return may(login.scopes, "read")
        name = (params or {}).get("name")
        return may(login.scopes, self._toolset.risk_of(name) if isinstance(name, str) else "read")

    def refuse(self, lacking: str, login: Login | None, params: Mapping[str, Any] | None) -> str:
        """The words with which a request is refused that lacks a scope; of a tool that acts the audit has a line."""
        words = f"The token of this client lacks the scope {lacking!r}: not done. Use a token that has this scope."
        if login and isinstance(name := (params or {}).get("name"), str):
            principal = Principal(name=login.name, transport="http", login=login.name)
            self._toolset.note_refusal(name, words, principal)
        return words

    def stops(self, method: str, params: Mapping[str, Any] | None) -> bool:
        """Whether a request calls a tool that stops."""
        name = (params or {}).get("name")
        return method == "tools/call" and isinstance(name, str) and self._toolset.risk_of(name) == "stop"

    async def check(self, ctx: ServerRequestContext[Any, Any], call_next: CallNext) -> Any:
        """As a middleware of the server: refuses what the scopes do not allow, however it was read before.

        Raises:
            MCPError: naming the scope that is lacking.
        """
        login = _login_in(ctx)
        if lacking := self.lacking(login, ctx.method, ctx.params):
            raise MCPError(INVALID_REQUEST, self.refuse(lacking, login, ctx.params))
        return await call_next(ctx)


def _login_in(context: ServerRequestContext[Any, Any]) -> Login | None:
    return login_of(context.request)


def login_of(request: Any) -> Login | None:
    """Who asks; None over stdio, at a socket, and where no login is asked for."""
    scope = getattr(request, "scope", None)
    return scope.get(LOGIN) if scope else None


def login_name(scope: Mapping[str, Any]) -> str:
    """The name of the token of a request over HTTP; empty where no login is asked for."""
    login: Login | None = scope.get(LOGIN)
    return login.name if login else ""
