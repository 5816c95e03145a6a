"""A scripted model: an HTTP server on loopback that answers a coding agent's requests with the turns of a script.

It is no model. Which turn is due, it counts from the results that the conversation already has, so that repeated
requests and those about something else (titles, summaries) do no harm.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from support.clients.messages import Messages
from support.clients.responses import Responses
from support.clients.script import Call, Interface, NamedCall, Request, ShownResult, call_id, turns_done

Turn = str | Sequence[Call]
INTERFACES: dict[str, Interface] = {"/messages": Messages(), "/responses": Responses()}
"""By the end of the path that a client posts to."""
WAITS = 90
"""So often a call that only waits is made; each takes `WAIT_S`."""
WAIT_S = 0.5


class ScriptedModel:
    """What the model is asked and answers.

    `waiting` gives the call that is made as long as the client does not offer a tool that is due: clients begin before
    the server has started, and some offer no tool until the model has searched for it. It is told the tools of the
    whole script.
    """

    def __init__(self, turns: Sequence[Turn], waiting: Callable[[list[str]], Call]) -> None:
        self.turns = [*turns, "Done."]
        self.requests: list[Request] = []
        self._waiting = waiting
        self._lock = threading.Lock()

    @property
    def agent_requests(self) -> list[Request]:
        """Those that offer tools: the conversation itself."""
        return [request for request in self.requests if request.tools]

    def results(self) -> list[list[ShownResult]]:
        """For each turn that had results, what the model was shown of its calls, in their order."""
        shown: dict[str, ShownResult] = {}
        for request in self.requests:
            shown |= request.results
        turns = range(turns_done(shown))
        return [
            [shown[name] for number in range(len(self.turns[turn])) if (name := call_id(turn, number)) in shown]
            for turn in turns
        ]

    def answer(self, interface: Interface, body: dict[str, Any]) -> list[dict[str, Any]]:
        """The events of the answer to a request, which is kept."""
        request = Request(time.monotonic(), body, interface.tools(body), interface.results(body))
        with self._lock:
            self.requests.append(request)
        if not request.tools:
            return interface.events(body, "ok", [])
        due = turns_done(request.results)
        turn = self.turns[min(due, len(self.turns) - 1)]
        if isinstance(turn, str):
            return interface.events(body, turn, [])
        calls = [_named(request, call, call_id(due, number)) for number, call in enumerate(turn)]
        there = [call for call in calls if call]
        if len(there) == len(calls):
            return interface.events(body, "", there)
        waits = sum(name.startswith("wait_") for name in request.results)
        if waits >= WAITS:
            return interface.events(body, "The tools never came.", [])
        if waits:
            time.sleep(WAIT_S)
        wanted = sorted(
            {call.tool for turn in self.turns if not isinstance(turn, str) for call in turn if not call.own}
        )
        wait = _named(request, self._waiting(wanted), f"wait_{waits}")
        assert wait, [tool.name for tool in request.tools]
        return interface.events(body, "", [wait])


def _named(request: Request, call: Call, identity: str) -> NamedCall | None:
    """The call by the client's name for the tool; nothing if the request does not offer it."""
    if call.own:
        return NamedCall(identity, call.tool, "", call.arguments)
    tool = request.tool(call.tool)
    return tool and NamedCall(identity, tool.name, tool.namespace, call.arguments)


@contextmanager
def serving(model: ScriptedModel) -> Iterator[str]:
    """The model's address, for the time of a block."""

    class Answers(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, format: str, *_: object) -> None:  # noqa: A002 - the name in http.server
            pass

        def do_HEAD(self) -> None:
            self._json({})

        def do_GET(self) -> None:
            self._json({"object": "list", "data": [], "models": [], "has_more": False})

        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["content-length"])) or b"{}")
            path = self.path.partition("?")[0]
            interface = next((found for end, found in INTERFACES.items() if path.endswith(end)), None)
            with suppress(BrokenPipeError, ConnectionResetError):  # the client has ended
                if interface:
                    self._stream(model.answer(interface, body))
                else:  # count_tokens, or what is only told
                    self._json({"input_tokens": 1000})

        def _json(self, value: object) -> None:
            data = json.dumps(value).encode()
            self.send_response(200)
            self.send_header("content-type", "application/json")
            self.send_header("content-length", str(len(data)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(data)

        def _stream(self, events: list[dict[str, Any]]) -> None:
            self.send_response(200)
            self.send_header("content-type", "text/event-stream")
            self.send_header("connection", "close")
            self.end_headers()
            for event in events:
                self.wfile.write(f"event: {event['type']}\ndata: {json.dumps(event)}\n\n".encode())
            self.close_connection = True

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
