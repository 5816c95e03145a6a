"""A server that gives the page any answer a test wants: what a real one must never give, or only after hours."""

from __future__ import annotations

import base64
import io
import json
import math
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from typing import Any

from PIL import Image

from ros2_mcp.view.page import page

Answer = tuple[int, str, bytes]
STOPPED = {"summary": "1 of 1 server(s) stopped.", "is_all_well": True, "servers": [], "problems": []}
SIDE = 200
"""Of its map, in cells."""


class ScriptedView:
    """Serves the real page under its real policy. `answers` gives the answer to a call: status, type and body.

    `most_at_once` counts how many updates the page had under way at the same time.
    """

    def __init__(self) -> None:
        self.answers: Callable[[dict[str, Any]], Answer] = lambda asked: good(updated(asked, 0))
        self.asked = self.most_at_once = 0
        self._under_way = 0
        self._lock = threading.Lock()
        view = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                self._send((200, "text/html; charset=utf-8", page().html), policy=page().policy)

            def do_POST(self) -> None:
                asked = json.loads(self.rfile.read(int(self.headers["content-length"])))
                self._send(view.answer(asked))

            def _send(self, answer: Answer, policy: str = "") -> None:
                self.send_response(answer[0])
                self.send_header("content-type", answer[1])
                self.send_header("content-length", str(len(answer[2])))
                if policy:
                    self.send_header("content-security-policy", policy)
                self.end_headers()
                self.wfile.write(answer[2])

            def log_message(self, *_: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_port}/#token"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def answer(self, asked: dict[str, Any]) -> Answer:
        if "name" not in asked:
            return good(STOPPED)
        if asked["name"] != "ros2_view_frame":
            return good(CHUNK)
        with self._lock:
            self.asked += 1
            self._under_way += 1
            self.most_at_once = max(self.most_at_once, self._under_way)
        try:
            return self.answers(asked["arguments"])
        finally:
            with self._lock:
                self._under_way -= 1

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@contextmanager
def scripted() -> Iterator[ScriptedView]:
    """Such a server for the time of a block."""
    view = ScriptedView()
    try:
        yield view
    finally:
        view.close()


def good(value: Any) -> Answer:
    return 200, "application/json", json.dumps(value).encode()


def _picture(number: int) -> str:
    data = io.BytesIO()
    Image.new("RGB", (320, 240), (number % 256, 90, 90)).save(data, "JPEG")
    return base64.b64encode(data.getvalue()).decode()


PICTURES = [_picture(number * 25) for number in range(10)]
CHUNK = {"bulk": base64.b64encode(zlib.compress(bytes([0, 100, 255, 50] * (SIDE * SIDE // 4)))).decode()}


def updated(asked: dict[str, Any], number: int) -> dict[str, Any]:
    """The answer with all panels, each new: the robot has driven on, the log has gone on."""
    now_s = 1.7e9 + number / 3
    at = {"x": 3 * math.cos(number / 50), "y": 3 * math.sin(number / 50), "yaw": number / 50, "at_s": now_s}
    grid = {"key": f"key{number // 500}", "name": "/map", "width": SIDE, "height": SIDE, "resolution": 0.05}
    grid |= {"costs": False, "x": -5, "y": -5, "yaw": 0}
    image = {"topic": "/camera", "topics": ["/camera"], "mime": "image/jpeg", "width": 320, "height": 240}
    then = "2026-01-01T00:00:00Z"
    act = {"time": then, "kind": "act", "verb": "publish"}
    line = {"time": then, "level": "INFO", "node": "/node"}
    value = {"pose": {"x": number, "parts": [f"{number} {n}" for n in range(number % 12)]}, "name": f"value {number}"}
    since = {"at_s": now_s, "rate_hz": 10}
    contents: dict[str, dict[str, Any]] = {
        "robot": {"title": "scripted", "live": True, "topics": [[f"/t{number // 1000}"], ["/odom"]]},
        "map": {"frame": "map", "grids": ["/map"], "robot": at, "grid": grid},
        "image": {**image, **since, "bulk": PICTURES[number % 10]},
        "values": {"topic": "/odom", "type": "made/msg/Made", **since, "value": value},
        "log": {"lines": [{**line, "text": f"line {n}"} for n in range(number, number + 100)]},
        "agent": {
            "servers": [{"name": "one", "answers": True, "moves": ["/cmd_vel"]}],
            "acts": [{**act, "seq": n, "name": f"/topic{n}"} for n in range(number, number + 60)],
            "latch": None,
            "folder": "robot",
        },
        "frames": _frames(number, now_s),
        "plot": _plot(number, now_s),
        "space": _space(number, now_s),
    }
    shown = {name: {"number": number + 1, **content} for name, content in contents.items() if name in asked["panels"]}
    return {"view": "scripted", "now_s": now_s, "panels": shown}


def _frames(number: int, now_s: float) -> dict[str, Any]:
    """Forty below each other, of which one comes and goes."""
    edge = {"static": False, "publisher": "/tf", "rate_hz": 10.0 + number % 3, "age_s": 0.1, "problem": ""}
    names = ["map", *(f"frame{n}" for n in range(40)), f"guest{number}"]
    edges = [{**edge, "parent": parent, "child": child} for parent, child in pairwise(names)]
    return {"frames": len(names), "roots": ["map"], "edges": edges, "problems": [], "notes": [], "at_s": now_s}


def _plot(number: int, now_s: float) -> dict[str, Any]:
    """Ten rows of two numbers, five of them new."""
    rows = [(now_s + n / 30, math.sin(number + n), float(n)) for n in range(10)]
    fields = [{"name": "sine", "unit": "m"}, {"name": "step", "unit": ""}]
    data = b"".join(struct.pack("<3d", *row) for row in rows)
    told = {"topic": "/odom", "type": "made/msg/Made", "fields": fields, "since_s": 1.7e9, "first": number * 5}
    return {**told, "at_s": rows[-1][0], "whole": False, "rate_hz": 30.0, "bulk": base64.b64encode(data).decode()}


def _space(number: int, now_s: float) -> dict[str, Any]:
    """A cloud that is another one each third time, a scan, and frames that move."""
    pose = [math.cos(number / 50), math.sin(number / 50), 0, 0, 0, 0, 1]
    frames = [{"name": f"frame{n}", "parent": f"frame{n - 1}" if n else "map", "pose": pose} for n in range(40)]
    cloud = {"name": "/cloud", "at_s": now_s, "pose": pose, "key": f"cloud{number // 3}", "count": 6000}
    cloud |= {"points": 6000, "cell_m": 0, "low": [0, 0, 0], "step": [1e-4] * 3, "colours": ""}
    scan = base64.b64encode(struct.pack("<720f", *(math.sin(n) for n in range(720)))).decode()
    told = {"frame": "map", "base": "frame1", "frames": frames, "clouds": ["/cloud"], "cloud": cloud, "model": None}
    return {**told, "scans": [{"name": "/scan", "at_s": now_s, "pose": pose}], "told_s": now_s, "bulk": [scan]}
