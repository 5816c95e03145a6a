"""Who listens to a topic as somebody else does shares a subscription of the bridge, and notices nothing of it."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from ros2_mcp.link.connection import Connection
from ros2_mcp.link.sharing import Sharing
from ros2_mcp.link.subscription import Subscription
from ros2_mcp.model.errors import BridgeLost, BridgeRefused
from ros2_mcp.model.samples import Counts
from support.stream_peer import Peer, connected

QOS = {"reliability": "reliable", "durability": "volatile", "history": "keep_last", "depth": 10}
ALIKE: dict[str, Any] = {
    "topic": "/camera",
    "type": "sensor_msgs/msg/Image",
    "qos": QOS,
    "keep": "all",
    "max_samples": 100,
    "max_bytes": 1000,
    "drain_s": 0.005,
}


async def begun(peer: Peer, sharing: Sharing, **other: Any) -> Subscription:
    """A subscription that the bridge has made, of the number 3."""
    asking = asyncio.ensure_future(sharing.subscribe({**ALIKE, **other}))
    peer.say({"id": (await peer.next("subscribe"))["id"], "ok": {"sub": 3}})
    return await asking


async def joined(
    peer: Peer, sharing: Sharing, *, received: int, dropped: int = 0, lost: int | None = 0
) -> Subscription:
    """One more listener, who comes when there was so much already."""
    asking = asyncio.ensure_future(sharing.subscribe(ALIKE))
    question = await peer.next("counts")
    assert (question["sub"], question["after_samples"]) == (3, False)
    peer.say({"id": question["id"], "ok": {"received": received, "dropped": dropped, "lost": lost}})
    return await asking


def say_samples(peer: Peer, bodies: list[bytes], received: int, dropped: int = 0, lost: int | None = 0) -> None:
    heads = [[1, 2, None, len(body), 0] for body in bodies]
    counts = {"received": received, "dropped": dropped, "lost": lost}
    peer.say({"event": "samples", "sub": 3, "samples": heads, **counts}, b"".join(bodies))


async def taken(subscription: Subscription) -> list[bytes]:
    return [sample.data for sample in await subscription.take(0.01)]


async def started() -> tuple[Connection, Peer, Sharing]:
    connection, peer = await connected()
    return connection, peer, Sharing(connection)


async def test_two_who_listen_alike_have_one_subscription_and_each_what_came_after_it_began() -> None:
    _, peer, sharing = await started()
    first = await begun(peer, sharing)
    say_samples(peer, [b"one"], received=1)
    second = await joined(peer, sharing, received=3)  # two wait in the bridge
    say_samples(peer, [b"two", b"three", b"four"], received=4)
    assert await taken(first) == [b"one", b"two", b"three", b"four"]
    assert await taken(second) == [b"four"]
    assert (first.counts, second.counts) == (Counts(4, 0, 0), Counts(1, 0, 0))


async def test_what_is_lost_and_dropped_is_counted_from_the_time_on_at_which_one_began() -> None:
    _, peer, sharing = await started()
    first = await begun(peer, sharing)
    second = await joined(peer, sharing, received=10, dropped=4, lost=2)
    say_samples(peer, [b"x"], received=15, dropped=7, lost=3)
    assert (first.counts, second.counts) == (Counts(15, 7, 3), Counts(5, 3, 1))
    say_samples(peer, [b"y"], received=16, dropped=7, lost=None)
    assert (first.counts, second.counts) == (Counts(16, 7, None), Counts(6, 3, None))


async def test_who_leaves_gets_what_has_arrived_and_the_last_one_ends_the_subscription() -> None:
    _, peer, sharing = await started()
    first = await begun(peer, sharing)
    second = await joined(peer, sharing, received=0)
    leaving = asyncio.ensure_future(first.close())
    question = await peer.next("counts")
    assert question["after_samples"] is True
    say_samples(peer, [b"last of the first"], received=1)
    peer.say_at_once(
        ({"id": question["id"], "ok": {"received": 1, "dropped": 0, "lost": 0}}, b""),
        (
            {"event": "samples", "sub": 3, "samples": [[1, 2, None, 4, 0]], "received": 2, "dropped": 0, "lost": 0},
            b"more",
        ),
    )
    assert await leaving == Counts(1, 0, 0)
    assert (await taken(first), await taken(second)) == ([b"last of the first"], [b"last of the first", b"more"])
    closing = asyncio.ensure_future(second.close())
    ended = await peer.next("unsubscribe")
    say_samples(peer, [b"end"], received=3)
    peer.say({"id": ended["id"], "ok": {"received": 3, "dropped": 0, "lost": 0}})
    assert await closing == Counts(3, 0, 0)
    assert await taken(second) == [b"end"]
    assert await begun(peer, sharing)  # who comes now has a new one


async def test_two_who_leave_at_the_same_time_leave_no_subscription_behind() -> None:
    _, peer, sharing = await started()
    both = [await begun(peer, sharing), await joined(peer, sharing, received=0)]
    leaving = [asyncio.ensure_future(one.close()) for one in both]
    question, ended = await peer.next("counts"), await peer.next("unsubscribe")
    for request in (question, ended):
        peer.say({"id": request["id"], "ok": {"received": 0, "dropped": 0, "lost": 0}})
    await asyncio.gather(*leaving)


async def test_over_a_network_who_leaves_does_not_wait_for_what_is_under_way_to_others() -> None:
    connection, peer, sharing = await started()
    connection.carrier.is_remote = True
    first = await begun(peer, sharing)
    second = await joined(peer, sharing, received=0)
    say_samples(peer, [b"x"], received=1)
    assert await first.close() == Counts(1, 0, 0)
    say_samples(peer, [b"y"], received=2)
    assert (await taken(first), await taken(second)) == ([b"x"], [b"x", b"y"])


async def test_those_who_come_while_it_is_made_wait_for_it() -> None:
    _, peer, sharing = await started()
    asking = [asyncio.ensure_future(sharing.subscribe(ALIKE)) for _ in range(3)]
    peer.say({"id": (await peer.next("subscribe"))["id"], "ok": {"sub": 3}})
    for _ in range(2):
        peer.say({"id": (await peer.next("counts"))["id"], "ok": {"received": 0, "dropped": 0, "lost": 0}})
    listeners = await asyncio.gather(*asking)
    say_samples(peer, [b"x"], received=1)
    assert [await taken(one) for one in listeners] == [[b"x"]] * 3
    assert "subscribe" not in [packet.header["op"] for packet in peer.heard]  # another one


@pytest.mark.parametrize("is_cancelled", [True, False])
async def test_if_the_first_gives_up_or_is_refused_the_next_makes_one(is_cancelled: bool) -> None:
    _, peer, sharing = await started()
    first, second = (asyncio.ensure_future(sharing.subscribe(ALIKE)) for _ in range(2))
    request = await peer.next("subscribe")
    if is_cancelled:
        first.cancel()
    else:
        peer.say({"id": request["id"], "error": {"kind": "bad_request", "message": "no", "hint": ""}})
    peer.say({"id": (await peer.next("subscribe"))["id"], "ok": {"sub": 3}})
    assert await second
    with pytest.raises(asyncio.CancelledError if is_cancelled else BridgeRefused):
        await first


async def test_who_gives_up_while_he_joins_leaves_the_others_theirs() -> None:
    _, peer, sharing = await started()
    first = await begun(peer, sharing)
    joins = asyncio.ensure_future(sharing.subscribe(ALIKE))
    await peer.next("counts")
    joins.cancel()
    await peer.next("cancel")
    say_samples(peer, [b"x"], received=1)
    assert await taken(first) == [b"x"]
    leaves = asyncio.ensure_future(first.close())
    ended = await peer.next("unsubscribe")
    peer.say({"id": ended["id"], "ok": {"received": 1, "dropped": 0, "lost": 0}})
    assert await leaves == Counts(1, 0, 0)


async def test_if_the_first_leaves_while_another_who_joins_gives_up_nothing_is_left_behind() -> None:
    _, peer, sharing = await started()
    first = await begun(peer, sharing)
    joins = asyncio.ensure_future(sharing.subscribe(ALIKE))
    await peer.next("counts")
    leaves = asyncio.ensure_future(first.close())
    peer.say({"id": (await peer.next("counts"))["id"], "ok": {"received": 0, "dropped": 0, "lost": 0}})
    await leaves
    joins.cancel()
    assert (await peer.next("unsubscribe"))["sub"] == 3


async def test_the_end_of_the_bridge_is_told_to_all() -> None:
    connection, peer, sharing = await started()
    both = [await begun(peer, sharing), await joined(peer, sharing, received=0)]
    third = asyncio.ensure_future(sharing.subscribe(ALIKE))
    await peer.next("counts")
    connection.fail(BridgeLost("It died."))
    for one in both:
        with pytest.raises(BridgeLost):
            await one.take(1)
        await one.close()
    with pytest.raises(BridgeLost):
        await third


@pytest.mark.parametrize(
    "other",
    [
        {"topic": "/other"},
        {"max_bytes": 2000},
        {"drain_s": 1.0},
        {"qos": {**QOS, "reliability": "best_effort"}},
    ],
)
async def test_who_listens_otherwise_has_a_subscription_of_his_own(other: dict[str, Any]) -> None:
    _, peer, sharing = await started()
    await begun(peer, sharing)
    await begun(peer, sharing, **other)


@pytest.mark.parametrize("other", [{"keep": "latest"}, {"qos": {**QOS, "durability": "transient_local"}}])
async def test_the_latest_sample_and_what_is_latched_are_not_shared(other: dict[str, Any]) -> None:
    _, peer, sharing = await started()
    for _ in range(2):
        await begun(peer, sharing, **other)
