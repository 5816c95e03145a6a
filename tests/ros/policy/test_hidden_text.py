"""Under a policy nothing hidden leaves by any outlet: refusals, approvals, the audit, the latch, the operator's screen,
errors over HTTP. Each outlet with each class of hidden text in full, with every seventh here.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_common.latch import FILE, Latch
from support.agent import FULL
from support.hidden import HIDDEN
from support.outlets import FORGED, faults_of, hostile, is_hidden
from support.ports import listening
from support.raw_server import RawServer
from support.tokens import BEARER

CLASSES = list(HIDDEN)[:: 1 if FULL else 7]
VERSION = "2025-06-18"
POLICY = """
policy: 1
name: hidden
robot: hidden
mode: confirm
state: {folder}/state
allow:
  - {{publish: /said, type: std_msgs/msg/String}}
  - {{set: "/**", names: ["**"]}}
  - {{record: "/**"}}
"""
STRING = "std_msgs/msg/String"


def as_asked(what: str) -> str:
    """What a client sends: it need not be quoted where it is repeated, but is shown all the same."""
    return hostile(what).replace(FORGED, "As asked.")


def calls(what: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every kind of act, with that hidden text as its name and its value."""
    text = as_asked(what)
    yield "ros2_topic_publish", {"topic_name": "/said", "message_type": STRING, "data": {"data": text}}
    yield "ros2_topic_publish", {"topic_name": f"/{text}", "message_type": STRING, "data": {"data": text}}
    yield "ros2_topic_publish", {"topic_name": "/said", "message_type": text, "data": {text: text}}
    yield "ros2_service_call", {"service_name": f"/{text}", "service_type": f"std_srvs/srv/{text}", "fields": {}}
    yield "ros2_send_action_goal", {"action_name": text, "action_type": text, "goal_fields": {}}
    yield "ros2_parameter_set", {"node_name": f"/{text}", "values": {text: text}}
    yield "ros2_lifecycle_change", {"node_name": f"/{text}", "transition": text}
    yield "ros2_record_start", {"name": text, "topic_names": [text]}
    yield "ros2_relay_start", {"source_topic": text, "destination_topic": text}


@pytest.fixture
def options(tmp_path: Path) -> list[str]:
    tmp_path.chmod(0o700)
    file = tmp_path / "policy.yaml"
    file.write_text(POLICY.format(folder=tmp_path))
    file.chmod(0o600)
    return ["--policy", str(file), "--tools", "all", "--record-dir", str(tmp_path / "recordings")]


def printed(environment: dict[str, str], *words: str) -> str:
    command = [sys.executable, "-m", "ros2_mcp", *words]
    ended = subprocess.run(command, capture_output=True, env=environment, check=False, timeout=60)
    return (ended.stdout + ended.stderr).decode()


def shows_what_it_says(text: str) -> bool:
    return not any(map(is_hidden, text)) and not any(line.startswith(FORGED) for line in text.splitlines())


@pytest.mark.timeout(180)
def test_nothing_hidden_leaves_under_a_policy(
    ros_environment: dict[str, str], options: list[str], tmp_path: Path
) -> None:
    server = RawServer(ros_environment, *options)
    state = tmp_path / "state" / "hidden"
    try:
        server.begin(VERSION)
        for what in CLASSES:
            for tool, arguments in calls(what):
                server.ask("tools/call", name=tool, arguments=arguments)
        for tool, arguments in (("ros2_audit_read", {"limit": 1000}), ("ros2_policy", {}), ("ros2_status", {})):
            told = server.ask("tools/call", name=tool, arguments=arguments)
            assert "result" in told, told
        where, shown = ("--state", str(state)), dict[str, str]()
        for words in (
            ("operate",),
            ("operate", "--json"),
            ("audit", "show", "--limit", "1000"),
            ("audit", "show", "--json"),
        ):
            shown[" ".join(words)] = printed(ros_environment, *words, *where)
        for what in CLASSES:  # as another process has it, such as a stopper or whoever wrote the file
            Latch(state / FILE).set(by=hostile(what), reason=hostile(what))
            server.ask("tools/call", name="ros2_status", arguments={})
            tool, arguments = next(calls(what))
            server.ask("tools/call", name=tool, arguments=arguments)
        shown["latched"] = printed(ros_environment, "operate", *where)
        faults = [fault for line in server.lines() for fault in faults_of(line)]
        said = server.said.decode()
    finally:
        server.end()
    assert not faults, "\n".join(faults[:20])
    assert [outlet for outlet, text in shown.items() if not shows_what_it_says(text)] == []
    assert "needs_approval" in said and "the latch of this robot is set" in said
    assert FORGED in shown["latched"], "it is shown, and not as a line of ours"
    for what in CLASSES:  # it was there, and was shown
        assert any(f"U+{ord(character):04X}" in said or f" {ord(character):04X}" in said for character in HIDDEN[what])


def test_nothing_hidden_leaves_in_errors_over_http(ros_environment: dict[str, str], options: list[str]) -> None:
    with listening(ros_environment, "streamable-http", *options) as (port, _):
        for what in CLASSES:
            text = as_asked(what)
            for message in (
                {"jsonrpc": "2.0", "id": text, "method": text, "params": {}},
                {
                    "jsonrpc": "2.0",
                    "id": 1,
                    "method": "tools/call",
                    "params": {"name": text, "arguments": {text: text}},
                },
                {"jsonrpc": text, text: text},
                text,
            ):
                for bearer in (BEARER, "Bearer wrong"):
                    answer = posted(port, json.dumps(message), bearer)
                    assert not any(map(is_hidden, answer.replace("\r\n", "\n"))), (what, message, answer)


def posted(port: int, body: str, bearer: str) -> str:
    """Status, headers and body of an answer."""
    with closing(HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
        headers = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}
        connection.request("POST", "/mcp", body, {**headers, "Authorization": bearer})
        answer = connection.getresponse()
        told = "\n".join(f"{name}: {value}" for name, value in answer.getheaders())
        text = answer.read().decode()
    return told + text + text.encode().decode("unicode_escape") if "\\u" in text else told + text
