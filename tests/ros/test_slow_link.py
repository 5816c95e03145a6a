"""Over a slow link a camera holds up neither requests nor a stop, and what comes is whole."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from ros2_mcp.link.client import Bridge
from ros2_mcp.link.environment import find_ros
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.topics.stats import TopicStats, measure
from ros2_mcp.ops.topics.subscribe import Reading, read
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from support.agent import FULL
from support.processes import TESTS, peer_command, running
from support.socket_carrier import FarBridge, SocketCarrier
from support.standstill import undisturbed_async

BITS_PER_S, DELAY_S = 5e6, 0.02
WIDTH, HEIGHT, HERTZ = (640, 480, 30) if FULL else (320, 240, 15)
"""27 MB/s or 3.5 MB/s: 44 or 6 times what crosses the link."""
EVERY_N = 60 if FULL else 15
"""A picture in 2 s or 1 s, which the link carries in 1.5 s or 0.4 s."""
DURATION_S = 5.0 if FULL else 4.0
"""Of these two at least, also where it takes a second to find the topic."""
PICTURE_BYTES = 3 * WIDTH * HEIGHT
ALLOWED_S = 0.25
"""More than without a camera: what is under way (64 KiB) takes 0.1 s, and there is a machine that is busy."""
STOP_S = 0.5
OVERTAKEN_BYTES = 500_000
"""Half of what the link holds (`slow_pipe`): so much comes before an answer at most, and that does not wait behind all
that the link would hold.
"""
PATIENCE_S = 30.0
IMAGE, TOPIC = "sensor_msgs/msg/Image", "/camera/image_raw"
BEST_EFFORT = {"reliability": "best_effort", "durability": "volatile", "history": "keep_last", "depth": 10}
RELIABLE = {**BEST_EFFORT, "reliability": "reliable"}
STOP = {"wait_match_s": 0, "wait_ack_s": 0}


class Camera:
    """What the camera says of itself: a busy machine publishes late."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def published(self) -> tuple[int, float]:
        """How many raw pictures by now, and when that is."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline()), time.monotonic()


@pytest.fixture(scope="module")
def camera(ros_environment: dict[str, str]) -> Iterator[Camera]:
    environment = {
        **ros_environment,
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(TESTS / "support/large_messages_fast_dds.xml"),
    }
    with running(
        environment, *peer_command("camera_peer", str(WIDTH), str(HEIGHT), str(HERTZ), "compressed")
    ) as process:
        yield Camera(process)


@dataclass
class Link:
    """To a bridge behind a slow network; all tests share it."""

    bridge: Bridge
    carrier: SocketCarrier

    async def overtaken(self, op: str, **arguments: Any) -> int:
        """How many bytes came before the answer to a request."""
        before = self.carrier.received_bytes
        await self.bridge.request(op, timeout_s=PATIENCE_S, **arguments)
        return self.carrier.received_bytes - before


@pytest.fixture(scope="module")
async def link(domain_id: int, ros_environment: dict[str, str]) -> AsyncIterator[Link]:
    far = FarBridge(
        find_ros(Settings(domain_id=domain_id), ros_environment),
        through=peer_command("slow_pipe", str(BITS_PER_S), str(DELAY_S)),
    )
    carrier = SocketCarrier(far.near)
    bridge = Bridge(lambda: carrier)
    await bridge.ready()
    try:
        yield Link(bridge, carrier)
    finally:
        await bridge.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            far.process.wait(PATIENCE_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(far.process.pid, signal.SIGKILL)
        far.process.wait()


@pytest.fixture
async def bridge(link: Link) -> Bridge:
    return link.bridge


async def took(bridge: Bridge, op: str, times: int = 1, **arguments: Any) -> list[float]:
    """How long each of so many requests took, in s, the shortest first."""
    found: list[float] = []
    for _ in range(times):
        begun = time.monotonic()
        await bridge.request(op, timeout_s=PATIENCE_S, **arguments)
        found.append(time.monotonic() - begun)
        await asyncio.sleep(0.02)
    return sorted(found)


async def test_beside_a_camera_answers_overtake_the_pictures_that_wait(link: Link, camera: Camera) -> None:
    seen = {"topic": TOPIC, "settle_s": 0}
    await link.bridge.request("wait_endpoints", topic=TOPIC, publishers=1, subscribers=0, timeout_s=PATIENCE_S)
    async with await link.bridge.subscribe(
        TOPIC, IMAGE, BEST_EFFORT, keep="all", max_samples=100, max_bytes=64_000_000
    ) as subscription:
        pictures = await subscription.take(PATIENCE_S)
        overtaken = [await link.overtaken("endpoints", **seen) for _ in range(5)]
        overtaken.append(await link.overtaken("stop", epoch=0, **STOP))
        pictures += await subscription.take(PATIENCE_S)
    assert max(overtaken) < OVERTAKEN_BYTES, overtaken
    assert len(pictures) >= 2 and all(len(picture.data) > PICTURE_BYTES for picture in pictures)


@pytest.mark.full
async def test_a_camera_holds_up_neither_requests_nor_a_stop(bridge: Bridge, camera: Camera) -> None:
    await bridge.request("wait_endpoints", topic=TOPIC, publishers=1, subscribers=0, timeout_s=PATIENCE_S)
    seen = {"topic": TOPIC, "settle_s": 0}

    async def measured() -> tuple[float, float, float, int]:
        idle = await took(bridge, "endpoints", 20, **seen)
        async with await bridge.subscribe(
            TOPIC, IMAGE, BEST_EFFORT, keep="all", max_samples=100, max_bytes=64_000_000
        ) as subscription:
            first = await subscription.take(PATIENCE_S)
            busy = await took(bridge, "endpoints", 40, **seen)
            (stop,) = await took(bridge, "stop", epoch=0, **STOP)
            pictures = [*first, *await subscription.take(PATIENCE_S)]
        assert all(len(picture.data) > PICTURE_BYTES for picture in pictures)
        return idle[18], busy[37], stop, len(pictures)

    idle_s, busy_s, stop_s, pictures = await undisturbed_async(measured)
    assert busy_s <= idle_s + ALLOWED_S
    assert stop_s <= STOP_S
    assert pictures >= 2


async def test_a_stop_overtakes_a_picture_that_is_published(link: Link) -> None:
    assert not await is_sent_before_a_stop(link, 3_000_000)  # it takes 5 s


@pytest.mark.full
async def test_a_picture_that_is_published_does_not_hold_up_a_stop(link: Link) -> None:
    async def measured() -> float:
        begun = time.monotonic()
        assert not await is_sent_before_a_stop(link, 1_000_000)  # it takes 1.6 s
        return time.monotonic() - begun

    assert await undisturbed_async(measured) <= STOP_S


async def is_sent_before_a_stop(link: Link, size: int) -> bool:
    """Whether so many bytes, which are being published when a stop is sent, are published when that is answered."""
    body = b"\x00\x01\x00\x00" + bytes(8) + size.to_bytes(4, "little") + bytes(size)
    kind = {"topic": "/large", "type": "std_msgs/msg/UInt8MultiArray", "qos": RELIABLE, "epoch": 0}
    before = link.carrier.written_bytes
    sending = asyncio.ensure_future(link.bridge.request("publish", body, timeout_s=PATIENCE_S, **kind))
    while link.carrier.written_bytes == before:
        await asyncio.sleep(0.0)
    await link.bridge.request("stop", timeout_s=PATIENCE_S, epoch=0, **STOP)
    is_sent = sending.done()
    sending.cancel()
    await asyncio.wait({sending})
    return is_sent


async def test_the_flow_of_a_camera_is_measured_although_its_pictures_do_not_cross_the_link(
    link: Link, camera: Camera
) -> None:
    before = link.carrier.received_bytes
    (topic,) = (await measure(Live(Robot(link.bridge), 3.0), [TOPIC])).topics
    crossed = link.carrier.received_bytes - before
    assert topic.count >= 2 and crossed < PICTURE_BYTES
    assert topic.dropped == 0
    assert topic.mean_size_bytes == pytest.approx(PICTURE_BYTES, rel=0.01)


@pytest.mark.full
async def test_the_flow_of_a_camera_is_measured_as_it_is(bridge: Bridge, camera: Camera) -> None:
    async def measured() -> tuple[TopicStats, float]:
        before, begun = camera.published()
        (topic,) = (await measure(Live(Robot(bridge), 3.0), [TOPIC])).topics
        after, ended = camera.published()
        return topic, (after - before) / (ended - begun)

    topic, published_hz = await undisturbed_async(measured)  # a bridge that is starved loses what is best-effort
    # The link itself carries a sixth of it, or less.
    assert topic.rate_hz == pytest.approx(published_hz, rel=0.1)
    assert (topic.dropped, topic.lost) == (0, 0)


async def test_over_a_network_a_camera_is_read_compressed_and_this_is_said(bridge: Bridge, camera: Camera) -> None:
    robot = Robot(bridge)
    found = await read(Live(robot), TOPIC, "", Selection(message_limit=1))
    assert (found.topic_name, found.topic_type) == (f"{TOPIC}/compressed", "sensor_msgs/msg/CompressedImage")
    assert f"compressed pictures on {TOPIC}/compressed were read" in found.note
    assert [picture.width for picture in found.pictures] == [WIDTH]
    several, published = await read_raw(robot, camera)
    assert (several.topic_name, several.topic_type) == (TOPIC, IMAGE)
    assert 1 <= several.count < several.received == several.count + several.dropped
    assert several.received <= published
    assert f"Not received: {several.dropped} message" in several.note


@pytest.mark.full
async def test_all_that_a_camera_publishes_is_counted_although_the_link_carries_less(
    bridge: Bridge, camera: Camera
) -> None:
    several, published = await undisturbed_async(lambda: read_raw(Robot(bridge), camera))
    assert 0.5 * published <= several.received <= published


async def read_raw(robot: Robot, camera: Camera) -> tuple[Reading, int]:
    """What of the raw pictures comes in a while, and how many were published meanwhile."""
    before, _ = camera.published()
    reading = await read(Live(robot), TOPIC, IMAGE, Selection(duration_s=2.5))
    return reading, camera.published()[0] - before


async def test_of_every_nth_picture_those_between_stay_on_the_robot(link: Link, camera: Camera) -> None:
    before = link.carrier.received_bytes
    found = await read(Live(Robot(link.bridge)), TOPIC, IMAGE, Selection(message_limit=2, every_n=EVERY_N))
    assert found.count == 2 and found.received > EVERY_N
    assert link.carrier.received_bytes - before < 4 * PICTURE_BYTES  # the next may be under way


@pytest.mark.full
async def test_every_nth_picture_comes_while_the_link_can_carry_them(bridge: Bridge, camera: Camera) -> None:
    async def measured() -> Reading:
        return await read(Live(Robot(bridge)), TOPIC, IMAGE, Selection(duration_s=DURATION_S, every_n=EVERY_N))

    found = await undisturbed_async(measured)
    assert found.count >= 2
    assert found.dropped <= 1  # the last may still be under way
    assert found.count + found.dropped == (found.received - 1) // EVERY_N + 1
