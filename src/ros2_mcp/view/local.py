"""Serve the page on this machine: a small HTTP application for one browser; requests need a token.

The browser receives the token in the fragment of the address, which is never sent, and returns it in a header of each
POST. There is no cookie (cookies ignore ports) and no header for other origins. The page itself contains no data and is
the same for every client, so it needs no token. See docs/decisions/0051-the-page.md.
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Awaitable, Callable, Mapping
from typing import TYPE_CHECKING, Any, cast

from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.finite import finite
from ros2_mcp.view.page import page
from ros2_mcp.view.views import Views, update_request

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send

TOKEN_HEADER = b"x-ros2-mcp-token"
_MOST_BYTES = 20_000
"""Bytes of a request; requests of the page have some hundred."""
_HEADERS: Mapping[bytes, bytes] = {
    b"cache-control": b"no-store",
    b"referrer-policy": b"no-referrer",
    b"x-content-type-options": b"nosniff",
    b"x-frame-options": b"DENY",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
}

Answer = tuple[int, bytes, Mapping[bytes, bytes]]


class LocalPage:
    """The ASGI application. `port` is that of its listening socket on 127.0.0.1."""

    def __init__(self, views: Views, token: str, port: int) -> None:
        self._views = views
        self._token = token.encode("ascii")
        self._hosts = {f"127.0.0.1:{port}".encode("ascii"), f"localhost:{port}".encode("ascii")}
        self._calls: Mapping[str, Callable[[Mapping[str, Any]], Awaitable[Mapping[str, Any]]]] = {
            "ros2_view_frame": lambda arguments: views.update(update_request(arguments)),
            "ros2_view_ask": views.answer,
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        status, body, headers = await self._answer(scope, receive)
        given = {**_HEADERS, **headers, b"content-length": str(len(body)).encode("ascii")}
        await send({"type": "http.response.start", "status": status, "headers": list(given.items())})
        await send({"type": "http.response.body", "body": body})

    async def _answer(self, scope: Scope, receive: Receive) -> Answer:
        headers: list[tuple[bytes, bytes]] = scope["headers"]
        given = {name: [value for key, value in headers if key == name] for name, _ in headers}
        host = given.get(b"host", [])
        if len(host) != 1 or host[0] not in self._hosts:  # a foreign name that resolves to this address (DNS rebinding)
            return _text(421, "This address is not served here.")
        origin = given.get(b"origin", [])
        if origin and origin != [b"http://" + host[0]]:
            return _text(403, "Requests from other pages are refused.")
        method, path = scope["method"], scope["path"]
        if method == "GET" and path == "/":
            policy = {b"content-security-policy": page().policy.encode("ascii")}
            return 200, page().html, {b"content-type": b"text/html; charset=utf-8", **policy}
        if path not in ("/call", "/stop"):
            return _text(404, "Not found.")
        if method != "POST":
            return _text(405, "Use POST.")
        shown = given.get(TOKEN_HEADER, [])
        if len(shown) != 1 or not hmac.compare_digest(shown[0], self._token):
            return _text(401, "Use the address with its token, as ros2-mcp view printed it.")
        if not origin or given.get(b"content-type") != [b"application/json"]:  # an HTML form can send neither
            return _text(403, "Only the page asks.")
        return await self._asked(path, receive)

    async def _asked(self, path: str, receive: Receive) -> Answer:
        body = await _body(receive)
        if body is None:
            return _text(413, "The request is too large.")
        if path == "/stop":  # the body does not matter
            return _json(200, await self._views.stop())
        try:
            asked: Any = json.loads(body)
        except (ValueError, RecursionError):
            return _text(400, "This is no JSON.")
        if not isinstance(asked, dict):
            return _text(400, "This is not a call.")
        fields = cast("Mapping[str, Any]", asked)
        arguments, call = fields.get("arguments"), self._calls.get(str(fields.get("name")))
        if call is None or not isinstance(arguments, dict):
            return _text(404, "There is no such call.")
        try:
            return _json(200, await call(cast("Mapping[str, Any]", arguments)))
        except NotFound as error:
            return _json(404, {"error": str(error)})
        except RobotError as error:
            return _json(400, {"error": str(error)})


async def _body(receive: Receive) -> bytes | None:
    """Return the body; None if it is too large."""
    body = bytearray()
    while True:
        message = await receive()
        body += message.get("body", b"")
        if len(body) > _MOST_BYTES:
            return None
        if message["type"] == "http.disconnect" or not message.get("more_body"):
            return bytes(body)


def _text(status: int, text: str) -> Answer:
    return status, text.encode(), {b"content-type": b"text/plain; charset=utf-8"}


def _json(status: int, value: Mapping[str, Any]) -> Answer:
    try:
        text = json.dumps(value, allow_nan=False)
    except ValueError:  # a non-finite number, which JSON does not have
        text = json.dumps(finite(value))
    return status, text.encode(), {b"content-type": b"application/json"}
