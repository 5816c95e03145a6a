"""The protocol as the server's side speaks it, against a peer in memory."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from ros2_mcp.link.connection import Connection
from ros2_mcp.link.subscription import Subscription
from ros2_mcp.model.errors import BridgeLost, BridgeRefused, LinkError
from ros2_mcp.model.samples import Counts
from support.rounds import FULL
from support.stream_peer import Peer, connected

Play = Callable[[Coroutine[Any, Any, None]], None]


async def test_answers_find_their_askers_in_any_order() -> None:
    connection, peer = await connected()
    asks = [asyncio.ensure_future(connection.request("topics", b"", 5, {"n": n})) for n in range(3)]
    requests = [await peer.next("topics") for _ in asks]
    for request in reversed(requests):
        peer.say({"id": request["id"], "ok": {"n": request["n"]}}, b"b" * request["n"])
    replies = await asyncio.gather(*asks)
    assert [(reply.ok["n"], reply.body) for reply in replies] == [(0, b""), (1, b"b"), (2, b"bb")]


async def test_a_refusal_keeps_its_kind_message_and_hint() -> None:
    connection, peer = await connected()
    ask = asyncio.ensure_future(connection.request("node", b"", 5, {}))
    error = {"kind": "not_found", "message": "no such node", "hint": "look"}
    peer.say({"id": (await peer.next("node"))["id"], "error": error})
    with pytest.raises(BridgeRefused) as refused:
        await ask
    assert (refused.value.kind, str(refused.value)) == ("not_found", "no such node look")


async def test_the_rules_of_a_policy_are_the_first_that_a_bridge_hears() -> None:
    _, peer = await connected(rules=lambda: b'{"digest": "d"}')
    assert [(packet.header["op"], packet.body) for packet in peer.heard] == [("policy", b'{"digest": "d"}')]


async def test_a_bridge_that_does_not_take_the_rules_is_given_up() -> None:
    connection, peer = await connected(rules=lambda: b"{}")
    error = {"kind": "bad_request", "message": "These rules cannot be read.", "hint": ""}
    peer.say({"id": (await peer.next("policy"))["id"], "error": error})
    assert "rejected the policy: These rules cannot be read." in (await connection.run()).message


async def test_cancelling_the_asker_cancels_that_request() -> None:
    connection, peer = await connected()
    ask = asyncio.ensure_future(connection.request("call", b"x", 5, {}))
    request = await peer.next("call")
    ask.cancel()
    assert (await peer.next("cancel"))["request"] == request["id"]
    assert request["timeout_s"] == 5


async def test_the_last_counts_of_a_relay_whose_asker_was_cancelled_are_told() -> None:
    told: list[Any] = []
    connection, peer = await connected(relay_ended=lambda *end: told.append(end))
    ask = asyncio.ensure_future(connection.request("relay", b"", 5, {"name": "relay_1"}))
    request = await peer.next("relay")
    ask.cancel()
    await peer.next("cancel")
    peer.say({"id": request["id"], "ok": {"passed": 12}})
    assert told == [("relay_1", {"passed": 12})]


async def test_a_subscription_whose_asker_was_cancelled_is_ended_when_its_answer_comes() -> None:
    connection, peer = await connected()
    ask = asyncio.ensure_future(connection.subscribe(subscription_of(connection), 5, {}))
    request = await peer.next("subscribe")
    ask.cancel()
    await peer.next("cancel")
    peer.say({"id": request["id"], "ok": {"sub": 9}})
    assert (await peer.next("unsubscribe"))["sub"] == 9


async def test_a_subscription_answered_in_the_moment_of_the_cancel_is_ended_too() -> None:
    connection, peer = await connected()
    ask = asyncio.ensure_future(connection.subscribe(subscription_of(connection), 5, {}))
    request = await peer.next("subscribe")
    peer.say({"id": request["id"], "ok": {"sub": 9}})
    ask.cancel()
    assert (await peer.next("unsubscribe"))["sub"] == 9


async def test_samples_that_follow_in_the_same_breath_as_the_answer_are_kept() -> None:
    connection, peer = await connected()
    subscription = subscription_of(connection)
    ask = asyncio.ensure_future(connection.subscribe(subscription, 5, {}))
    request = await peer.next("subscribe")
    peer.say_at_once(({"id": request["id"], "ok": {"sub": 3}}, b""), samples(3, [b"ab", b"c"], 2))
    await ask
    assert [sample.data for sample in await subscription.take(1)] == [b"ab", b"c"]


async def test_every_sample_is_taken_or_counted_as_dropped() -> None:
    connection, peer = await connected()
    subscription = await subscribed(connection, peer, max_samples=10, max_bytes=35)
    peer.say(*samples(3, [b"12345"] * 20, received=25, dropped=5))
    taken = await subscription.take(1)
    assert len(taken) == 7  # 35 bytes are the tighter bound
    assert subscription.counts == Counts(received=25, dropped=5 + 13, lost=0)
    peer.say(*samples(3, [bytes(100)], received=26, dropped=5))
    assert [len(sample.data) for sample in await subscription.take(1)] == [100]


async def test_the_latest_only_means_one_sample() -> None:
    connection, peer = await connected()
    subscription = await subscribed(connection, peer, keep="latest")
    peer.say(*samples(3, [b"old", b"new"], received=2))
    assert [sample.data for sample in await subscription.take(1)] == [b"new"]
    assert subscription.counts.dropped == 1
    assert await subscription.take(0.01) == []


async def test_closing_takes_in_the_last_samples_and_the_final_counts() -> None:
    connection, peer = await connected()
    subscription = await subscribed(connection, peer)
    closing = asyncio.ensure_future(subscription.close())
    request = await peer.next("unsubscribe")
    peer.say(*samples(3, [b"last"], received=8))
    peer.say({"id": request["id"], "ok": {"received": 8, "dropped": 7, "lost": None}})
    assert await closing == Counts(8, 7, None)
    assert [sample.data for sample in await subscription.take(1)] == [b"last"]


async def test_a_peer_that_dies_fails_everything_under_way_and_says_how() -> None:
    connection, peer = await connected()
    life = asyncio.ensure_future(connection.run())
    subscription = await subscribed(connection, peer)
    take = asyncio.ensure_future(subscription.take(5))
    asks = [asyncio.ensure_future(connection.request("call", b"", 5, {})) for _ in range(3)]
    await asyncio.sleep(0.01)
    peer.end("died with signal SIGKILL")
    for waiting in (take, *asks):
        with pytest.raises(BridgeLost, match="died with signal SIGKILL"):
            await waiting
    assert "SIGKILL" in str(await life)
    assert await subscription.close() == Counts()


async def test_a_peer_that_falls_silent_is_given_up_after_four_seconds() -> None:
    connection, _ = await connected()
    life = asyncio.ensure_future(connection.run())
    ask = asyncio.ensure_future(connection.request("call", b"", 30, {}))
    begun, late = asyncio.get_running_loop().time(), [0.0]
    clock = asyncio.ensure_future(lateness(late))
    with pytest.raises(BridgeLost, match="stopped answering for " + (r"4\.0 s" if FULL else r"\d+\.\d s")):
        await ask
    took_s = asyncio.get_running_loop().time() - begun
    assert took_s > 3.9
    if FULL:
        assert took_s < 4.5 + late[0]
    clock.cancel()
    await life


async def test_a_peer_that_wants_to_run_but_gets_no_processor_is_waited_for_longer() -> None:
    connection, peer = await connected("starved")
    life = asyncio.ensure_future(connection.run())
    await asyncio.sleep(1.2)
    assert not life.done()
    peer.end()
    await life


async def test_our_own_lateness_is_not_taken_for_the_silence_of_the_peer() -> None:
    connection, peer = await connected()
    life = asyncio.ensure_future(connection.run())
    await asyncio.sleep(0.1)
    time.sleep(1.2)  # noqa: ASYNC251 - a loop that is blocked is what this is about
    await asyncio.sleep(0.3)
    assert not life.done()
    peer.end()
    await life


async def test_a_ros_thread_that_hangs_ends_the_life_of_the_bridge() -> None:
    connection, peer = await connected()
    life = asyncio.ensure_future(connection.run())
    await asyncio.sleep(0.01)
    peer.say({"id": 0, "ok": {"ros_idle_s": 4.4, "now_ns": 1, "sent_ns": 1}})
    assert "its ROS thread has hung for 4.4 s" in str(await life)


@pytest.mark.parametrize("is_remote", [True, False])
async def test_over_a_network_a_ping_tells_what_was_heard_last(is_remote: bool) -> None:
    """By which the bridge knows how long it was under way: no clock of this machine has to be like that one's."""
    connection, peer = await connected(is_remote=is_remote)
    life = asyncio.ensure_future(connection.run())
    peer.say({"id": 0, "ok": {"ros_idle_s": 0.0, "now_ns": 1, "sent_ns": 1, "steady_s": 12.5}})
    while len(peer.pings) < 3:
        await asyncio.sleep(0.01)
    assert [ping.get("heard_s") for ping in (peer.pings[0], peer.pings[-1])] == (
        [0.0, 12.5] if is_remote else [None] * 2
    )
    life.cancel()


