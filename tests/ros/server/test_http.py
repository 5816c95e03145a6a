"""The same server over HTTP: both eras, and what a client leaves behind."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import anyio
import anyio.to_thread
import pytest
from mcp import Client

from support.observer import TWIST, Observer
from support.ports import listening
from support.structured import META
from support.tokens import client_at

PATIENCE_S = 30.0
WATCHED = "ros2://topic/parameter_events"


@pytest.fixture(scope="module")
def port(ros_environment: dict[str, str]) -> Iterator[int]:
    """Of a server that all tests share."""
    with listening(ros_environment, "streamable-http", "--tools", "all") as (port, _):
        yield port


async def status(client: Client) -> Any:
    result = await client.call_tool("ros2_status", {}, meta=META)
    assert not result.is_error, result.content
    return result.structured_content


@pytest.mark.parametrize("mode", ["legacy", "auto"])
async def test_clients_of_both_eras_list_call_and_read(port: int, mode: str) -> None:
    async with client_at(f"http://127.0.0.1:{port}/mcp", mode=mode) as client:
        assert "ros2_topic_list" in {tool.name for tool in (await client.list_tools()).tools}
        assert (await status(client))["bridge_node"]
        refused = await client.call_tool("ros2_topic_list", {"patern": "x"})
        assert refused.is_error and "Did you mean pattern?" in refused.content[0].text
        assert "ros2://topics" in {str(resource.uri) for resource in (await client.list_resources()).resources}
        assert "/rosout" in (await client.read_resource("ros2://topics")).contents[0].text


@pytest.mark.filterwarnings("ignore:resources.subscribe is removed")
async def test_a_client_that_is_gone_leaves_no_subscription_behind(port: int) -> None:
    async with client_at(f"http://127.0.0.1:{port}/mcp", mode="legacy") as stays:
        before = (await status(stays))["subscriptions"]
        async with client_at(f"http://127.0.0.1:{port}/mcp", mode="legacy") as goes:
            await goes.subscribe_resource(WATCHED)
            assert (await status(stays))["subscriptions"] == before + 1
        with anyio.fail_after(PATIENCE_S):
            while (await status(stays))["subscriptions"] != before:
                await anyio.sleep(0.1)


async def called(client: Client, tool: str, **arguments: Any) -> Any:
    result = await client.call_tool(tool, arguments, meta=META)
    assert not result.is_error, result.content
    return result.structured_content


@pytest.mark.promise("README", "Over HTTP, what a client keeps moving stops when that client goes")
async def test_the_end_of_a_client_stops_what_it_left_in_motion_and_nothing_else(port: int, observer: Observer) -> None:
    """A repeat, whose call ends with the session, and a relay, which no call awaits; another client's relay goes on."""
    topics = ("/left/in", "/left/out", "/kept/out")
    for topic in topics:
        observer.join(by=topic, topic=topic, kind=TWIST)

    async def repeat(client: Client) -> None:
        with suppress(Exception):  # its session ends before it answers
            await called(
                client,
                "ros2_topic_publish",
                topic_name="/left/in",
                message_type="geometry_msgs/Twist",
                data={"linear": {"x": 1.0}},
                frequency=20,
                duration=600,
            )

    def relay(client: Client, to: str) -> Any:
        return called(
            client,
            "ros2_relay_start",
            source_topic="/left/in",
            destination_topic=to,
            message_type="geometry_msgs/Twist",
            duration_sec=0,
        )

    url = f"http://127.0.0.1:{port}/mcp"
    async with client_at(url, mode="legacy") as stays, anyio.create_task_group() as calls:
        own = await relay(stays, "/kept/out")
        async with client_at(url, mode="legacy") as goes:
            left = await relay(goes, "/left/out")
            calls.start_soon(repeat, goes)
            for topic in topics:
                await anyio.to_thread.run_sync(observer.until_driven, topic)
        for topic in topics:
            assert await anyio.to_thread.run_sync(observer.comes_to_rest, topic, PATIENCE_S) == []
        with anyio.fail_after(PATIENCE_S):
            states: dict[str, str] = {}
            while states.get(left["relay_id"]) != "stopped":
                listed = await called(stays, "ros2_relay_list")
                states = {known["relay_id"]: known["state"] for known in listed["relays"]}
        assert states[own["relay_id"]] == "running"
