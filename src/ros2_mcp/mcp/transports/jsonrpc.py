"""Parsing of client messages. A message that cannot be read gives refusals, so that no client waits for ever for an
answer.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any, cast

from mcp.types import INVALID_PARAMS, INVALID_REQUEST, PARSE_ERROR, JSONRPCMessage, JSONRPCNotification
from mcp_types import jsonrpc_message_adapter
from pydantic import ValidationError

from ros2_mcp.model.aside import LARGE
from ros2_mcp.model.text import is_unicode, visible

RequestId = str | int | float | None

_SCANNED = re.compile(r'"(?:[^"\\]|\\.)*"?|[{}\[\]:]|-?\d[\d.eE+-]*|[^\s,]', re.DOTALL)
"""As much of JSON's grammar as finds the members of the outermost object in damaged text. It never backtracks."""
_ESCAPES = re.compile(rb"\\(?:u[dD][89abAB]..\\u[dD][c-fC-F]|(u[dD][89a-fA-F])|.)", re.DOTALL)
"""The escapes of JSON from left to right. The group matches an unpaired surrogate, which is not a character."""
_VALUE_ENDS = re.compile(r"\s*[,}]")
"""What may follow a value that is complete."""
_RESPONSE = ("result", "error")


@dataclass(frozen=True, slots=True)
class Refusal:
    """The answer to a request that cannot be read: with its id if that can be read, else with null, as in JSON-RPC."""

    id: RequestId
    code: int
    message: str

    @property
    def answer(self) -> dict[str, Any]:
        """The refusal as JSON-RPC."""
        return {"jsonrpc": "2.0", "id": self.id, "error": {"code": self.code, "message": visible(self.message)}}


def read_message(data: bytes) -> JSONRPCMessage | list[Refusal]:
    """Return the message, or the refusals to send if it cannot be read: an empty list if it needs no answer."""
    if len(data) > LARGE and any(escape[1] for escape in _ESCAPES.finditer(data)):
        return _refusals(data, "Invalid JSON: half a surrogate pair is no character")  # Python's parser would accept it
    try:
        message = _parsed(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        return _refusals(data, first["msg"] if first["type"] == "json_invalid" else "")
    # The SDK would take a request with an invalid id for a notification, and never answer it.
    if isinstance(message, JSONRPCNotification) and "id" in (members := _loads(data)):
        return [_refusal(members)]
    return message


def _parsed(data: bytes) -> JSONRPCMessage:
    """Parse a message. Raises `ValidationError`.

    pydantic blocks all other threads until it is done, 0.1 s for a megabyte. Large messages are parsed by Python's own
    parser instead, which lets other threads run whenever it calls Python code, which is after each object.
    """
    if len(data) > LARGE:
        try:
            value = _loads(data)
        except (ValueError, RecursionError):
            pass  # pydantic gives the error
        else:
            return jsonrpc_message_adapter.validate_python(value, by_name=False)
    return jsonrpc_message_adapter.validate_json(data, by_name=False)


def _loads(data: bytes) -> Any:
    """Parse JSON in UTF-8, the only encoding allowed. Raises `ValueError` or `RecursionError`."""
    return json.loads(data.decode(), object_hook=lambda members: members)


def _refusals(data: bytes, why: str) -> list[Refusal]:
    """Return the refusals of something that is not a message. `why` is the parser's reason, if it gave one."""
    try:
        whole = _loads(data)
    except (ValueError, RecursionError):
        members = _members(data.decode(errors="surrogateescape"))
        own_id = _id_of(members)
        if _is_response(members):
            return []
        return [Refusal(own_id, PARSE_ERROR if own_id is None else INVALID_REQUEST, why or "Invalid JSON")]
    if isinstance(whole, list) and whole:
        return [
            Refusal(_id_of(one), INVALID_REQUEST, "A list of messages is not accepted: send each message by itself")
            for one in cast("list[Any]", whole)
            if not _asks_nothing(one)
        ]
    return [] if _asks_nothing(whole) else [_refusal(whole, why)]


def _asks_nothing(message: Any) -> bool:
    """Return whether a message needs no answer: a response or a notification, even if damaged."""
    if not isinstance(message, dict):
        return False
    return _is_response(message) or ("id" not in message and isinstance(message.get("method"), str))  # pyright: ignore


def _is_response(members: dict[str, Any]) -> bool:
    return "method" not in members and any(name in members for name in _RESPONSE)


def _refusal(message: Any, why: str = "") -> Refusal:
    """Return the refusal of JSON that is not a message. `why` is the parser's reason, if it gave one."""
    if not isinstance(message, dict):
        return Refusal(None, INVALID_REQUEST, "A message must be an object")
    members = cast("dict[str, Any]", message)
    own_id = _id_of(members)
    if why:
        return Refusal(own_id, INVALID_REQUEST, why)
    if members.get("jsonrpc") != "2.0":
        return Refusal(own_id, INVALID_REQUEST, 'A message must have "jsonrpc": "2.0"')
    if not isinstance(members.get("method"), str):
        return Refusal(own_id, INVALID_REQUEST, "The method of a request must be a string")
    if not isinstance(members.get("params", {}), dict):
        return Refusal(own_id, INVALID_PARAMS, "params must be an object")
    return Refusal(own_id, INVALID_REQUEST, "The id of a request must be a string or an integer")


def _id_of(message: Any) -> RequestId:
    """Return the id to answer with; None if there is none that JSON-RPC allows."""
    own_id = cast("dict[str, Any]", message).get("id") if isinstance(message, dict) else None
    if isinstance(own_id, str):
        return own_id if is_unicode(own_id) else None  # clients could not read an unpaired surrogate
    if isinstance(own_id, bool) or not isinstance(own_id, (int, float)):
        return None
    return own_id if math.isfinite(own_id) else None


def _members(text: str) -> dict[str, Any]:
    """Return the members of the outermost object in damaged JSON: the values of texts and numbers, None for others."""
    depth, name, last = 0, "", ""
    members: dict[str, Any] = {}
    for match in _SCANNED.finditer(text):
        word = match[0]
        if word == ":":
            name = last if depth == 1 and last.startswith('"') else ""
            if name:
                members[name[1:-1]] = None
        elif word in "{[":
            depth, name = depth + 1, ""
        elif word in "}]":
            depth, name = depth - 1, ""
        elif name:
            members[name[1:-1]] = _value(word) if _VALUE_ENDS.match(text, match.end()) else None
            name = ""
        last = word
    return members


def _value(word: str) -> Any:
    try:
        return json.loads(word)
    except ValueError:
        return None
