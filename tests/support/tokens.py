"""The token with which tests come in over HTTP: it lies in the state folder before a server starts."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from mcp import Client
from mcp.client.streamable_http import streamable_http_client
from mcp.shared._httpx_utils import create_mcp_http_client

TOKEN = "of-the-tests-0123456789-0123456789-0123456789"
BEARER = f"Bearer {TOKEN}"
HEADERS = {"Authorization": BEARER}


def leave_token(state_home: Path) -> None:
    """Leaves it where a server of that XDG_STATE_HOME finds its own."""
    (state_home / "ros2-mcp").mkdir(mode=0o700, parents=True)
    path = state_home / "ros2-mcp/http-token"
    path.touch(mode=0o600)
    path.write_text(TOKEN + "\n")


@asynccontextmanager
async def client_at(url: str, token: str = TOKEN, **options: Any) -> AsyncGenerator[Client, None]:
    """A client of the SDK's that has the token."""
    http: Any = create_mcp_http_client({"Authorization": f"Bearer {token}"})
    async with http, Client(streamable_http_client(url, http_client=http), **options) as client:
        yield client
