"""Requests as no client should send them, and what must come back for each: exactly one answer, or none."""

from __future__ import annotations

import copy
import json
import random
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from support.raw_server import CLIENT, MODERN

PREFIX = "io.modelcontextprotocol/"
META = {f"{PREFIX}protocolVersion": MODERN, f"{PREFIX}clientInfo": CLIENT, f"{PREFIX}clientCapabilities": {}}
HANDSHAKE = "2025-11-25"
INITIALIZE = {"protocolVersion": HANDSHAKE, "capabilities": {}, "clientInfo": CLIENT}

ODD: Sequence[Any] = (
    *(
        None,
        True,
        False,
        0,
        -1,
        1.5,
        1e308,
        2**31,
        2**63,
        10**40,
        -(10**400),
        "",
        "x",
        "null",
        "0",
        "/scan",
        "é\u2028😀",
        "\0",
    ),
    *("\ud800", "a\udfffb", "\ud83d", [], {}, [[]], [{}], {"": ""}, {"name": None}, [None], ["a", 1, None]),
    *({"\udcff": 1}, "9" * 5000, "../../etc/passwd", "%s%n", {"id": 7, "method": "ping"}, [1] * 300),
)
"""Values that stand where others are expected; a half of a surrogate pair is no character, but JSON can write it."""
NUMBERS = ("NaN", "Infinity", "-Infinity", "1e999", "-0", "1E400", "01", "+1", "0x10", ".5", "1.", "1" * 6000)
"""Written as they are where a value is expected: some are JSON, some are not."""
IDS: Sequence[Any] = (1.5, True, None, [], {}, "", "\ud800", 2**70, -7, "é", {"a": 1}, [1], "7", 1e30)

METHODS = (
    *("tools/list", "tools/call", "prompts/list", "prompts/get", "resources/list", "resources/read", "ping"),
    *("resources/templates/list", "completion/complete", "initialize", "server/discover", "logging/setLevel"),
    *("resources/subscribe", "notifications/initialized", "notifications/cancelled", "tasks/get", "no/such", "", "é"),
)
_PADDING = b" " * 25_000
"""Before a line: what is larger than 20 kB takes another way through the server."""
_LARGE_SHARE = 0.1


@dataclass(frozen=True)
class Sent:
    """One line, and the ids under which an answer to it is right: `None` is `"id": null`. No ids: no answer."""

    line: bytes
    answers: frozenset[str | None]


class Fuzzer:
    """Makes requests, the same ones for the same seed."""

    def __init__(self, seed: int, tools: Sequence[dict[str, Any]] = (), *, version: str = HANDSHAKE) -> None:
        self._random = random.Random(seed)
        self._tools = tools
        self._version = version
        self._last_id = 10**6  # below are the ids of the test itself

    def requests(self, number: int) -> Iterator[Sent]:
        """So many lines."""
        damages: list[Callable[[dict[str, Any]], Sent]] = [
            *[self._valid] * 3,
            *[self._odd_inside] * 8,
            *[self._odd_id] * 2,
            *[self._odd_member] * 3,
            *[self._odd_text] * 3,
            *[self._damaged_bytes] * 2,
            *[self._batch, self._nested, self._odd_number, self._notification],
        ]
        for _ in range(number):
            sent = self._random.choice(damages)(self.request())
            yield Sent(_PADDING + sent.line, sent.answers) if self._random.random() < _LARGE_SHARE else sent

    def request(self) -> dict[str, Any]:
        """A request as it should be, or nearly."""
        self._last_id += 1
        method = self._random.choice(METHODS)
        if self._random.random() < 0.4:
            method = "tools/call"
        params: dict[str, Any] = self._params(method)
        if self._version == MODERN:
            params["_meta"] = copy.deepcopy(META)
        own_id = self._last_id if self._random.random() < 0.7 else f"request {self._last_id}"
        return {"jsonrpc": "2.0", "id": own_id, "method": method, "params": params}

    def _params(self, method: str) -> dict[str, Any]:
        choose = self._random.choice
        if method == "tools/call":
            tool = choose(self._tools)
            properties = tool["inputSchema"]["properties"]
            names = [name for name in properties if self._random.random() < 0.5]
            return {"name": tool["name"], "arguments": {name: self._value(properties[name]) for name in names}}
        if method == "initialize":
            return copy.deepcopy(INITIALIZE)
        if method == "prompts/get":
            return {"name": "base.ros2-topic-relay", "arguments": {"source_topic": "/scan"}}
        if method.startswith("resources/"):
            return {"uri": choose(("ros2://graph", "file:///etc/passwd", "ros2://topic//scan", "x", ""))}
        if method == "completion/complete":
            ref = choose(({"type": "ref/prompt", "name": "base.ros2-topic-relay"}, {"type": "ref/x"}, {}))
            return {"ref": ref, "argument": {"name": "source_topic", "value": "/s"}}
        return {}

    def _value(self, schema: dict[str, Any]) -> Any:
        """Something of the right type, mostly."""
        if self._random.random() < 0.3:
            return self._odd()
        fitting = {"string": "/odom", "integer": 1, "number": 0.01, "boolean": True, "array": ["/odom"], "object": {}}
        return fitting.get(schema.get("type", ""), "x")

    def _odd(self) -> Any:
        return copy.deepcopy(self._random.choice(ODD))

    # ── damages ────────────────────────────────────────────────────────────────────────────────────────────────

    def _valid(self, request: dict[str, Any]) -> Sent:
        return _sent(request)

    def _odd_inside(self, request: dict[str, Any]) -> Sent:
        """A value somewhere in the parameters, or all of them, is replaced, removed or added."""
        place = self._random.choice(list(_places(request["params"])) or [()])
        _put(request, ("params", *place), self._odd())
        return _sent(request)

    def _odd_id(self, request: dict[str, Any]) -> Sent:
        request["id"] = self._random.choice(IDS)
        return _sent(request)

    def _odd_member(self, request: dict[str, Any]) -> Sent:
        name = self._random.choice(("jsonrpc", "method", "params", "extra", "result", "error"))
        if self._random.random() < 0.3:
            request.pop(name, None)
        else:
            request[name] = self._odd()
        return _sent(request)

    def _odd_text(self, request: dict[str, Any]) -> Sent:
        """Half a surrogate pair, written as JSON does, in a text or a name of the parameters."""
        request["params"][self._random.choice(("name", "cursor", "\ud912", "uri"))] = f"a{chr(0xD800 + 7)}b"
        return _sent(request)

    def _damaged_bytes(self, request: dict[str, Any]) -> Sent:
        """Some bytes are others, or the end is missing; what is no JSON any more is answered with its id or null."""
        line = bytearray(json.dumps(request).encode())
        if self._random.random() < 0.3:
            del line[self._random.randrange(1, len(line)) :]
        else:
            for _ in range(self._random.randint(1, 3)):
                line[self._random.randrange(len(line))] = self._random.choice(b'\xff\xc3"{}[],:\\ \t0x\x00\x7f')
        return _sent_bytes(bytes(line), request["id"])

    def _batch(self, request: dict[str, Any]) -> Sent:
        return Sent(_line([request]), frozenset([_key(request["id"])]))

    def _nested(self, request: dict[str, Any]) -> Sent:
        """Deeper than any parser goes, or nearly."""
        depth = self._random.choice((50, 190, 210, 900, 5000))
        inner = "[" * depth + "]" * depth if self._random.random() < 0.5 else '{"a":' * depth + "1" + "}" * depth
        request["params"]["arguments"] = "HERE"
        line = json.dumps(request).replace('"HERE"', inner).encode()
        return Sent(line + b"\n", frozenset([_key(request["id"])]))

    def _odd_number(self, request: dict[str, Any]) -> Sent:
        request["params"]["arguments"] = {"duration": "HERE"}
        line = json.dumps(request).replace('"HERE"', self._random.choice(NUMBERS)).encode()
        return Sent(line + b"\n", frozenset([_key(request["id"])]))

    def _notification(self, request: dict[str, Any]) -> Sent:
        """No id, so no answer."""
        del request["id"]
        request["method"] = self._random.choice(("notifications/initialized", "notifications/progress", "x"))
        return Sent(_line(request), frozenset())


