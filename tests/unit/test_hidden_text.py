"""The command line and the log show of a robot's text what is hidden (tests/ros/server: what MCP shows)."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import pytest

from ros2_mcp.cli import run
from ros2_mcp.commands.serve import LogFormatter
from ros2_mcp.mcp.binding import CallFailed
from support.hidden import HIDDEN
from support.hostile_bag import write_hostile_bag
from support.outlets import FORGED, hostile, is_hidden

CALLS = (
    ("ros2_topic_list",),
    ("ros2_topic_subscribe", "topic_name=/text", "message_limit=50"),
    ("ros2_wait_until", "topic_name=/text", 'condition=data != "x"'),
    ("ros2_health_check",),
    ("ros2_log_read",),
    ("ros2_bag_info", "bag=hostile"),
    ("ros2_topic_subscribe", "topic_name=/odd_definition"),
    ("ros2_topic_subscribe", f"topic_name={hostile()}"),
)


def shows_what_it_says(text: str) -> bool:
    lines = text.splitlines()
    return not any(map(is_hidden, text)) and not any(line.startswith(FORGED) for line in lines)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_hostile_bag(tmp_path_factory.mktemp("bags") / "hostile")


@pytest.mark.parametrize("call", CALLS, ids=lambda call: " ".join(call)[:40].encode("ascii", "replace").decode())
@pytest.mark.parametrize("form", [(), ("--json",)])
def test_the_command_line_hides_nothing(
    bag: Path, call: tuple[str, ...], form: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    run(["--bag", str(bag), "call", *form, *call])
    printed = capsys.readouterr()
    assert FORGED in printed.out + printed.err
    assert shows_what_it_says(printed.out) and shows_what_it_says(printed.err)


@pytest.mark.parametrize("what", HIDDEN)
def test_the_log_and_errors_hide_nothing(what: str) -> None:
    try:
        raise ValueError(hostile(what))
    except ValueError:
        record = logging.LogRecord("x", logging.INFO, "x.py", 1, "failed: %s", (hostile(what),), sys.exc_info())
    message, _, traceback = LogFormatter("%(message)s").format(record).partition("\n")
    assert shows_what_it_says(message) and not any(map(is_hidden, traceback))
    assert shows_what_it_says(str(CallFailed(hostile(what))))
    assert "\n" not in str(CallFailed(hostile(what)))
