"""MCP over HTTP, guarded: only known Host and Origin headers, whatever address it listens on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcp.server.transport_security import TransportSecuritySettings

if TYPE_CHECKING:
    from mcp.server.mcpserver import MCPServer

    from ros2_mcp.settings import Settings


async def serve_http(server: MCPServer[None], settings: Settings) -> None:
    """Serves `/mcp` (streamable HTTP) or `/sse`, until cancelled."""
    guard = security(settings.host, settings.port)
    if settings.transport == "sse":
        await server.run_sse_async(host=settings.host, port=settings.port, transport_security=guard)
    else:
        await server.run_streamable_http_async(host=settings.host, port=settings.port, transport_security=guard)


def security(host: str, port: int) -> TransportSecuritySettings:
    """The headers that are accepted: this machine's own names and the address listened on."""
    named = ["127.0.0.1", "localhost", "[::1]"]
    if host not in (*named, "0.0.0.0", "::"):
        named.append(host)
    return TransportSecuritySettings(
        enable_dns_rebinding_protection=True,
        allowed_hosts=[f"{name}:{port}" for name in named],
        allowed_origins=[f"http://{name}:{port}" for name in named],
    )
