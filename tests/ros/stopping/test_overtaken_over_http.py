"""Over HTTP nothing large that was posted before a stop, or before it was cancelled, moves the robot after that."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from http.client import HTTPConnection
from typing import Any

import pytest

from support.agent import DISCOVERY_S, until
from support.driver import MOVING, fresh
from support.observer import Observer
from support.ports import listening
from support.structured import META
from support.tokens import BEARER
from support.velocities import TWIST, speed

PATIENCE_S = 60.0
VERSION = "2025-11-25"
CLIENT = {"name": "posts by hand", "version": "1"}
HEADERS = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json", "Authorization": BEARER}
SLOW = json.dumps({"x": [{str(number): 0} for number in range(49_000)]})
"""0.7 MB that take 15 to 50 ms to read, with nearly as many objects as a request may have; written once, so that it is
posted sooner than it is read.
"""
SEVERAL = 64
"""So many of them are read for longer than a stop takes to come: what is posted after them waits."""
PADDING = " " * 25_000
"""What is larger than 20 kB is not read at once."""
JUDGED_S = 200.0
"""A round takes seconds, on a busy machine 20; one is not judged where this process was held up in it."""

pytestmark = pytest.mark.timeout(400)


class Session:
    """One session; each request has a connection of its own."""

    def __init__(self, port: int, closing_all: ExitStack) -> None:
        self._port, self._closing, self._id, self._names = port, closing_all, 0, dict(HEADERS)
        begun = self.begin("initialize", {"protocolVersion": VERSION, "capabilities": {}, "clientInfo": CLIENT})
        answer = begun[1].getresponse()
        self._names["Mcp-Session-Id"] = answer.headers["Mcp-Session-Id"]
        answer.read()
        self.tell("notifications/initialized", {})

    def begin(self, method: str, params: dict[str, Any], padding: str = "") -> tuple[int, HTTPConnection]:
        """Posts a request."""
        return self.begin_written(method, json.dumps(params), padding)

    def begin_written(self, method: str, params: str, padding: str = "") -> tuple[int, HTTPConnection]:
        """Posts a request whose parameters are JSON already."""
        self._id += 1
        body = f'{padding}{{"jsonrpc": "2.0", "id": {self._id}, "method": "{method}", "params": {params}}}'
        return self._id, self._post(body)

    def tell(self, method: str, params: dict[str, Any]) -> None:
        """A notification, accepted."""
        answer = self._post(json.dumps({"jsonrpc": "2.0", "method": method, "params": params})).getresponse()
        answer.read()
        assert answer.status == 202

    def call(self, name: str, *, padding: str = "", **arguments: Any) -> tuple[int, HTTPConnection]:
        """Posts a call of a tool."""
        return self.begin("tools/call", {"name": name, "arguments": arguments, "_meta": META}, padding)

    def has_come(self) -> None:
        """Waits until the server has received what was posted before: it has answered something that came later."""
        said(self.begin("ping", {}))

    def _post(self, body: str) -> HTTPConnection:
        connection = self._closing.enter_context(closing(HTTPConnection("127.0.0.1", self._port, timeout=PATIENCE_S)))
        connection.request("POST", "/mcp", body, self._names)
        return connection


def said(begun: tuple[int, HTTPConnection]) -> str:
    """What is answered."""
    return begun[1].getresponse().read().decode()


def hung_up(begun: list[tuple[int, HTTPConnection]], answer: str) -> bool:
    """Ends connections after a round that is not judged, since a server takes 256; tells what was answered too soon."""
    for _, connection in begun:
        connection.close()
    print("it had been read before:", answer)
    return True


@pytest.fixture(scope="module")
def session(ros_environment: dict[str, str]) -> Iterator[Session]:
    with listening(ros_environment, "streamable-http") as (port, _), ExitStack() as stack:
        yield Session(port, stack)


@pytest.fixture
def watched(session: Session, observer: Observer) -> str:
    """A topic with four subscribers that the server knows, and has published on."""
    topic = fresh("watched")
    observer.watch(topic)
    until(lambda: said(session.call("ros2_topic_info", topic_name=topic)).count("best_effort") >= 1, DISCOVERY_S)
    assert '"status":"published"' in said(publish(session, topic))
    session_stop(session)
    observer.forget()
    return topic


def publish(session: Session, topic: str, value: float = MOVING, **more: Any) -> tuple[int, HTTPConnection]:
    return session.call("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, value), **more)


def has_come(session: Session, observer: Observer, topic: str) -> None:
    """Waits until what the server sent before has come: a zero has, which it publishes now."""
    since_ns = time.time_ns()
    assert '"status":"published"' in said(publish(session, topic, 0.0))
    until(lambda: not observer.behind(topic=topic, since=since_ns))


def session_stop(session: Session) -> int:
    """Stops; returns when the answer was read (CLOCK_MONOTONIC, ns)."""
    assert 'isError":true' not in said(session.call("ros2_stop"))
    return time.monotonic_ns()


@pytest.fixture
def behind(session: Session) -> Callable[[], list[tuple[int, HTTPConnection]]]:
    """Begins what is read for long."""
    return lambda: [session.begin_written("ping", SLOW) for _ in range(SEVERAL)]


def test_a_stop_drops_what_was_posted_before_it_and_is_still_being_read(session, observer, watched, behind) -> None:
    def is_dropped() -> bool:
        """Not so where it had been read before the stop came: then this round judges only that nothing follows it."""
        slow = behind()
        late = publish(session, watched, padding=PADDING)
        session.has_come()
        answered_ns = session_stop(session)
        answer = said(late)
        assert all('"result":{}' in said(one) for one in slow)
        has_come(session, observer, watched)
        assert observer.moved(sent_after=answered_ns, topic=watched) == []
        return "Stopped: " in answer or not hung_up(slow, answer)

    until(is_dropped, JUDGED_S)
    assert '"status":"published"' in said(publish(session, watched, padding=PADDING))
    session_stop(session)


def test_what_is_cancelled_while_it_is_still_being_read_is_not_done(session, observer, watched, behind) -> None:
    def is_not_done() -> bool:
        """Not judged where it had been read, and moved the robot, before it was cancelled."""
        slow = behind()
        begun_ns = time.monotonic_ns()  # what was published before may be heard only now
        late = publish(session, watched, frequency=20, duration=2, padding=PADDING)
        session.has_come()
        session.tell("notifications/cancelled", {"requestId": late[0]})
        answer, answered_ns = said(late), time.monotonic_ns()
        assert all('"result":{}' in said(one) for one in slow)
        has_come(session, observer, watched)
        moved = observer.moved(sent_after=begun_ns, topic=watched)
        if any(one["sent"] < answered_ns for one in moved):  # a server that always does so never passes
            return not hung_up(slow, answer)
        assert "Request cancelled" in answer
        assert moved == []
        return True

    until(is_not_done, JUDGED_S)
