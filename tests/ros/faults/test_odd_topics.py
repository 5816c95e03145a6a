"""Topics that cannot be read as they should: each says clearly why, and the next call works."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from itertools import count
from typing import Any

import pytest

from support.agent import Refusal
from support.async_agent import AsyncAgent
from support.processes import SOURCES, python_path
from support.standstill import undisturbed_async

READ_S = 8
"""Of a publisher that dies meanwhile: it may take seconds until it is told to, and until it has left."""


@pytest.fixture(scope="session")
def built_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The variables with which a process finds the package nobody_msgs; the bridge does not have them."""
    package = tmp_path_factory.mktemp("interfaces") / "nobody_msgs"
    (package / "msg").mkdir(parents=True)
    (package / "msg" / "Thing.msg").write_text("int32 number\n")
    (package / "package.xml").write_text("<package><name>nobody_msgs</name><version>1.0.0</version></package>\n")
    done = subprocess.run(
        [sys.executable, "-m", "ros2_mcp_interfaces", str(package)],
        env={**os.environ, "PYTHONPATH": str(SOURCES)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        pytest.skip(f"needs what builds interface packages: {done.stderr[-300:]}")
    prefix = done.stdout.split()[-1]
    return {
        "AMENT_PREFIX_PATH": f"{prefix}:{sys.prefix}",
        "PYTHONPATH": python_path(f"{prefix}/site-packages"),
        "DESCRIBES_NO_TYPES": "yes",
    }


@pytest.mark.promise("README", "the package with that type is not where the bridge runs: --workspace")
async def test_a_type_that_only_the_publisher_has_is_named_with_what_to_do(
    agent: AsyncAgent, peer, built_elsewhere
) -> None:
    peer("repeat", "/thing", "nobody_msgs/msg/Thing", 20, **built_elsewhere)

    info = await agent.knows("/thing")
    assert info["topic_types"] == ["nobody_msgs/msg/Thing"]

    await refused_after_s(agent)
    with pytest.raises(Refusal, match=r"No definition of nobody_msgs/msg/Thing.*--workspace"):
        await agent.call("ros2_topic_stats", topic_names=["/thing"], duration_s=0.5)
    with pytest.raises(Refusal, match=r"ros2-mcp interfaces build DIR"):
        await agent.call("ros2_topic_subscribe", topic_name="/thing", duration=10)
    await agent.call("ros2_status")

    listed = await agent.call("ros2_topic_list", pattern="/thing", request_fields=True)
    assert "Fields are missing: No definition of nobody_msgs/msg/Thing" in listed["note"]
    health = await agent.call("ros2_health_check", rate_check_duration_sec=0.5)
    (told,) = (row for row in health["findings"] if row["subject"] == "/thing")
    assert health["verdict"] != "HEALTHY" and "No definition of nobody_msgs/msg/Thing" in told["problem"]


@pytest.mark.full
async def test_a_type_that_only_the_publisher_has_is_named_within_a_second(
    agent: AsyncAgent, peer, built_elsewhere
) -> None:
    peer("repeat", "/thing", "nobody_msgs/msg/Thing", 20, **built_elsewhere)
    await agent.knows("/thing")
    assert await undisturbed_async(lambda: refused_after_s(agent)) < 1.0


async def refused_after_s(agent: AsyncAgent) -> float:
    """How long a read for 10 s and a publish take to be refused."""
    begun = time.monotonic()
    with pytest.raises(Refusal, match=r"No definition of nobody_msgs/msg/Thing.*--workspace"):
        await agent.call("ros2_topic_subscribe", topic_name="/thing", duration=10)
    with pytest.raises(Refusal, match=r"No definition of nobody_msgs/msg/Thing.*--workspace"):
        await agent.call("ros2_topic_publish", topic_name="/thing", data={"number": 1})
    return time.monotonic() - begun


async def test_a_topic_with_two_types_names_both_and_each_can_be_read(agent: AsyncAgent, peer) -> None:
    types = ["std_msgs/msg/String", "std_msgs/msg/UInt64"]
    for kind in types:
        peer("repeat", "/both", kind, 50)

    await agent.knows("/both", publishers=2)
    with pytest.raises(Refusal, match=r"2 types: std_msgs/msg/String, std_msgs/msg/UInt64.*give the type"):
        await agent.call("ros2_topic_subscribe", topic_name="/both")
    for kind in types:
        reading = await agent.call("ros2_topic_subscribe", topic_name="/both", msg_type=kind, message_limit=1)
        assert (reading["count"], reading["topic_type"], len(reading["publishers"])) == (1, kind, 1)
    with pytest.raises(Refusal, match="not std_msgs/msg/Bool"):
        await agent.call("ros2_topic_subscribe", topic_name="/both", msg_type="std_msgs/msg/Bool")


@pytest.mark.promise("README", "ros2_topic_info says in words which publisher and subscriber do not match, and why")
@pytest.mark.promise("ros2_topic_info", "and why pairs do not match")
async def test_policies_that_keep_third_parties_apart_are_told_in_words(agent: AsyncAgent, peer) -> None:
    pairs = {
        "/reliability": ({"reliability": "BEST_EFFORT"}, {}, "best_effort"),
        "/durability": ({}, {"durability": "TRANSIENT_LOCAL"}, "transient_local"),
        "/deadline": ({}, {"deadline_ns": 100_000_000}, "deadline"),
    }
    peer("endpoints", "publishers", json.dumps({topic: offered for topic, (offered, _, _) in pairs.items()}))
    peer("endpoints", "subscriptions", json.dumps({topic: asked for topic, (_, asked, _) in pairs.items()}))

    for topic, (_, _, word) in pairs.items():
        info = await agent.knows(topic, publishers=1, subscribers=1)
        assert len(info["mismatches"]) == 1
        assert word in info["mismatches"][0]


async def test_a_publish_that_a_policy_keeps_from_its_subscriber_says_which(agent: AsyncAgent, peer) -> None:
    peer("endpoints", "subscriptions", json.dumps({"/strict": {"deadline_ns": 100_000_000}}))

    sent, _ = await published_in_vain(agent)
    assert sent["status"] == "no_subscriber", sent
    assert "deadline" in sent["note"], sent


@pytest.mark.full
async def test_a_publish_that_a_policy_keeps_from_its_subscriber_ends_within_fifteen_seconds(
    agent: AsyncAgent, peer
) -> None:
    peer("endpoints", "subscriptions", json.dumps({"/strict": {"deadline_ns": 100_000_000}}))
    assert (await published_in_vain(agent))[1] < 15.0


async def published_in_vain(agent: AsyncAgent) -> tuple[dict[str, Any], float]:
    """What a publish on /strict says, and how long it took."""
    await agent.knows("/strict", publishers=0, subscribers=1)
    begun = time.monotonic()
    return await agent.call("ros2_topic_publish", topic_name="/strict", data={"data": 1}), time.monotonic() - begun


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
async def test_a_publisher_that_dies_during_a_read_is_told_with_what_had_come(
    agent: AsyncAgent, peer, number: signal.Signals
) -> None:
    result = await read_of_one_that_dies(agent, peer, number, "/brief")
    assert 10 <= result["received"] < 100 * (READ_S - 1)
    assert "the last one came at" in result["note"], result["note"]
    if number == signal.SIGTERM:
        assert "1 publisher left" in result["note"]
    await agent.call("ros2_status")


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
async def test_a_read_of_a_publisher_that_dies_ends_with_its_duration(
    agent: AsyncAgent, peer, number: signal.Signals
) -> None:
    attempts = count()

    async def told() -> tuple[dict[str, Any], float]:
        topic = f"/measured_{number:d}_{next(attempts)}"
        publisher = peer("repeat", topic, "std_msgs/msg/String", 100)
        await agent.knows(topic)
        begun = time.monotonic()
        reading = asyncio.ensure_future(
            agent.call("ros2_topic_subscribe", topic_name=topic, duration=2, message_limit=100_000)
        )
        await asyncio.sleep(1)  # half of the reading
        publisher.process.send_signal(number)
        return await reading, time.monotonic() - begun

    result, took_s = await undisturbed_async(told)
    assert took_s < 4.0
    assert 20 < result["received"] < 150


async def read_of_one_that_dies(agent: AsyncAgent, peer, number: signal.Signals, name: str) -> dict[str, Any]:
    """What is read from a publisher that dies when ten of its messages have come."""
    topic = f"{name}_{number:d}"
    publisher = peer("repeat", topic, "std_msgs/msg/String", 100)
    await agent.knows(topic)
    before = (await agent.call("ros2_status"))["subscriptions"]
    reading = asyncio.ensure_future(
        agent.call("ros2_topic_subscribe", topic_name=topic, duration=READ_S, message_limit=100_000)
    )
    while (await agent.call("ros2_status"))["subscriptions"] == before:
        assert not reading.done()
    await agent.call("ros2_topic_subscribe", topic_name=topic, message_limit=10, duration=30)  # the same subscription
    publisher.process.send_signal(number)
    return await reading
