"""Clients of MCP over HTTP whose sockets the test commands: one JSON list per line in, one JSON value per line out.

They speak by hand, so that they can go in every way in which a program, a machine or a network goes. They answer no
pings. Times are CLOCK_MONOTONIC in ns.
"""

from __future__ import annotations

import http.client
import json
import os
import socket
import struct
import sys
import time
from typing import Any

MODERN, HANDSHAKE = "2026-07-28", "2025-11-25"
CLIENT = {"name": "sockets by hand", "version": "1"}
TOKEN = "of-the-tests-0123456789-0123456789-0123456789"
"""As in `support/tokens.py`, which would bring the SDK."""
STRUCTURED = "io.github.ros2-mcp/structured"
"""As in `ros2_mcp/mcp/server.py`: asks for structured content."""
PATIENCE_S = 30.0
AT_ONCE = struct.pack("ii", 1, 0)
"""For SO_LINGER: closing resets the connection."""


class Client:
    """One client, by `era`: `handshake` or `modern`."""

    def __init__(self, era: str, host: str, port: int, name: str) -> None:
        self.era, self.address, self.name = era, (host, port), name
        self.sockets: list[socket.socket] = []
        self.session, self.last_id = "", 0

    def begin(self, keeps_stream: bool) -> None:
        if self.era == "modern":
            if keeps_stream:
                self.answered(self.send("subscriptions/listen", notifications={}))
            return
        told = self.send("initialize", protocolVersion=HANDSHAKE, capabilities={}, clientInfo=CLIENT)
        response = self.answered(told)
        self.session = response.getheader("mcp-session-id", "")
        self.result(response)
        self.answered(self.post({"jsonrpc": "2.0", "method": "notifications/initialized"}))
        if keeps_stream:
            self.answered(self.request("GET", "/mcp", None, Accept="text/event-stream"))

    def send(self, method: str, **params: Any) -> http.client.HTTPConnection:
        self.last_id += 1
        if self.era == "modern":
            stamp = {"protocolVersion": MODERN, "clientInfo": {**CLIENT, "name": self.name}, "clientCapabilities": {}}
            params["_meta"] = {f"io.modelcontextprotocol/{name}": value for name, value in stamp.items()}
        if method == "tools/call":
            params["_meta"] = {**params.get("_meta", {}), STRUCTURED: True}
        return self.post({"jsonrpc": "2.0", "id": self.last_id, "method": method, "params": params})

    def post(self, message: dict[str, Any]) -> http.client.HTTPConnection:
        headers = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}
        if self.era == "modern":
            headers["Mcp-Method"] = message["method"]
            if name := message["params"].get("name"):
                headers["Mcp-Name"] = name
        return self.request("POST", "/mcp", json.dumps(message), **headers)

    def request(self, method: str, path: str, body: str | None, **headers: str) -> http.client.HTTPConnection:
        headers["Authorization"] = f"Bearer {TOKEN}"
        if self.session:
            headers["Mcp-Session-Id"] = self.session
        headers["Mcp-Protocol-Version"] = MODERN if self.era == "modern" else HANDSHAKE
        connection = http.client.HTTPConnection(*self.address, timeout=PATIENCE_S)
        connection.connect()
        self.sockets.append(connection.sock)
        connection.request(method, path, body, headers)
        return connection

    def answered(self, connection: http.client.HTTPConnection) -> http.client.HTTPResponse:
        response = connection.getresponse()
        assert response.status < 300, (response.status, response.read())
        return response

    def result(self, response: http.client.HTTPResponse) -> dict[str, Any]:
        """The answer to the last request: in the response, as JSON or as an event."""
        if response.getheader("content-type", "").startswith("application/json"):
            return json.loads(response.read())
        while True:
            answer = json.loads(_data(response))
            if answer.get("id") == self.last_id and "method" not in answer:
                return answer


class Clients:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        self.clients: dict[str, Client] = {}

    def join(self, name: str, era: str, host: str, port: int, keeps_stream: bool = True) -> None:
        """A client connects and introduces itself; it keeps a stream open for what the server may tell."""
        self.clients[name] = Client(era, host, port, name)
        self.clients[name].begin(keeps_stream)

    def call(self, name: str, tool: str, arguments: dict[str, Any]) -> dict[str, Any]:
        """Call a tool and wait for its result."""
        client = self.clients[name]
        return client.result(client.answered(client.send("tools/call", name=tool, arguments=arguments)))["result"]

    def begin(self, name: str, tool: str, arguments: dict[str, Any]) -> None:
        """Call a tool, and leave its response open."""
        self.clients[name].send("tools/call", name=tool, arguments=arguments)

    def go(self, name: str, resetting: bool) -> int:
        """Close or reset every connection of a client; when that was."""
        went = time.monotonic_ns()
        for connection in self.clients.pop(name).sockets:
            if resetting and connection.fileno() >= 0:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, AT_ONCE)
            if (descriptor := connection.detach()) >= 0:
                os.close(descriptor)  # whatever else refers to the socket
        return went

    def end_session(self, name: str) -> int:
        """Send DELETE, and leave the other connections open; when that was."""
        client = self.clients[name]
        went = time.monotonic_ns()
        client.answered(client.request("DELETE", "/mcp", None))
        return went


def _data(response: http.client.HTTPResponse) -> str:
    while line := response.readline():
        if line.startswith(b"data: "):
            return line.removeprefix(b"data: ").strip().decode()
    raise AssertionError("the stream ended")


def main() -> None:
    clients = Clients()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(clients, command)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
