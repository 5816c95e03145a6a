"""Who asks the robot for something, and what."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Principal:
    """Who asks: one for stdio, one for each session or token over HTTP, and the server itself.

    `transport` is that of MCP by which it came: `stdio` or `http`; `server` for what the server does of its own.
    """

    name: str
    transport: str


SERVER = Principal(name="server", transport="server")
"""The server itself, such as for its black box."""
LOCAL = Principal(name="local", transport="stdio")
"""The one client of a server over stdio."""
