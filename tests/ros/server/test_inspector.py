"""MCP Inspector, a client of the protocol's makers, lists everything and finds no fault with any schema."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.ports import listening

INSPECTOR = "@modelcontextprotocol/inspector@2.12.0"
# It brings some 200 packages, from a registry that may be far away.
INSTALL_S = 240
# Node starts in a second and the server in two; beside other tests 15 s were measured.
LIST_S = 120
pytestmark = pytest.mark.timeout(INSTALL_S + 2 * LIST_S)


@pytest.fixture(scope="module")
def inspector(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Inspector's command, fetched into a folder of its own."""
    if not shutil.which("npm"):
        pytest.skip("needs Node.js with npm")
    folder = tmp_path_factory.mktemp("inspector")
    install = ["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund", "--ignore-scripts", INSPECTOR]
    try:
        fetched = subprocess.run(install, capture_output=True, text=True, timeout=INSTALL_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("the registry of packages is too slow or cannot be reached")
    if fetched.returncode:
        pytest.skip(f"the Inspector cannot be fetched: {fetched.stderr[-300:]}")
    return folder / "node_modules/.bin/mcp-inspector"


def listed(inspector: Path, environment: dict[str, str], *options: str) -> tuple[dict, str]:
    """What the Inspector lists, and what it says of it."""
    command = [str(inspector), "--cli", *options, "--format", "json"]
    # It keeps a catalogue of servers in the home folder.
    environment = {**environment, "HOME": str(inspector.parents[2]), "PATH": os.environ["PATH"]}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LIST_S, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return json.loads(ended.stdout)["result"], ended.stderr


LISTS = [
    ("tools/list", "tools"),
    ("prompts/list", "prompts"),
    ("resources/list", "resources"),
    ("resources/templates/list", "resourceTemplates"),
]


@pytest.mark.parametrize(
    ("method", "key"), [LISTS[0], *(pytest.param(*one, marks=pytest.mark.full) for one in LISTS[1:])]
)
def test_it_lists_without_a_warning_over_stdio(inspector, ros_environment, method: str, key: str) -> None:
    strict = ["--strict"] if method == "tools/list" else []
    server = [sys.executable, "-m", "ros2_mcp", "--tools", "all"]
    result, said = listed(inspector, ros_environment, *server, "--method", method, *strict)
    assert result[key] and said == ""


@pytest.fixture(scope="module")
def url(ros_environment: dict[str, str]) -> Iterator[str]:
    """Of a server over HTTP."""
    with listening(ros_environment, "streamable-http", "--tools", "all", "--no-login") as (port, _):
        yield f"http://127.0.0.1:{port}/mcp"


@pytest.mark.parametrize(("method", "key"), LISTS)
def test_it_lists_without_a_warning_over_http(inspector, ros_environment, url: str, method: str, key: str) -> None:
    strict = ["--strict"] if method == "tools/list" else []
    result, said = listed(inspector, ros_environment, url, "--transport", "http", "--method", method, *strict)
    assert result[key] and said == ""