def balance(sent: Sequence[Sent], answered: Counter[str | None]) -> tuple[int, list[Sent]]:
    """How many lines have more or fewer answers than one, and up to ten of them.

    Answers are given to the lines that only they can belong to first, so that one with `"id": null` is not missed.
    """
    left = Counter(answered)
    unanswered: list[Sent] = []
    for each in sorted(sent, key=lambda each: (len(each.answers), None in each.answers)):
        if not each.answers:
            continue
        found = next((key for key in sorted(each.answers, key=str) if left[key] > 0), "")
        if found == "":
            unanswered.append(each)
        else:
            left[found] -= 1
    return len(unanswered) + sum(left.values()), unanswered[:10]


def key_of(answer: dict[str, Any]) -> str | None:
    """What an answer answers."""
    return _key(answer["id"])


def _key(own_id: Any) -> str | None:
    return None if own_id is None else json.dumps(own_id)


def _line(message: Any) -> bytes:
    return json.dumps(message).encode() + b"\n"


def _sent(request: dict[str, Any]) -> Sent:
    """A request that is JSON: it is answered with its id, or with null where that can be no id."""
    if "method" not in request and ("result" in request or "error" in request):
        return Sent(_line(request), frozenset())  # no request
    own_id = request.get("id")
    is_id = isinstance(own_id, (int, float, str)) and not isinstance(own_id, bool)
    if is_id and isinstance(own_id, str):
        is_id = not any("\ud800" <= character <= "\udfff" for character in own_id)
    return Sent(_line(request), frozenset([_key(own_id) if is_id else None]))


def _sent_bytes(line: bytes, own_id: Any) -> Sent:
    line = line.replace(b"\n", b" ")
    try:
        whole = json.loads(line)
    except ValueError:
        found = re.search(rb'"id": ?(-?\d+|"(?:[^"\\]|\\.)*")', line)  # it may have been damaged as well
        with suppress(ValueError):
            return Sent(line + b"\n", frozenset([None, _key(own_id), *([_key(json.loads(found[1]))] if found else [])]))
        return Sent(line + b"\n", frozenset([None, _key(own_id)]))
    if not isinstance(whole, dict):
        return Sent(line + b"\n", frozenset([None]))
    if "id" not in whole and isinstance(whole.get("method"), str):
        return Sent(line + b"\n", frozenset())
    return Sent(line + b"\n", _sent(whole).answers)


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    if isinstance(value, dict):
        for name, below in value.items():
            yield from _places(below, (*path, name))
    elif isinstance(value, list):
        for index, below in enumerate(value):
            yield from _places(below, (*path, index))


def _put(value: Any, path: tuple[Any, ...], odd: Any) -> None:
    for part in path[:-1]:
        value = value[part]
    value[path[-1]] = odd
