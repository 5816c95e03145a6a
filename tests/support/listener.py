"""A raw client of either era that is told of changes, and keeps when."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

from support.raw_server import MODERN, RawServer

HANDSHAKE = "2025-11-25"
UPDATED = "notifications/resources/updated"
PATIENCE_S = 40.0
"""Also for the start of a bridge, on a busy machine."""


class Listener(RawServer):
    """Lines by hand; `updates` are the pushes so far: URI and moment of arrival."""

    def __init__(self, environment: dict[str, str], *options: str) -> None:
        super().__init__(environment, *options)
        self.updates: list[tuple[str, float]] = []
        self._seen = 0
        self._listening: dict[str, int] = {}

    def subscribe(self, uri: str) -> None:
        """Ask for pushes in the way of the era; returns when the server has agreed."""
        if self.version != MODERN:
            assert "result" in self.ask("resources/subscribe", uri=uri)
            return
        request = self.send("subscriptions/listen", notifications={"resourceSubscriptions": [uri]})
        self._listening[uri] = request
        acknowledged = self.wait_for_line("notifications/subscriptions/acknowledged", request)
        assert acknowledged["params"]["notifications"] == {"resourceSubscriptions": [uri]}

    def unsubscribe(self, uri: str) -> None:
        """End it in the way of the era."""
        if self.version != MODERN:
            assert "result" in self.ask("resources/unsubscribe", uri=uri)
        else:
            self.tell("notifications/cancelled", requestId=self._listening.pop(uri))

    def read(self, uri: str) -> dict[str, Any]:
        """The JSON of a resource."""
        answer = self.ask("resources/read", uri=uri)
        assert "result" in answer, answer
        return json.loads(answer["result"]["contents"][0]["text"])

    def update(self, uri: str, after: float) -> float:
        """The moment of the first push of the URI that came after a moment."""
        moment = self._told(uri, after, PATIENCE_S)
        assert moment, f"no push of {uri} within {PATIENCE_S} s; came: {self.updates}"
        return moment

    def watch(self, uri: str, event: Callable[[], float]) -> None:
        """Subscribe, and have it happen until it is told."""
        self.subscribe(uri)
        self.until_told(uri, event)

    def until_told(self, uri: str, event: Callable[[], float]) -> None:
        """Have it happen until it is told: nothing is, as long as the server and the robot have not met."""
        end = time.monotonic() + PATIENCE_S
        if self._told(uri, event(), 1.0):
            return
        while not self._told(uri, event(), 1.0):
            assert time.monotonic() < end, f"no push of {uri} within {PATIENCE_S} s"
        self.calm()

    def calm(self) -> None:
        """Returns when what has happened so far has been told: each time that it happens may be told of, late."""
        end = time.monotonic() + PATIENCE_S
        told = -1
        while told < len(self.updates):
            assert time.monotonic() < end, "something happens all the time"
            told = len(self.updates)
            self.drain(0.5)
            self.call("ros2_status")  # goes through the server and its bridge

    def drain(self, seconds: float) -> list[str]:
        """The URIs pushed during a time; all that have come are read, also if no time is given."""
        before, end = len(self.updates), time.monotonic() + seconds
        while self._listen(max(end - time.monotonic(), 0.0)) or time.monotonic() < end:
            pass
        return [uri for uri, _ in self.updates[before:]]

    def wait_for_line(self, method: str, request: int, within_s: float = PATIENCE_S) -> dict[str, Any]:
        """A notification that belongs to a request."""
        end = time.monotonic() + within_s
        while True:
            for line in self.lines():
                stamp = line.get("params", {}).get("_meta", {}) if line.get("method") == method else {}
                if stamp.get("io.modelcontextprotocol/subscriptionId") == request:
                    return line
            left = end - time.monotonic()
            assert left > 0 and self._listen(left), f"no {method}: {self.said[-500:]!r}"

    def _told(self, uri: str, after: float, within_s: float) -> float | None:
        while True:
            for told, moment in self.updates:
                if told == uri and moment >= after:
                    return moment
            left = after + within_s - time.monotonic()
            if left <= 0 or not self._listen(left):
                return None

    def _listen(self, seconds: float) -> bool:
        heard = super()._listen(seconds)
        moment = time.monotonic()
        whole = self.said.rfind(b"\n") + 1
        for line in self.said[self._seen : whole].splitlines():
            message = json.loads(line)
            if message.get("method") == UPDATED:
                self.updates.append((message["params"]["uri"], moment))
        self._seen = whole
        return heard