async def test_at_rest_pings_are_seldom_and_a_request_follows_one_with_the_usual_lease() -> None:
    """The bridge has to know before anything moves how long it may do so without a sign of this server."""
    connection, peer = await connected()
    life = asyncio.ensure_future(connection.run())
    answering = asyncio.ensure_future(answer_pings(peer))
    while len(peer.pings) < 3:  # that of the greeting, and two at rest
        await asyncio.sleep(0.01)
    ask = asyncio.ensure_future(connection.request("call", b"", 30, {}))
    number = (await peer.next("call"))["id"]
    leases = [ping["lease_s"] for ping in peer.pings]
    assert leases[1:3] == [4 * peer.lease_s] * 2 and leases[3] == peer.lease_s
    while len(peer.pings) < 6:
        await asyncio.sleep(0.01)
    assert {ping["lease_s"] for ping in peer.pings[3:]} == {peer.lease_s}
    peer.say({"id": number, "ok": {}})
    await ask
    for task in (answering, life):
        task.cancel()


async def answer_pings(peer: Peer) -> None:
    while True:
        peer.say({"id": 0, "ok": {"ros_idle_s": 0.0, "now_ns": 1, "sent_ns": 1}})
        await asyncio.sleep(0.1)


async def test_bytes_that_are_no_packet_end_the_connection() -> None:
    connection, peer = await connected()
    life = asyncio.ensure_future(connection.run())
    peer.say_raw(b"Hello from a print statement")
    assert "not part of the protocol" in str(await life)


