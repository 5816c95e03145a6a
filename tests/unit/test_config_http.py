"""What `ros2-mcp config CLIENT --http` and `--socket` print is read back as the client reads it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from ros2_mcp.cli import run
from ros2_mcp.commands.config import CLIENTS


@pytest.mark.parametrize("client", CLIENTS)
def test_over_http_every_client_gets_the_address_and_the_token(
    client: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert run(["--port", "9000", "config", client, "--http"]) == 0
    printed = capsys.readouterr().out
    token = (tmp_path / "ros2-mcp/http-token").read_text().strip()
    assert "http://127.0.0.1:9000/mcp" in printed and f"Bearer {token}" in printed
    assert run(["--port", "9000", "config", client, "--http"]) == 0
    assert capsys.readouterr().out == printed  # the token is kept


@pytest.mark.parametrize("client", CLIENTS)
def test_over_http_without_a_login_no_client_gets_a_header(client: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--no-login", "config", client, "--http"]) == 0
    printed = capsys.readouterr().out
    assert "http://127.0.0.1:8123/mcp" in printed and "uthorization" not in printed and "headers = {" not in printed


def test_over_http_the_texts_of_clients_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    def printed(client: str) -> str:
        assert run(["--public-url", "https://robot.example", "config", client, "--http"]) == 0
        return capsys.readouterr().out

    url = "https://robot.example/mcp"
    assert json.loads(printed("vscode"))["servers"]["ros2"]["type"] == "http"
    assert json.loads(printed("cline"))["mcpServers"]["ros2"]["url"] == url
    assert json.loads(printed("gemini"))["mcpServers"]["ros2"]["httpUrl"] == url
    assert json.loads(printed("zed"))["context_servers"]["ros2"]["headers"]["Authorization"].startswith("Bearer ")
    words = shlex.split(printed("claude-code"))
    assert words[:6] == ["claude", "mcp", "add", "--transport", "http", "--scope"] and words[8] == url
    assert words[9] == "--header" and words[10].startswith("Authorization: Bearer ")
    lines = printed("codex").splitlines()
    assert lines[:2] == ["[mcp_servers.ros2]", f'url = "{url}"']
    assert lines[2].startswith('http_headers = { "Authorization" = "Bearer ') and lines[2].endswith('" }')
    assert "required = true" in lines
    opencode = json.loads(printed("opencode"))["mcp"]["ros2"]
    assert (opencode["type"], opencode["url"], opencode["timeout"]) == ("remote", url, 60_000)
    yaml: Any = YAML(typ="safe")
    goose = yaml.load(printed("goose"))["extensions"]["ros2"]
    assert (goose["type"], goose["uri"]) == ("streamable_http", url)


def test_of_a_file_of_tokens_none_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tokens = str(tmp_path / "tokens")
    assert run(["--token-file", tokens, "token", "cell", "--scopes", "observe,stop"]) == 0
    token = capsys.readouterr().out.strip()
    assert run(["--token-file", tokens, "config", "cursor", "--http"]) == 0
    printed = capsys.readouterr()
    assert "Bearer TOKEN" in printed.out and token not in printed.out and "TOKEN stands" in printed.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--host", "0.0.0.0", "config", "cursor", "--http"], "cross the network in the open"),
        (["--transport", "sse", "config", "cursor", "--http"], "Write --transport streamable-http instead"),
        (["token", "cell"], "A file of tokens is needed"),
        (["--token-file", "/nowhere/tokens", "token", "cell"], "cannot be written"),
        (["--token-file", "/nowhere/tokens", "token", "cell", "--scopes", "atc"], "Did you mean act"),
    ],
)
def test_what_no_server_would_start_with_is_not_printed(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words) == 1
    assert said in capsys.readouterr().err


def test_at_a_socket_the_client_starts_connect(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--socket", "run/s", "--read-only", "config", "cursor"]) == 0
    entry = json.loads(capsys.readouterr().out)["mcpServers"]["ros2"]
    assert entry["args"][-2:] == ["connect", str(Path("run/s").absolute())]
    assert "--read-only" not in entry["args"] and entry["env"] == {}
