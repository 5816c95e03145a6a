"""Large requests over a slow link: in pieces, as far as the bridge acknowledges them, and others pass."""

from __future__ import annotations

import asyncio
import os
from typing import Any

import pytest

from ros2_mcp.link.connection import Connection
from ros2_mcp.link.subscription import Subscription
from ros2_mcp_common.wire.limits import FIRST_PIECE_BYTES, FIRST_WINDOW_BYTES, PIECE_BYTES, WINDOW_BYTES
from ros2_mcp_common.wire.packets import Packet, pack
from ros2_mcp_common.wire.pieces import Cut, Lanes
from support.stream_peer import Peer, connected

PICTURE = os.urandom(10 * PIECE_BYTES)
IN_WINDOW = FIRST_WINDOW_BYTES // FIRST_PIECE_BYTES


class Bridge:
    """The other end: takes pieces, and acknowledges them when told to."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self.lanes = Lanes()
        self.wholes: list[Packet] = []

    def take(self) -> list[str]:
        """The operations that have come since the last time."""
        found = list(self._peer.heard)
        self._peer.heard.clear()
        for packet in found:
            if packet.header["op"] == "piece":
                self.wholes += self.lanes.feed(*packet)
        return [packet.header["op"] for packet in found]

    def acknowledge(self) -> None:
        self._peer.say({"event": "ack", "bytes": self.lanes.taken_bytes})

    def take_all(self) -> Packet:
        """The next packet that is whole."""
        while not self.wholes:
            assert self.take(), "nothing came"
            self.acknowledge()
        return self.wholes.pop(0)


async def far_away() -> tuple[Connection, Peer, Bridge]:
    connection, peer = await connected(is_remote=True)
    return connection, peer, Bridge(peer)


async def begin(connection: Connection, op: str, body: bytes = b"", **arguments: Any) -> asyncio.Task[Any]:
    asking = asyncio.create_task(connection.request(op, body, 5, arguments))
    await asyncio.sleep(0)
    return asking


async def test_a_stop_passes_a_picture_that_is_being_published() -> None:
    connection, peer, bridge = await far_away()
    publishing = await begin(connection, "publish", PICTURE)
    assert bridge.take() == ["piece"] * IN_WINDOW
    stopping = await begin(connection, "stop")
    assert bridge.take() == ["stop"]
    bridge.acknowledge()
    whole = bridge.take_all()
    assert (whole.header["op"], whole.body) == ("publish", PICTURE)
    for asking, number in ((stopping, 2), (publishing, 1)):
        peer.say({"id": number, "ok": {}})
        await asking


async def test_one_that_is_cancelled_on_its_way_was_never_sent_and_the_next_one_arrives() -> None:
    connection, peer, bridge = await far_away()
    publishing = await begin(connection, "publish", PICTURE)
    assert bridge.take() == ["piece"] * IN_WINDOW
    next_one = await begin(connection, "publish", PICTURE, topic="/next")
    publishing.cancel()
    await asyncio.wait({publishing})
    bridge.acknowledge()
    whole = bridge.take_all()
    assert (whole.header["topic"], whole.body) == ("/next", PICTURE)
    assert bridge.take() == []  # nothing is cancelled that the bridge has not heard of
    peer.say({"id": whole.header["id"], "ok": {}})
    await next_one


async def test_one_that_is_cancelled_after_all_of_it_has_left_is_cancelled_there() -> None:
    connection, _, bridge = await far_away()
    publishing = await begin(connection, "publish", PICTURE)
    number = bridge.take_all().header["id"]
    publishing.cancel()
    await asyncio.wait({publishing})
    peer_heard = bridge.take()
    assert (peer_heard, number) == (["cancel"], 1)


async def test_samples_in_pieces_are_put_together_and_acknowledged() -> None:
    connection, peer, _ = await far_away()
    subscription = Subscription("all", 10, 10_000_000, connection.unsubscribe)
    asking = asyncio.create_task(connection.subscribe(subscription, 5, {}))
    peer.say({"id": (await peer.next("subscribe"))["id"], "ok": {"sub": 3}})
    await asking
    header = {"event": "samples", "sub": 3, "samples": [[1, 0, None, len(PICTURE), 0]], "received": 1, "dropped": 0}
    leaving = Cut("event", 3, pack({**header, "lost": 0}, PICTURE))
    total = 0
    while leaving.left_bytes:
        piece, size = leaving.take()
        peer.say_raw(piece)
        total += size
        assert (await peer.next("ack"))["bytes"] == total
    assert [sample.data for sample in await subscription.take(5)] == [PICTURE]


@pytest.mark.parametrize("is_remote", [True, False])
async def test_a_bridge_on_this_machine_is_sent_no_pieces(is_remote: bool) -> None:
    connection, peer = await connected(is_remote=is_remote)
    publishing = await begin(connection, "publish", bytes(WINDOW_BYTES // 2))
    for _ in range(3):
        await asyncio.sleep(0)
    assert {packet.header["op"] for packet in peer.heard} == {"piece" if is_remote else "publish"}
    publishing.cancel()
    await asyncio.wait({publishing})
