"""Every version of the protocol that the SDK knows, in lines written by hand.

The oldest and the newest speak with servers of their own, the others with one at a socket.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest
from mcp_types.version import KNOWN_PROTOCOL_VERSIONS

from support.ports import serving
from support.raw_server import MODERN, RawServer
from support.standstill import undisturbed

READING = {"topic_name": "/seldom_said", "duration": 60}


@pytest.fixture(scope="module")
def path(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The socket of a server."""
    path = tmp_path_factory.mktemp("run") / "socket"
    with serving(ros_environment, path):
        yield path


@pytest.fixture(params=KNOWN_PROTOCOL_VERSIONS)
def server(request, start_raw, peer, path: Path) -> RawServer:
    peer.offer(topic="/seldom_said", kind="std_msgs/msg/String", seed=1)
    has_own = request.param in (KNOWN_PROTOCOL_VERSIONS[0], MODERN)
    raw = start_raw(command=None if has_own else [sys.executable, "-m", "ros2_mcp", "connect", str(path)])
    introduction = raw.begin(request.param)
    if request.param == MODERN:
        assert request.param in introduction["supportedVersions"]
    else:
        assert introduction["protocolVersion"] == request.param
    assert introduction["capabilities"]["tools"] is not None and "logging" not in introduction["capabilities"]
    return raw


def test_a_session_lists_calls_refuses_cancels_and_ends(server: RawServer) -> None:
    assert_tools_are_listed(server)
    assert_a_call_is_answered(server)
    assert_a_misspelt_argument_is_explained(server)
    assert_the_servers_log_is_not_offered(server)
    assert_a_cancelled_read_ends_its_work(server)
    server.close()


@pytest.mark.full
@pytest.mark.parametrize("version", KNOWN_PROTOCOL_VERSIONS)
def test_a_session_ends_within_two_seconds(start_raw, version: str) -> None:
    sessions = (begun(start_raw(), version) for _ in count())
    assert undisturbed(lambda: next(sessions).close()) < 2


def begun(server: RawServer, version: str) -> RawServer:
    """A session whose bridge is there."""
    server.begin(version)
    assert not server.call("ros2_status").get("isError")
    return server


def assert_tools_are_listed(server: RawServer) -> None:
    tools = server.ask("tools/list")["result"]["tools"]
    assert "ros2_topic_list" in {tool["name"] for tool in tools}
    assert all(tool["inputSchema"]["type"] == "object" for tool in tools)


def assert_a_call_is_answered(server: RawServer) -> None:
    result = server.call("ros2_topic_list", pattern="/parameter_events")
    assert not result.get("isError")
    assert "topic_name: /parameter_events, topic_type: " in result["content"][0]["text"]
    if server.version >= "2025-06-18":
        assert result["structuredContent"]["topics"][0]["topic_name"] == "/parameter_events"


def assert_a_misspelt_argument_is_explained(server: RawServer) -> None:
    result = server.call("ros2_topic_list", patern="/x")
    assert result["isError"]
    assert "ros2_topic_list has no argument 'patern'. Did you mean pattern?" in result["content"][0]["text"]


def assert_the_servers_log_is_not_offered(server: RawServer) -> None:
    refused = server.ask("logging/setLevel", level="debug")
    assert (refused["error"]["code"], refused["error"]["message"]) == (-32601, "Method not found")
    assert server.call("ros2_topic_list", patern="/x")["isError"]  # which the server logs
    assert not [line for line in server.lines() if line.get("method") == "notifications/message"]


def assert_a_cancelled_read_ends_its_work(server: RawServer) -> None:
    before = subscriptions(server)  # the server itself follows the robot's log
    request = server.send("tools/call", name="ros2_topic_subscribe", arguments=READING)
    wait_for_subscriptions(server, before + 1)
    server.tell("notifications/cancelled", requestId=request, reason="no longer wanted")
    wait_for_subscriptions(server, before)
    answers = [line for line in server.lines() if line.get("id") == request]
    assert not answers or "error" in answers[0]


def wait_for_subscriptions(server: RawServer, expected: int) -> None:
    deadline = time.monotonic() + 20
    while (found := subscriptions(server)) != expected:
        assert time.monotonic() < deadline, f"{found} subscriptions"


def subscriptions(server: RawServer) -> int:
    text = server.call("ros2_status")["content"][0]["text"]
    return int(text.partition("subscriptions: ")[2].partition(",")[0])


def test_lines_that_are_not_json_do_no_harm(start_raw) -> None:
    server = start_raw()
    server.process.stdin.write(b"\xff\xfe this is not JSON\n\n")
    server.begin("2025-11-25")
    assert server.ask("no/such/method")["error"]["code"] == -32601
    unknown = server.ask("tools/call", name="ros2_topic_lst", arguments={})
    assert "ros2_topic_lst" in str(unknown)
    assert not server.call("ros2_topic_list").get("isError")
