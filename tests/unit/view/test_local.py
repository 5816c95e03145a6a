"""The page's own server: who may ask what, and that the page itself can do nothing else."""

from __future__ import annotations

import gzip
import json
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import anyio
import pytest

from ros2_mcp.compose.robot import robot_for, store_for
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.settings import Settings
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.local import LocalPage
from ros2_mcp.view.page import page
from ros2_mcp.view.views import MOST_VIEWS, Views
from support.room_bag import room_bag

PORT = 8123
TOKEN = "a-token-of-this-test"
GOOD = {
    "host": f"127.0.0.1:{PORT}",
    "origin": f"http://127.0.0.1:{PORT}",
    "content-type": "application/json",
    "x-ros2-mcp-token": TOKEN,
}
LOOK = {"name": "ros2_view_frame", "arguments": {"panels": {"map": "", "values": "", "robot": ""}, "wait_ms": 1500}}


async def asked(
    app: LocalPage, body: Any = LOOK, *, method: str = "POST", path: str = "/call", **headers: str | None
) -> tuple[int, Any, Mapping[str, str]]:
    """Status, body and headers of the answer; a header of None is left out."""
    given = {**GOOD, **{name.replace("_", "-"): value for name, value in headers.items()}}
    sent: list[Any] = []
    data = body if isinstance(body, bytes) else json.dumps(body).encode()

    async def receive() -> Any:
        return {"type": "http.request", "body": data, "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    pairs = [(name.encode(), value.encode()) for name, value in given.items() if value is not None]
    await app({"type": "http", "method": method, "path": path, "headers": pairs}, receive, send)
    answer = sent[1]["body"]
    told = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    is_json = told["content-type"] == "application/json"
    return sent[0]["status"], json.loads(answer) if is_json else answer, told


@asynccontextmanager
async def serving(folder: Path) -> AsyncGenerator[LocalPage, None]:
    settings = Settings(bag=room_bag(folder / "room"))
    store = store_for(settings)
    robot = robot_for(settings, store)
    async with anyio.create_task_group() as tasks:
        source = await Sources(robot, store).open()
        yield LocalPage(Views(robot, source, "room", Acting(StateFolder(folder / "state")), tasks), TOKEN, PORT)
        tasks.cancel_scope.cancel()
    await store.close()


async def test_a_page_is_told_what_is_new_and_only_that(tmp_path: Path) -> None:
    async with serving(tmp_path) as app:
        status, first, _ = await asked(app)
        panels = dict(first["panels"])
        while len(panels) < 3:
            more = {**LOOK["arguments"], "view": first["view"], "seen": {n: p["number"] for n, p in panels.items()}}
            status, update, _ = await asked(app, {**LOOK, "arguments": more})
            assert update["view"] == first["view"]
            assert not panels.keys() & update["panels"].keys()
            panels |= update["panels"]
        assert status == 200
        assert panels["values"]["topic"] == "/odom"
        assert panels["map"]["robot"]["x"] == pytest.approx(1.7, abs=1.0)
        chunk = {"view": first["view"], "key": panels["map"]["grid"]["key"]}
        assert (await asked(app, {"name": "ros2_view_ask", "arguments": chunk}))[1]["bulk"]
        stranger = {**chunk, "view": "0" * 32}
        assert (await asked(app, {"name": "ros2_view_ask", "arguments": stranger}))[0] == 404


async def test_who_is_not_the_page_is_answered_nothing(tmp_path: Path) -> None:
    hosts = [None, "", "evil.example", f"evil.example:{PORT}", "127.0.0.1", f"127.0.0.1:{PORT + 1}", f"[::1]:{PORT}"]
    origins = [None, "null", "http://evil.example", f"https://127.0.0.1:{PORT}", f"http://localhost:{PORT}", "file://"]
    tokens = [None, "", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), f"Bearer {TOKEN}", "é"]
    kinds = [None, "text/plain", "application/x-www-form-urlencoded", "multipart/form-data", "application/json;x=1"]
    async with serving(tmp_path) as app:
        for path in ("/call", "/stop"):
            for name, values in (
                ("host", hosts),
                ("origin", origins),
                ("x_ros2_mcp_token", tokens),
                ("content_type", kinds),
            ):
                for value in values:
                    status, body, told = await asked(app, path=path, **{name: value})
                    assert status >= 400 and isinstance(body, bytes), (path, name, value)
                    assert not [one for one in told if one.startswith("access-control")]
            for method in ("GET", "PUT", "DELETE", "OPTIONS", "HEAD", "PATCH"):
                assert (await asked(app, path=path, method=method))[0] >= 400
        for path in (
            "/",
            "/CALL",
            "//call",
            "/call/",
            "/stop/../call",
            "/mcp",
            "/page.html",
            "/.git/config",
            "/favicon.ico",
        ):
            assert (await asked(app, path=path))[0] >= 400
        assert not (tmp_path / "state").exists()  # nothing was stopped


async def test_what_is_no_question_is_refused_and_breaks_nothing(tmp_path: Path) -> None:
    bodies: list[Any] = [
        *(b"", b"{", b"null", b"[]", b"1e999", b'"x"', b"\xff\xfe", b"[" * 15_000, b"x" * 30_000),
        *({"name": name, "arguments": {}} for name in ("ros2_topic_publish", "ros2_stop", "__class__", "", None, 5)),
        *({"name": "ros2_view_frame", "arguments": given} for given in (None, [], {}, {"panels": 5}, {"panels": [1]})),
        *(
            {"name": "ros2_view_frame", "arguments": {"panels": {}, **given}}
            for given in ({"at_s": "x"}, {"at_s": 1e300}, {"wait_ms": {}}, {"seen": {"map": "x"}}, {"at_s": -1})
        ),
        *({"name": "ros2_view_ask", "arguments": given} for given in ({}, {"view": {}, "key": []}, {"key": "../x"})),
    ]
    async with serving(tmp_path) as app:
        for body in bodies:
            status, _, _ = await asked(app, body)
            assert 400 <= status < 500, body
        unknown = {"panels": {"../map": "x", "map": "<script>" * 1000}, "wait_ms": 0}
        assert (await asked(app, {"name": "ros2_view_frame", "arguments": unknown}))[0] == 200
        for _ in range(MOST_VIEWS - 1):
            assert (await asked(app))[0] == 200
        assert (await asked(app))[0] == 400  # too many pages


async def test_the_button_needs_no_server_to_set_the_latch(tmp_path: Path) -> None:
    async with serving(tmp_path) as app:
        status, said, _ = await asked(app, b"", path="/stop")
        assert (status, said["latched"], said["is_all_well"]) == (200, True, True)
        assert StateFolder(tmp_path / "state").latch().look().is_set


async def test_the_page_is_one_file_that_loads_nothing_and_its_policy_lets_only_its_script_run(tmp_path: Path) -> None:
    async with serving(tmp_path) as app:
        status, html, told = await asked(app, path="/", method="GET", x_ros2_mcp_token=None, origin=None)
    assert (status, html) == (200, page().html)
    policy = told["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy and policy.count("sha256-") == 2
    assert len(gzip.compress(html)) < 400_000
    names_only = html.replace(b"http://www.w3.org/1999/xhtml", b"")  # which a namespace is called; nothing is loaded
    for never in (b"http:", b"https:", b"innerHTML", b"outerHTML", b"insertAdjacentHTML", b"document.write", b"eval("):
        assert never not in names_only, never
