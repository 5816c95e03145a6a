"""The bridge as its server sees it: raw packets to a real process, checked against independent ROS nodes."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp_bridge.ros.participants import ports_of
from support.agent import FULL, until
from support.bridge_client import BEST_EFFORT, PATIENCE_S, RELIABLE, STRING, Client, cdr_string, line, says
from support.standstill import undisturbed

SET_BOOL = "std_srvs/srv/SetBool"
TRUE, FALSE = b"\0\1\0\0\1", b"\0\1\0\0\0"
ALL = {"keep": "all", "max_samples": 100_000, "max_bytes": 100_000_000}
FLOOD = 8000 if FULL else 4000
"""Messages, at 4000 Hz."""
ANSWER_S = 10.0
"""After it an answer does not come: a server drops its first ones where it knows the client late."""


def received(bridge: Client) -> int:
    return sum(len(header["samples"]) for header, _ in sampled(bridge))


def sampled(bridge: Client) -> list[tuple[dict[str, Any], bytes]]:
    return [(header, body) for header, body in bridge.samples if "samples" in header]


def newest(bridge: Client) -> int:
    """The sequence number of the message that came last."""
    found = sampled(bridge)
    return found[-1][0]["samples"][-1][2] if found else 0


def all_arrived(bridge: Client, flood: subprocess.Popen[bytes]) -> int:
    """How many messages a flood has sent, as soon as its last one is here: none before it is still under way."""
    assert flood.stdin
    sent, deadline = int(line(flood)), time.monotonic() + PATIENCE_S
    while newest(bridge) != sent:
        assert time.monotonic() < deadline, "the last message does not arrive"
        flood.stdin.write(b"\n")  # best effort may lose the last one, too, but not one after the other
        flood.stdin.flush()
        sent, look_until = int(line(flood)), time.monotonic() + 1
        while newest(bridge) != sent and time.monotonic() < look_until:
            bridge.ok("stats")
            time.sleep(0.01)
    return sent


def publish(bridge: Client, topic: str, text: str, **changed: Any) -> dict[str, Any]:
    arguments = {
        "topic": topic,
        "type": STRING,
        "qos": RELIABLE,
        "wait_match_s": PATIENCE_S,
        "wait_ack_s": PATIENCE_S,
        "epoch": 0,
        **changed,
    }
    return bridge.ok("publish", cdr_string(text), **arguments)


def wait_subscribers(bridge: Client, topic: str, count: int) -> list[dict[str, Any]]:
    wanted = {"topic": topic, "publishers": 0, "subscribers": count}
    return bridge.ok("wait_endpoints", timeout_s=PATIENCE_S, **wanted)["subscribers"]


def call(bridge: Client, service: str, body: bytes = TRUE, **changed: Any) -> int:
    arguments = {"service": service, "type": SET_BOOL, "wait_s": PATIENCE_S, "timeout_s": PATIENCE_S, **changed}
    return bridge.send("call", body, **arguments)


def response(bridge: Client, body: bytes, **service: str) -> bytes:
    """The answer of a server to a call that does no harm twice: it is asked again where it has dropped its answer."""
    for _ in range(5):
        request = bridge.send("call", body, wait_s=PATIENCE_S, timeout_s=ANSWER_S, **service)
        header, answer = bridge.answer(request)
        if "ok" in header:
            return answer
        assert header["error"]["kind"] == "timeout", header
    raise AssertionError(f"{service} does not answer")


def test_it_says_hello_with_its_node_and_versions(bridge: Client, domain_id: int) -> None:
    assert bridge.hello["event"] == "hello"
    assert bridge.hello["protocol"] == 5
    assert bridge.hello["domain_id"] == domain_id
    assert bridge.hello["pid"] == bridge.process.pid
    assert [bridge.hello["node"][1:], "/"] in bridge.ok("nodes", settle_s=0)["nodes"]


def test_the_first_listing_is_whole(start, peer) -> None:
    forty_topics(peer)
    check_first_listing(start)


@pytest.mark.full
def test_the_first_listing_takes_less_than_five_seconds(start, peer) -> None:
    forty_topics(peer)

    def listed_after() -> float:
        started = time.monotonic()
        check_first_listing(start)
        return time.monotonic() - started

    assert undisturbed(listed_after) < 5


def forty_topics(peer) -> None:
    for prefix, count in (("a", 14), ("b", 13), ("c", 13)):
        peer("topics", prefix, str(count))


def check_first_listing(start) -> None:
    """That the first answer of a new bridge, which has settled, has all topics."""
    listing = Client(start("ros2_mcp_bridge")).ok("topics", settle_s=PATIENCE_S)
    assert listing["settled"]
    assert sum(name[2:4] == "/t" and publishers == 1 for name, _, publishers, _ in listing["topics"]) == 40


def test_of_many_topics_only_those_are_counted_that_are_asked_for(bridge: Client, peer) -> None:
    peer("topics", "d", "3")
    bridge.ok("wait_endpoints", topic="/d/t2", publishers=1, timeout_s=PATIENCE_S)
    listed = {name: tuple(counts) for name, _, *counts in bridge.ok("topics", settle_s=PATIENCE_S)["topics"]}
    uncounted = bridge.ok("topics", count_most=len(listed) - 1)
    assert {tuple(counts) for _, _, *counts in uncounted["topics"]} == {(-1, -1)} and uncounted["nodes"]
    counted = bridge.ok("counted", topics=["/d/t2", "/nobody", "/d/t0"])["counted"]
    assert [tuple(each) for each in counted] == [listed["/d/t2"], (0, 0), listed["/d/t0"]] and listed["/d/t2"] == (1, 0)


def test_endpoints_tell_node_type_hash_and_qos(bridge: Client, peer, name: str) -> None:
    peer("listen", name, "BEST_EFFORT")
    found = wait_subscribers(bridge, name, 1)[0]
    assert (found["node"], found["namespace"], found["type"]) == ("listen_peer", "/", STRING)
    assert found["hash"].startswith("RIHS01_")
    assert found["qos"]["reliability"] == "best_effort"
    assert found["qos"]["deadline_ns"] is None
    node = bridge.ok("node", name="listen_peer", namespace="/", settle_s=PATIENCE_S)
    assert [name, [STRING]] in node["subscribers"]
    assert bridge.error("node", name="nobody", namespace="/", settle_s=3)["kind"] == "not_found"
    error = bridge.error("wait_endpoints", topic=name, publishers=1, subscribers=0, timeout_s=0.1)
    assert error["kind"] == "timeout"


def test_definitions_come_with_everything_they_refer_to(bridge: Client) -> None:
    wanted = ["test_msgs/msg/MultiNested", "test_msgs/action/NestedMessage_FeedbackMessage", "no_msgs/msg/No"]
    found = bridge.ok("definitions", types=wanted)
    assert found["missing"] == ["no_msgs/msg/No"]
    assert set(found["definitions"]) >= {
        "test_msgs/msg/MultiNested",
        "test_msgs/msg/BoundedSequences",
        "test_msgs/msg/BasicTypes",
        "test_msgs/action/NestedMessage",
        "test_msgs/msg/Builtins",
        "unique_identifier_msgs/msg/UUID",
        "action_msgs/msg/GoalStatusArray",
    }
    assert {entry["format"] for entry in found["definitions"].values()} == {"msg", "action", "srv"}
    interfaces = bridge.ok("interfaces")["interfaces"]
    assert {"std_msgs/msg/String", SET_BOOL, "test_msgs/action/Fibonacci"} <= set(interfaces)


def test_a_definition_that_cannot_be_read_is_an_error_and_the_bridge_goes_on(start, tmp_path: Path) -> None:
    broken = tmp_path / "share/broken_msgs/msg/Broken.msg"
    broken.parent.mkdir(parents=True)
    broken.write_bytes(b"string text # \xff\n")
    bridge = Client(start("ros2_mcp_bridge", env={"AMENT_PREFIX_PATH": f"{sys.prefix}{os.pathsep}{tmp_path}"}))
    assert bridge.error("definitions", types=["broken_msgs/msg/Broken"])["kind"] == "ros_error"
    assert "ros_idle_s" in bridge.ok("ping")


@pytest.mark.parametrize("reliability", ["RELIABLE", "BEST_EFFORT"])
def test_every_message_of_a_fast_topic_is_counted_while_requests_are_answered(
    bridge: Client, peer, name: str, reliability: str
) -> None:
    # While it went on, and not all at its end. Its second may be over while this process is held up: of three floods.
    assert any(
        len(answer_times_beside_a_flood(bridge, peer, f"{name}_{number}", reliability)) >= 5 for number in range(3)
    )


@pytest.mark.full
@pytest.mark.parametrize("reliability", ["RELIABLE", "BEST_EFFORT"])
def test_beside_a_fast_topic_requests_are_answered_within_a_tenth_of_a_second(
    bridge: Client, peer, name: str, reliability: str
) -> None:
    delays = answer_times_beside_a_flood(bridge, peer, name, reliability)
    assert sorted(delays)[len(delays) * 9 // 10] < 0.1


def answer_times_beside_a_flood(bridge: Client, peer, topic: str, reliability: str) -> list[float]:
    """How long each request took that was answered while the flood went on, in s; all of the flood is counted."""
    bridge.samples.clear()
    flood = peer("flood", topic, reliability, "4000", str(FLOOD))
    knows_the_publisher(bridge, topic)
    qos = RELIABLE if reliability == "RELIABLE" else BEST_EFFORT
    number = bridge.ok("subscribe", topic=topic, type=STRING, qos=qos, **ALL)["sub"]
    delays = []
    while not says(flood):
        started = time.monotonic()
        bridge.ok("stats")
        delays.append(time.monotonic() - started)
        time.sleep(0.01)
    sent = all_arrived(bridge, flood)
    assert sent >= FLOOD
    counts = bridge.ok("unsubscribe", sub=number)
    assert counts["received"] + counts["lost"] == sent
    assert counts["dropped"] == 0
    assert received(bridge) == counts["received"]
    last, body = sampled(bridge)[-1]
    assert last["received"] == counts["received"]
    assert body.startswith(cdr_string("x" * 40)[:-3])
    return delays


def test_what_the_server_does_not_read_is_bounded_and_counted(bridge: Client, peer, name: str) -> None:
    flood = peer("flood", name, "RELIABLE", "4000", str(FLOOD))
    knows_the_publisher(bridge, name)
    bounds = {"keep": "all", "max_samples": 50, "max_bytes": 100_000_000}
    request = bridge.send("subscribe", topic=name, type=STRING, qos=RELIABLE, **bounds)
    select.select([flood.stdout], [], [])
    number = bridge.answer(request)[0]["ok"]["sub"]
    sent = all_arrived(bridge, flood)
    counts = bridge.ok("unsubscribe", sub=number)
    assert counts["received"] + counts["lost"] == sent
    assert counts["dropped"] > 0
    assert received(bridge) == counts["received"] - counts["dropped"]


def knows_the_publisher(bridge: Client, topic: str) -> None:
    """Before it subscribes, so that it misses nothing of what is published as soon as the subscription is known."""
    bridge.ok("wait_endpoints", topic=topic, publishers=1, subscribers=0, timeout_s=PATIENCE_S)


def test_fifty_publishes_arrive_fifty_times_and_are_acknowledged(bridge: Client, peer, name: str) -> None:
    listener = peer("listen", name, "RELIABLE")
    wait_subscribers(bridge, name, 1)
    answers = [publish(bridge, name, f"number {i}") for i in range(50)]
    assert [line(listener) for _ in range(50)] == [f"number {i}" for i in range(50)]
    assert {(answer["matched"], answer["acked"]) for answer in answers} == {(1, True)}
    assert [answer["created"] for answer in answers] == [True] + 49 * [False]


def test_a_publish_waits_for_every_subscriber_that_can_match(bridge: Client, peer, name: str) -> None:
    first, unsure, last = [peer("listen", name, kind) for kind in ("RELIABLE", "BEST_EFFORT", "RELIABLE")]
    wait_subscribers(bridge, name, 3)
    assert publish(bridge, name, "hello")["matched"] == 3
    assert [line(listener) for listener in (first, last)] == ["hello"] * 2
    while not says(unsure):  # best effort: what comes before it has got to know the new publisher is lost
        publish(bridge, name, "hello")
        time.sleep(0.05)
    assert line(unsure) == "hello"


def test_a_publish_to_nobody_waits_for_somebody_and_says_so(bridge: Client, name: str) -> None:
    assert waited_for_nobody_s(bridge, name) >= 0.3


@pytest.mark.full
def test_a_publish_to_nobody_waits_no_longer_than_it_was_told_to(bridge: Client, name: str) -> None:
    assert undisturbed(lambda: waited_for_nobody_s(bridge, name)) < 0.6


def waited_for_nobody_s(bridge: Client, topic: str) -> float:
    """As the bridge says it, of the 0.3 s that it may wait."""
    answer = publish(bridge, topic, "hello", wait_match_s=0.3)
    assert (answer["matched"], answer["acked"]) == (0, None)
    return answer["waited_s"]


def test_a_call_is_answered_with_the_bytes_of_the_response(bridge: Client, peer, name: str) -> None:
    peer("serve", name, "0")
    response(bridge, TRUE, service=name, type=SET_BOOL)
    requests = {call(bridge, name, body): body for body in (TRUE, FALSE, TRUE)}
    for request, body in requests.items():
        answer = bridge.answer(request)[1]
        assert answer[4] == body[4]
        assert (b"asked True" if body == TRUE else b"asked False") in answer


@pytest.mark.full
def test_a_call_to_a_server_that_is_known_is_answered_within_a_second(bridge: Client, peer, name: str) -> None:
    peer("serve", name, "0")
    bridge.answer(call(bridge, name))
    assert undisturbed(lambda: bridge.answer(call(bridge, name))[0]["ok"]["elapsed_s"]) < 1


def test_a_call_to_nobody_a_slow_server_or_of_an_unknown_type_has_its_own_error(
    bridge: Client, peer, name: str
) -> None:
    peer("serve", name, "60")
    kinds = [
        bridge.answer(call(bridge, service, **changed))[0]["error"]["kind"]
        for service, changed in (
            (f"{name}/nobody", {"wait_s": 0.2}),
            (name, {"timeout_s": 0.2}),
            (name, {"type": "no_msgs/srv/No"}),
        )
    ]
    assert kinds == ["not_found", "timeout", "unknown_type"]


def test_a_server_that_leaves_ends_the_call_before_its_time_is_over(bridge: Client, peer, name: str) -> None:
    left_by_its_server_s(bridge, peer, name)


@pytest.mark.full
def test_a_server_that_leaves_ends_the_call_within_a_second(bridge: Client, peer, name: str) -> None:
    assert undisturbed(lambda: left_by_its_server_s(bridge, peer, name)) < 1


def left_by_its_server_s(bridge: Client, peer, service: str) -> float:
    """How long after the end of its server a call ended that might have waited for a minute."""
    server = peer("serve", service, "60")
    request = call(bridge, service, timeout_s=60)
    assert line(server) == "asked True"
    server.terminate()
    server.wait(PATIENCE_S)
    started = time.monotonic()
    assert bridge.answer(request)[0]["error"]["kind"] == "server_gone"
    return time.monotonic() - started


def test_a_cancelled_call_ends_before_it_is_answered(bridge: Client, peer, name: str) -> None:
    peer("serve", name, "60")
    request = call(bridge, name, timeout_s=60)
    bridge.ok("cancel", request=request)
    assert bridge.answer(request)[0]["error"]["kind"] == "cancelled"


def test_an_action_is_called_through_its_hidden_services(bridge: Client, peer, name: str) -> None:
    peer("act", name)
    feedback = {"topic": f"{name}/_action/feedback", "type": "test_msgs/action/Fibonacci_FeedbackMessage"}
    bridge.ok("subscribe", qos=RELIABLE, **feedback, **ALL)
    bridge.ok("wait_endpoints", topic=feedback["topic"], publishers=1, subscribers=1, timeout_s=PATIENCE_S)
    kept: dict[bytes, int] = {}

    def is_carried_out() -> bool:
        """Another goal each time: the server drops its answer, and the feedback, where it knows our side late."""
        goal_id = bytes(range(len(kept), len(kept) + 16))
        kept[goal_id] = leave_cancel(bridge, name, goal_id)
        action = {"service": f"{name}/_action/send_goal", "type": "test_msgs/action/Fibonacci_SendGoal"}
        arguments = {"wait_s": PATIENCE_S, "timeout_s": ANSWER_S}
        request = b"\0\1\0\0" + goal_id + b"\5\0\0\0"
        header, answer = bridge.answer(bridge.send("call", request, **action, **arguments))
        if "ok" not in header:
            assert header["error"]["kind"] == "timeout", header
            return False
        assert answer[4] == 1
        action = {"service": f"{name}/_action/get_result", "type": "test_msgs/action/Fibonacci_GetResult"}
        assert response(bridge, b"\0\1\0\0" + goal_id, **action)[4] == 4
        deadline = time.monotonic() + ANSWER_S
        while not sampled(bridge) and time.monotonic() < deadline:
            bridge.ok("ping")
        return bool(sampled(bridge))

    until(is_carried_out, 3 * PATIENCE_S)
    assert sampled(bridge)[0][1][4:20] in kept
    for request in kept.values():
        bridge.ok("cancel", request=request)


def leave_cancel(bridge: Client, action: str, goal_id: bytes) -> int:
    """The fail-safe of a goal; returns the id of its request."""
    service = {"service": f"{action}/_action/cancel_goal", "type": "action_msgs/srv/CancelGoal"}
    return bridge.send("failsafe_call", b"\0\1\0\0" + goal_id + bytes(8), **service)


def test_a_goal_without_its_fail_safe_is_refused_and_cancelling_one_is_not(bridge: Client, peer, name: str) -> None:
    peer("act", name)
    goal_id, other = bytes(range(1, 17)), bytes(range(2, 18))
    arguments = {"wait_s": PATIENCE_S, "timeout_s": PATIENCE_S}
    action = {"service": f"{name}/_action/send_goal", "type": "test_msgs/action/Fibonacci_SendGoal"}

    def send_goal() -> tuple[dict[str, Any], bytes]:
        return bridge.answer(bridge.send("call", b"\0\1\0\0" + goal_id + b"\5\0\0\0", **action, **arguments))

    kept = [leave_cancel(bridge, name, other), leave_cancel(bridge, f"{name}_sum", goal_id)]
    for withdrawn in (False, True):
        if withdrawn:
            bridge.ok("cancel", request=leave_cancel(bridge, name, goal_id))
        error = send_goal()[0]["error"]
        refused = f"No fail-safe is in force that ends goal {goal_id.hex()} of {name}: nothing was sent."
        assert (error["kind"], error["message"]) == ("bad_request", refused)
    service = {"service": f"{name}/_action/cancel_goal", "type": "action_msgs/srv/CancelGoal"}
    assert response(bridge, b"\0\1\0\0" + goal_id + bytes(8), **service)[4] == 2  # its server never heard of it
    kept.append(leave_cancel(bridge, name, goal_id))
    assert send_goal()[1][4] == 1
    for request in kept:
        bridge.ok("cancel", request=request)


def test_many_subscriptions_leave_nothing_behind(bridge: Client, name: str) -> None:
    def cycle() -> None:
        number = bridge.ok("subscribe", topic=name, type=STRING, qos=RELIABLE, **ALL)["sub"]
        bridge.ok("unsubscribe", sub=number)

    for _ in range(20):
        cycle()
    before = bridge.ok("stats")
    for _ in range(500):
        cycle()
    after, deadline = bridge.ok("stats"), time.monotonic() + PATIENCE_S
    for what in ("publishers", "subscriptions", "clients", "threads", "open_files"):
        while after[what] > before[what]:  # there may be fewer: others, whose ports it has open, have left meanwhile
            assert time.monotonic() < deadline, what
            after = bridge.ok("stats")
    assert after["rss_bytes"] - before["rss_bytes"] < 5_000_000


def test_a_bridge_that_others_cannot_reach_any_more_leaves(start, domain_id: int) -> None:
    """So it is where another process takes its shared memory for a dead one's and replaces it."""
    domain_id += 1  # where it disturbs nobody
    bridge = Client(start("ros2_mcp_bridge", env={"ROS_DOMAIN_ID": str(domain_id)}))
    assert bridge.ok("stats")  # it has opened all
    opened = set()
    for descriptor in Path(f"/proc/{bridge.process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed since
            opened.add(str(descriptor.readlink()))
    # Fast DDS is called fastrtps up to Jazzy.
    locks = [f"/dev/shm/{name}_port{port}_el" for port in ports_of(domain_id) for name in ("fastrtps", "fastdds")]
    (lock,) = [lock for lock in locks if lock in opened]
    Path(lock.removesuffix("_el")).unlink()
    assert bridge.process.wait(PATIENCE_S) in (0, -signal.SIGALRM)  # which ends it where it is held up as it leaves


def test_nothing_but_packets_is_on_stdout(start) -> None:
    noisy_bridge_leaves_s(start)


@pytest.mark.full
def test_a_bridge_leaves_within_a_second_of_the_end_of_its_stream(start) -> None:
    assert undisturbed(lambda: noisy_bridge_leaves_s(start)) < 1


def noisy_bridge_leaves_s(start) -> float:
    """How long it takes to leave."""
    noisy = {"RCUTILS_LOGGING_USE_STDOUT": "1", "RCUTILS_LOGGING_SEVERITY": "DEBUG"}
    bridge = Client(start("ros2_mcp_bridge", env=noisy))
    assert bridge.error("publish", topic="not a name", type=STRING, qos=RELIABLE, epoch=0)["kind"] == "ros_error"
    assert "ros_idle_s" in bridge.ok("ping")
    took = bridge.close()
    with pytest.raises(EOFError):
        bridge.next_packet()
    return took


def test_wrong_requests_are_answered_and_do_no_harm(bridge: Client) -> None:
    assert bridge.error("no_such_operation")["kind"] == "bad_request"
    assert bridge.error("publish", topic="/wrong", type=STRING, epoch=0)["kind"] == "bad_request"
    assert bridge.error("unsubscribe", sub=99)["kind"] == "not_found"
    error = bridge.error("call", b"\xff", service="/asked", type=SET_BOOL, wait_s=0, timeout_s=1)
    assert error["kind"] == "bad_request"
    assert bridge.ok("ping")


def test_an_installation_without_rclpy_is_told(start, ros_environment, tmp_path: Path) -> None:
    (tmp_path / "rclpy.py").write_text("raise ImportError('no rclpy here')\n")
    path = os.pathsep.join([str(tmp_path), ros_environment["PYTHONPATH"]])
    bridge = Client(start("ros2_mcp_bridge", env={"PYTHONPATH": path}))
    assert (bridge.hello["event"], bridge.hello["kind"]) == ("failed", "no_rclpy")
    assert bridge.process.wait(PATIENCE_S) == 1
