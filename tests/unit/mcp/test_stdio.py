"""MCP over two file descriptors: whole messages come and go, whatever they are and however slowly they are taken."""

from __future__ import annotations

import asyncio
import json
import os
import threading
from pathlib import Path
from typing import Any

from mcp.server.lowlevel import Server
from mcp.types import ListToolsResult, Tool

from ros2_mcp.mcp.transports.stdio import serve_stdio

LONG = "é" * 100_000
"""Longer than what a pipe holds."""


async def _tools(_: Any, __: Any) -> ListToolsResult:
    return ListToolsResult(tools=[Tool(name="long", description=LONG, input_schema={"type": "object"})])


def _lines() -> bytes:
    me = {"name": "test", "version": "1"}
    parameters = {"protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": me}
    asked = [
        {"id": 1, "method": "initialize", "params": parameters},
        {"method": "notifications/initialized"},
        {"id": 2, "method": "ping", "params": {"_meta": {"long": LONG}}},
        {"id": 3, "method": "tools/list"},
        {"id": 4, "method": "tools/list"},
    ]
    return b"\n".join(json.dumps({"jsonrpc": "2.0", **one}, ensure_ascii=False).encode() + b"\n" for one in asked)


def test_every_request_is_answered_whole_however_it_comes_and_is_read() -> None:
    (read_fd, client_fd), (answers_fd, write_fd) = os.pipe(), os.pipe()
    answers: dict[int, Any] = {}

    def send() -> None:
        lines = _lines()
        for at in range(0, len(lines), 3001):
            os.write(client_fd, lines[at : at + 3001])

    def read() -> None:
        with os.fdopen(answers_fd, "rb", buffering=3001) as lines:
            while len(answers) < 4:
                answer = json.loads(lines.readline())
                answers[answer["id"]] = answer["result"]
        os.close(client_fd)

    threads = [threading.Thread(target=work) for work in (send, read)]
    for thread in threads:
        thread.start()
    asyncio.run(serve_stdio(Server("test", on_list_tools=_tools), read_fd, write_fd))
    for thread in threads:
        thread.join()
    assert all(answers[number]["tools"][0]["description"] == LONG for number in (3, 4))
    for fd in (read_fd, write_fd):
        os.close(fd)


def test_lines_may_come_from_a_file_the_last_one_without_an_end(tmp_path: Path) -> None:
    lines, answers = tmp_path / "lines", tmp_path / "answers"
    lines.write_bytes(_lines().rstrip())
    with lines.open("rb") as source, answers.open("wb") as target:
        asyncio.run(serve_stdio(Server("test", on_list_tools=_tools), source.fileno(), target.fileno()))
    assert json.loads(answers.read_bytes().splitlines()[0])["id"] == 1
