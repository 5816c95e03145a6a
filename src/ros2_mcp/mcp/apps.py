"""MCP Apps, an extension with which a chat host shows a server's page beside the chat.

The page is that of `ros2-mcp view`. A host reads it as a resource, shows it in a frame under a strict content policy,
and forwards the page's calls of tools that models do not see. See docs/decisions/0052-the-page-in-a-chat.md.
"""

from __future__ import annotations

import hashlib
from collections.abc import Awaitable, Callable, Sequence
from functools import cache
from typing import Any

from mcp.server.context import ServerRequestContext
from mcp.types import (
    ListResourcesResult,
    PaginatedRequestParams,
    ReadResourceRequestParams,
    ReadResourceResult,
    Resource,
    TextResourceContents,
    Tool,
)

from ros2_mcp.tools import PAGE_TOOLS, TOOLS
from ros2_mcp.view.page import page

Context = ServerRequestContext[Any, Any]
EXTENSION = "io.modelcontextprotocol/ui"
MIME_TYPE = "text/html;profile=mcp-app"
EXTENSIONS: dict[str, dict[str, Any]] = {EXTENSION: {"mimeTypes": [MIME_TYPE]}}
_URI = "ui://ros2-mcp/view-"
_DESCRIPTION = "What the agent sees and does, and a stop button: shown beside the chat by ros2_view."
_OPENING = {tool.name for tool in TOOLS if tool.opens_page}
_FOR_PAGE = {tool.name for tool in PAGE_TOOLS}


def shows_pages(context: Context) -> bool:
    """Return whether this client has declared support for such pages, in its handshake or with each request."""
    declared = context.session.client_capabilities
    settings = (declared.extensions or {}).get(EXTENSION) if declared else None
    mime_types = settings.get("mimeTypes") if settings else None
    return isinstance(mime_types, (list, tuple)) and MIME_TYPE in mime_types


def page_uri() -> str:
    """Return the URI of the page. It contains a hash of the page, because hosts cache what they have read."""
    return f"{_URI}{_hash()}.html"


@cache
def _hash() -> str:
    return hashlib.sha256(page().html).hexdigest()[:16]


def marked(tools: Sequence[Tool]) -> list[Tool]:
    """Return the tools with the visibility that such a client needs: the tool that opens the page, the tools that only
    the page calls, and the tools that the page must not call.

    A page may call any tool without a stated visibility, and some hosts do not ask their user about a page's calls.
    """
    return [tool.model_copy(update={"meta": {**(tool.meta or {}), **_mark(tool.name)}}) for tool in tools]


def _mark(name: str) -> dict[str, Any]:
    if name in _FOR_PAGE:
        return {"ui": {"visibility": ["app"]}}
    if name in _OPENING:  # the second form is for hosts that are older than the specification
        return {"ui": {"resourceUri": page_uri(), "visibility": ["model"]}, "ui/resourceUri": page_uri()}
    return {"ui": {"visibility": ["model"]}}


Listing = Callable[[Any, PaginatedRequestParams | None], Awaitable[ListResourcesResult]]
Reading = Callable[[Any, ReadResourceRequestParams], Awaitable[ReadResourceResult]]


class PageResource:
    """The page as one more resource. `listing` and `reading` answer for the other resources."""

    def __init__(self, listing: Listing, reading: Reading) -> None:
        self._listing, self._reading = listing, reading

    async def list(self, context: Context, params: PaginatedRequestParams | None) -> ListResourcesResult:
        """List the other resources and, for clients that show pages, the page."""
        found = await self._listing(context, params)
        if not shows_pages(context):
            return found
        row = Resource(
            uri=page_uri(), name="view", title="The live scene", description=_DESCRIPTION, mime_type=MIME_TYPE
        )
        return found.model_copy(update={"resources": [*found.resources, row]})

    async def read(self, context: Context, params: ReadResourceRequestParams) -> ReadResourceResult:
        """Read the page, also by the URI of an earlier version that a host has cached; or read one of the other
        resources.
        """
        uri = str(params.uri)
        if not uri.startswith(_URI):
            return await self._reading(context, params)
        text = page().html.decode("utf-8")
        return ReadResourceResult(contents=[TextResourceContents(uri=uri, text=text, mime_type=MIME_TYPE)])
