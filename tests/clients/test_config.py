"""What `ros2-mcp config` prints is taken by the real client, which then starts the server and speaks with it."""

from __future__ import annotations

import json

import pytest

from support.clients.claude_code import ClaudeCode
from support.clients.client import printed_config, workplace
from support.clients.codex import Codex
from support.clients.gemini import Gemini
from support.clients.opencode import OpenCode

pytestmark = [pytest.mark.full, pytest.mark.timeout(300)]

NOBODY = "http://127.0.0.1:9"
"""No model is asked."""


@pytest.mark.parametrize(
    ("kind", "word"),
    [(ClaudeCode, "Connected"), (Gemini, "Connected"), (OpenCode, "connected")],
    ids=["claude-code", "gemini", "opencode"],
)
def test_a_client_that_is_configured_as_printed_connects(
    kind: type[ClaudeCode | Gemini | OpenCode], word: str, ros_environment: dict[str, str]
) -> None:
    client = kind()
    with workplace(client) as place:
        client.configure(place, printed_config(client.name, place, ros_environment), NOBODY)
        said = client.servers(place)
        assert "ros2" in said and word in said, said
        passed = place.log.read_text()
        assert '"serverInfo"' in passed or "server/discover" in passed


def test_codex_takes_the_printed_times_and_who_need_not_be_asked(ros_environment: dict[str, str]) -> None:
    """`codex mcp get` starts no server; that it connects, the other tests of this folder show."""
    client = Codex()
    with workplace(client) as place:
        client.configure(place, printed_config(client.name, place, ros_environment), NOBODY)
        taken = json.loads(client.servers(place).partition("WARNING")[0])
        assert (taken["enabled"], taken["startup_timeout_sec"], taken["tool_timeout_sec"]) == (True, 60, 3660)
        assert taken["transport"]["command"] == place.server