@pytest.mark.parametrize("how", ["failed", "exit"])
async def test_a_bridge_that_cannot_begin_says_why(how: str) -> None:
    peer = Peer()
    greeting = asyncio.ensure_future(Connection(peer).greet())
    await asyncio.sleep(0)
    if how == "failed":
        peer.say({"event": "failed", "kind": "no_rclpy", "message": "No module named 'rclpy'"})
    else:
        peer.log.append("No module named 'rclpy'")
        peer.end("exited with code 1")
    reason = await greeting
    assert isinstance(reason, LinkError)
    assert "No module named 'rclpy'" in reason.message
    assert how == "failed" or "exited with code 1" in reason.message


async def lateness(late: list[float]) -> None:
    """Adds up how much later than it should this process gets its turn: that is no silence of the peer."""
    now = asyncio.get_running_loop().time
    while True:
        due = now() + 0.02
        await asyncio.sleep(0.02)
        late[0] += now() - due


def subscription_of(
    connection: Connection, keep: str = "all", max_samples: int = 100, max_bytes: int = 10_000
) -> Subscription:
    return Subscription(keep, max_samples, max_bytes, connection.unsubscribe)


async def subscribed(connection: Connection, peer: Peer, **bounds: Any) -> Subscription:
    subscription = subscription_of(connection, **bounds)
    ask = asyncio.ensure_future(connection.subscribe(subscription, 5, {}))
    peer.say({"id": (await peer.next("subscribe"))["id"], "ok": {"sub": 3}})
    await ask
    return subscription


def samples(number: int, data: list[bytes], received: int, dropped: int = 0) -> tuple[dict[str, Any], bytes]:
    rows = [[1, 0, None, len(one), 0] for one in data]
    header = {"event": "samples", "sub": number, "samples": rows, "received": received, "dropped": dropped, "lost": 0}
    return header, b"".join(data)
