"""The link over a bare socket: whatever works here needs no process, no /proc, no signals and no log of the bridge."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
from collections.abc import AsyncIterator

import pytest

from ros2_mcp.link.client import Bridge
from ros2_mcp.link.environment import find_ros
from ros2_mcp.model.errors import BridgeLost, LinkError
from ros2_mcp.settings import Settings
from support.agent import FULL
from support.socket_carrier import FarBridge, SocketCarrier

PATIENCE_S = 30.0
SILENT_S = r"[4-9]\.\d" if FULL else r"([4-9]|\d\d+)\.\d"
TOPIC, STRING_TYPE = "/over_a_socket", "std_msgs/msg/String"
QOS = {"reliability": "reliable", "durability": "volatile", "history": "keep_last", "depth": 100}
STRING = b"\x00\x01\x00\x00\x06\x00\x00\x00hello\x00"


class Link:
    """A bridge over sockets, and the processes behind them: one for each life."""

    def __init__(self, domain_id: int, env: dict[str, str]) -> None:
        self.installation = find_ros(Settings(domain_id=domain_id), env)
        self.far: list[FarBridge] = []
        self.bridge = Bridge(self._start)

    def _start(self) -> SocketCarrier:
        self.far.append(FarBridge(self.installation))
        return SocketCarrier(self.far[-1].near)


@pytest.fixture
async def link(domain_id: int, ros_environment: dict[str, str]) -> AsyncIterator[Link]:
    link = Link(domain_id, ros_environment)
    link.bridge.launch()
    try:
        yield link
    finally:
        await link.bridge.close()
        for far in link.far:
            try:
                far.process.wait(PATIENCE_S)  # nobody has told it to leave but the end of its stream
            except subprocess.TimeoutExpired:
                os.killpg(far.process.pid, signal.SIGKILL)
                far.process.wait()
                raise


async def test_requests_and_samples_go_through_it(link: Link) -> None:
    hello = await link.bridge.ready()
    assert hello.pid == link.far[0].process.pid
    assert link.bridge.origin == "behind a socket"
    async with await link.bridge.subscribe(
        TOPIC, STRING_TYPE, QOS, keep="all", max_samples=100, max_bytes=10_000_000
    ) as subscription:
        sent = await link.bridge.request(
            "publish",
            STRING,
            timeout_s=PATIENCE_S,
            topic=TOPIC,
            type=STRING_TYPE,
            qos=QOS,
            epoch=0,
            wait_match_s=10,
            wait_ack_s=10,
        )
        assert sent.ok["matched"] == 1
        assert [sample.data[: len(STRING)] for sample in await subscription.take(PATIENCE_S)] == [STRING]
    assert subscription.counts.received == 1


async def test_a_large_body_goes_through_it_while_pings_go_on(link: Link) -> None:
    size = 10_000_000
    body = b"\x00\x01\x00\x00" + bytes(4) + bytes(4) + size.to_bytes(4, "little") + os.urandom(size)
    topic, kind = "/large_over_a_socket", "std_msgs/msg/UInt8MultiArray"
    async with await link.bridge.subscribe(
        topic, kind, QOS, keep="all", max_samples=10, max_bytes=50_000_000
    ) as subscription:
        await link.bridge.request(
            "publish", body, timeout_s=40, topic=topic, type=kind, qos=QOS, epoch=0, wait_match_s=10, wait_ack_s=10
        )
        assert [sample.data[: len(body)] for sample in await subscription.take(PATIENCE_S)] == [body]
    assert link.bridge.restarts == []


async def test_who_waits_hears_of_its_loss_and_the_next_call_has_a_new_one(link: Link) -> None:
    await link.bridge.ready()
    waiting = asyncio.ensure_future(
        link.bridge.request("wait_endpoints", topic="/nobody", publishers=1, subscribers=0, timeout_s=90)
    )
    subscription = await link.bridge.subscribe(TOPIC, STRING_TYPE, QOS, keep="all", max_samples=10, max_bytes=1000)
    link.far[0].process.kill()
    for lost in (waiting, subscription.take(90)):
        with pytest.raises(BridgeLost, match=r"The bridge \(behind a socket\) closed its stream and is started again"):
            await lost
    await link.bridge.request("ping", timeout_s=PATIENCE_S)
    assert (link.bridge.generation, len(link.far)) == (2, 2)
    assert (await link.bridge.ready()).pid == link.far[1].process.pid


async def test_one_that_falls_silent_is_given_up_although_nobody_can_see_why(link: Link) -> None:
    silent = link.far[0].process
    await link.bridge.ready()
    waiting = asyncio.ensure_future(
        link.bridge.request("wait_endpoints", topic="/nobody", publishers=1, subscribers=0, timeout_s=90)
    )
    await link.bridge.request("ping", timeout_s=PATIENCE_S)
    silent.send_signal(signal.SIGSTOP)
    try:
        with pytest.raises(BridgeLost, match=rf"stopped answering for {SILENT_S} s"):
            await waiting
    finally:
        silent.send_signal(signal.SIGCONT)
    await link.bridge.request("ping", timeout_s=PATIENCE_S)
    assert link.bridge.generation == 2


async def test_closing_the_link_ends_what_is_far_behind_it(link: Link) -> None:
    await link.bridge.ready()
    await link.bridge.close()
    assert link.far[0].process.wait(PATIENCE_S) == 0


async def test_a_bridge_that_ends_before_its_hello_is_told_and_tried_again(
    domain_id: int, ros_environment: dict[str, str]
) -> None:
    link = Link(domain_id, ros_environment)
    started: list[SocketCarrier] = []

    def start() -> SocketCarrier:
        far = FarBridge(link.installation)
        started.append(SocketCarrier(far.near))
        if len(started) == 1:
            far.process.kill()
        link.far.append(far)
        return started[-1]

    async with Bridge(start) as bridge:
        with pytest.raises(LinkError, match=r"The bridge \(behind a socket\) closed its stream before it was ready"):
            await bridge.ready()
        await bridge.ready()
        assert len(started) == 2
    assert [far.process.wait(PATIENCE_S) for far in link.far] == [-signal.SIGKILL, 0]
