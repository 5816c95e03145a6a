"""The bridge as its server sees it: raw packets to a real process, checked against independent ROS nodes."""

from __future__ import annotations

import itertools
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

from ros2_mcp_bridge.participants import ports_of
from support.agent import until
from support.bridge_client import BEST_EFFORT, PATIENCE_S, RELIABLE, STRING, Client, cdr_string
from support.standstill import undisturbed
from support.velocities import TWIST, cdr

SET_BOOL = "std_srvs/srv/SetBool"
TRUE, FALSE = b"\0\1\0\0\1", b"\0\1\0\0\0"
GIVES_UP_S = 1.0
ACKNOWLEDGED_S = 1.0
"""How long a relay waits until its first message is acknowledged."""
ALL = {"keep": "all", "max_samples": 100_000, "max_bytes": 100_000_000}


@pytest.fixture
def bridge(start) -> Client:
    return Client(start("ros2_mcp_bridge"))


@pytest.fixture
def peer(start, request):
    """Start a peer: it and the test's bridge, if it has one, know each other when it is ready."""
    own = request.getfixturevalue("bridge") if "bridge" in request.fixturenames else None

    def start_peer(*arguments: str, knows: Client | None = own) -> subprocess.Popen[bytes]:
        env = {"KNOWS": knows.hello["node"][1:]} if knows else {}
        process = start("bridge_peer.py", *arguments, env=env)
        assert line(process) == "ready"
        return process

    return start_peer


def line(process: subprocess.Popen[bytes]) -> str:
    assert process.stdout
    return process.stdout.readline().decode().strip()


def says(process: subprocess.Popen[bytes]) -> bool:
    """Whether it has printed something."""
    return bool(select.select([process.stdout], [], [], 0)[0])


def received(bridge: Client) -> int:
    return sum(len(header["samples"]) for header, _ in bridge.samples)


def newest(bridge: Client) -> int:
    """The sequence number of the message that came last."""
    return bridge.samples[-1][0]["samples"][-1][2] if bridge.samples else 0


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


def publish(bridge: Client, text: str, **changed: Any) -> dict[str, Any]:
    arguments = {
        "topic": "/said",
        "type": STRING,
        "qos": RELIABLE,
        "wait_match_s": PATIENCE_S,
        "wait_ack_s": PATIENCE_S,
        "epoch": 0,
        **changed,
    }
    return bridge.ok("publish", cdr_string(text), **arguments)


def wait_subscribers(bridge: Client, count: int) -> list[dict[str, Any]]:
    wanted = {"topic": "/said", "publishers": 0, "subscribers": count}
    return bridge.ok("wait_endpoints", timeout_s=PATIENCE_S, **wanted)["subscribers"]


def call(bridge: Client, body: bytes = TRUE, **changed: Any) -> int:
    arguments = {"service": "/asked", "type": SET_BOOL, "wait_s": PATIENCE_S, "timeout_s": PATIENCE_S, **changed}
    return bridge.send("call", body, **arguments)


def test_it_says_hello_with_its_node_and_versions(bridge: Client, domain_id: int) -> None:
    assert bridge.hello["event"] == "hello"
    assert bridge.hello["protocol"] == 5
    assert bridge.hello["domain_id"] == domain_id
    assert bridge.hello["pid"] == bridge.process.pid
    assert [bridge.hello["node"][1:], "/"] in bridge.ok("nodes", settle_s=0)["nodes"]


def test_the_first_listing_is_whole(start, peer) -> None:
    for prefix, count in (("a", 14), ("b", 13), ("c", 13)):
        peer("topics", prefix, str(count))

    def listed_after() -> float:
        started = time.monotonic()
        listing = Client(start("ros2_mcp_bridge")).ok("topics", settle_s=PATIENCE_S)
        assert listing["settled"]
        assert sum(name[2:4] == "/t" and publishers == 1 for name, _, publishers, _ in listing["topics"]) == 40
        return time.monotonic() - started

    assert undisturbed(listed_after) < 5


def test_of_many_topics_only_those_are_counted_that_are_asked_for(bridge: Client, peer) -> None:
    peer("topics", "d", "3")
    bridge.ok("wait_endpoints", topic="/d/t2", publishers=1, timeout_s=PATIENCE_S)
    listed = {name: tuple(counts) for name, _, *counts in bridge.ok("topics", settle_s=PATIENCE_S)["topics"]}
    uncounted = bridge.ok("topics", count_most=len(listed) - 1)
    assert {tuple(counts) for _, _, *counts in uncounted["topics"]} == {(-1, -1)} and uncounted["nodes"]
    counted = bridge.ok("counted", topics=["/d/t2", "/nobody", "/d/t0"])["counted"]
    assert [tuple(each) for each in counted] == [listed["/d/t2"], (0, 0), listed["/d/t0"]] and listed["/d/t2"] == (1, 0)


def test_endpoints_tell_node_type_hash_and_qos(bridge: Client, peer) -> None:
    peer("listen", "/said", "BEST_EFFORT")
    found = wait_subscribers(bridge, 1)[0]
    assert (found["node"], found["namespace"], found["type"]) == ("listen_peer", "/", STRING)
    assert found["hash"].startswith("RIHS01_")
    assert found["qos"]["reliability"] == "best_effort"
    assert found["qos"]["deadline_ns"] is None
    node = bridge.ok("node", name="listen_peer", namespace="/", settle_s=PATIENCE_S)
    assert ["/said", [STRING]] in node["subscribers"]
    assert bridge.error("node", name="nobody", namespace="/", settle_s=3)["kind"] == "not_found"
    error = bridge.error("wait_endpoints", topic="/said", publishers=1, subscribers=0, timeout_s=0.1)
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
def test_every_message_of_a_fast_topic_is_counted(bridge: Client, peer, reliability: str) -> None:
    flood = peer("flood", "/fast", reliability, "4000", "8000")
    knows_the_publisher(bridge)
    qos = RELIABLE if reliability == "RELIABLE" else BEST_EFFORT
    number = bridge.ok("subscribe", topic="/fast", type=STRING, qos=qos, **ALL)["sub"]
    delays = []
    while not says(flood):
        started = time.monotonic()
        bridge.ok("stats")
        delays.append(time.monotonic() - started)
        time.sleep(0.01)
    assert sorted(delays)[len(delays) * 9 // 10] < 0.1
    sent = all_arrived(bridge, flood)
    assert sent >= 8000
    counts = bridge.ok("unsubscribe", sub=number)
    assert counts["received"] + counts["lost"] == sent
    assert counts["dropped"] == 0
    assert received(bridge) == counts["received"]
    assert bridge.samples[-1][0]["received"] == counts["received"]
    assert bridge.samples[-1][1].startswith(cdr_string("x" * 40)[:-3])


def test_what_the_server_does_not_read_is_bounded_and_counted(bridge: Client, peer) -> None:
    flood = peer("flood", "/fast", "RELIABLE", "4000", "8000")
    knows_the_publisher(bridge)
    bounds = {"keep": "all", "max_samples": 50, "max_bytes": 100_000_000}
    request = bridge.send("subscribe", topic="/fast", type=STRING, qos=RELIABLE, **bounds)
    select.select([flood.stdout], [], [])
    number = bridge.answer(request)[0]["ok"]["sub"]
    sent = all_arrived(bridge, flood)
    counts = bridge.ok("unsubscribe", sub=number)
    assert counts["received"] + counts["lost"] == sent
    assert counts["dropped"] > 0
    assert received(bridge) == counts["received"] - counts["dropped"]


def knows_the_publisher(bridge: Client) -> None:
    """Before it subscribes, so that it misses nothing of what is published as soon as the subscription is known."""
    bridge.ok("wait_endpoints", topic="/fast", publishers=1, subscribers=0, timeout_s=PATIENCE_S)


def test_fifty_publishes_arrive_fifty_times_and_are_acknowledged(bridge: Client, peer) -> None:
    listener = peer("listen", "/said", "RELIABLE")
    wait_subscribers(bridge, 1)
    answers = [publish(bridge, f"number {i}") for i in range(50)]
    assert [line(listener) for _ in range(50)] == [f"number {i}" for i in range(50)]
    assert {(answer["matched"], answer["acked"]) for answer in answers} == {(1, True)}
    assert [answer["created"] for answer in answers] == [True] + 49 * [False]


def test_a_publish_waits_for_every_subscriber_that_can_match(bridge: Client, peer) -> None:
    first, unsure, last = [peer("listen", "/said", kind) for kind in ("RELIABLE", "BEST_EFFORT", "RELIABLE")]
    wait_subscribers(bridge, 3)
    assert publish(bridge, "hello")["matched"] == 3
    assert [line(listener) for listener in (first, last)] == ["hello"] * 2
    while not says(unsure):  # best effort: what comes before it has got to know the new publisher is lost
        publish(bridge, "hello")
        time.sleep(0.05)
    assert line(unsure) == "hello"


def test_a_publish_to_nobody_says_so(bridge: Client) -> None:
    def waited_s() -> float:
        answer = publish(bridge, "hello", wait_match_s=0.3)
        assert (answer["matched"], answer["acked"]) == (0, None)
        return answer["waited_s"]

    assert 0.3 <= undisturbed(waited_s) < 0.6


@pytest.mark.promise("ros2_topic_publish", "Publish a message once, or repeatedly with frequency and duration")
@pytest.mark.promise("ros2_topic_publish", "A repeated velocity command ends with a zero command")
@pytest.mark.promise(
    "stopping", "a repeat, relay or playback of a velocity ends, for whatever reason: its zero: at once"
)
def test_repeated_publishing_keeps_its_rate_and_ends_with_the_zero(bridge: Client, peer) -> None:
    """A subscriber that is held up gets the newest command, not those before it: the depth is 1."""
    listener, heard = peer("drive", "/driven"), ["0.0"]
    driven(bridge)

    def repeated() -> tuple[dict[str, Any], int]:
        nonlocal heard
        answer = bridge.answer(repeat(bridge, rate_hz=100, duration_s=1))[0]["ok"]
        heard = heard[-1:]
        while heard == ["0.0"]:  # it is sent twice
            heard = [line(listener)]
        while heard[-1] != "0.0":
            heard.append(line(listener))
        return answer, heard.count("1.0")

    answer, count = undisturbed(repeated)
    assert answer["sent"] + answer["late"] == 100
    assert (answer["final_sent"], answer["ended_by"], answer["matched"]) == (True, "", 1)
    assert answer["late"] < 50 and 0.95 < answer["elapsed_s"] < 1.3
    assert 0.8 * answer["sent"] <= count <= answer["sent"]


def test_a_cancelled_repeat_says_what_it_sent(bridge: Client, peer) -> None:
    peer("drive", "/driven")
    driven(bridge)
    request = repeat(bridge, rate_hz=50, duration_s=60)
    while not bridge.ok("stats")["repeats"]:
        time.sleep(0.02)
    bridge.ok("cancel", request=request)
    answer = bridge.answer(request)[0]["ok"]
    assert answer["ended_by"] == "cancel"
    assert answer["sent"] >= 1
    assert answer["final_sent"]


@pytest.mark.promise("README", "The bridge sends the zero, in a process of its own")
@pytest.mark.parametrize("ending", ["stdin ends", "SIGTERM", "broken frame"])
def test_the_zero_is_sent_whatever_ends_the_bridge(start, peer, ending: str) -> None:
    def seconds() -> float:
        bridge = Client(start("ros2_mcp_bridge"))
        listener = peer("drive", "/driven", knows=bridge)
        driven(bridge)
        repeat(bridge, rate_hz=50, duration_s=60)
        assert line(listener) == "1.0"
        took = leaves(bridge, ending)
        while took < GIVES_UP_S and (text := line(listener)) != "0.0":
            assert text == "1.0"
        listener.terminate()
        listener.wait(PATIENCE_S)
        return took

    assert undisturbed(seconds) < 1


def leaves(bridge: Client, ending: str) -> float:
    """How long the bridge takes to leave; it kills itself where it did not manage to within a second."""
    started = time.monotonic()
    assert bridge.process.stdin
    if ending == "stdin ends":
        bridge.process.stdin.close()
    elif ending == "SIGTERM":
        bridge.process.send_signal(signal.SIGTERM)
    else:
        bridge.process.stdin.write(b"\xff" * 100)
        bridge.process.stdin.flush()
    status, took = bridge.process.wait(PATIENCE_S), time.monotonic() - started
    assert status == 0 or (status == -signal.SIGALRM and took >= GIVES_UP_S)
    return took


def test_nothing_follows_the_zero_of_a_relay_that_is_being_fed(bridge: Client, peer) -> None:
    """Stopped while the first message of a feed waits for its acknowledgement, the others of that feed are not sent."""
    listener = peer("drive", "/driven")
    driven(bridge)
    numbers = itertools.count(1)

    def seconds() -> float:
        number = next(numbers)
        took = stopped_after(bridge, listener, number)
        assert command(bridge, -number)["acked"]
        heard = [line(listener)]
        while heard[-1] != f"{-float(number)}":
            heard.append(line(listener))
        go = f"{float(number)}"
        own = heard[heard.index(go) :] if go in heard else heard[-1:]  # before it, the zeros of the round before
        assert set(own) <= {go, "0.0", f"{-float(number)}"}
        assert go not in heard[heard.index("0.0") :] if "0.0" in heard else go not in heard
        return took

    assert undisturbed(seconds) < ACKNOWLEDGED_S


def stopped_after(bridge: Client, listener: subprocess.Popen[bytes], number: int) -> float:
    """How long after its feed a relay was stopped, while its listener could not acknowledge what was fed first."""
    relay = bridge.send("relay", name="fed", topic="/driven", type=TWIST, qos=RELIABLE, epoch=0)
    until(lambda: (fed := bridge.ok("relays")["relays"].get("fed")) and fed["matched"] and fed["running"])
    listener.send_signal(signal.SIGSTOP)
    go, started = cdr(TWIST, number), time.monotonic()
    bridge.send("relay_feed", go * 3, name="fed", sizes=[len(go)] * 3, epoch=0)
    while not bridge.ok("relays")["relays"]["fed"]["passed"]:
        time.sleep(0.01)
    assert bridge.ok("relay_stop", name="fed")["relays"] == 1
    took = time.monotonic() - started
    listener.send_signal(signal.SIGCONT)
    answer = bridge.answer(relay)[0]["ok"]
    assert (answer["ended_by"], answer["final_sent"]) == ("cancel", True)
    assert answer["passed"] == 1 or took >= ACKNOWLEDGED_S
    return took


def test_a_fail_safe_that_is_withdrawn_is_answered_and_not_carried_out(bridge: Client, peer) -> None:
    listener = peer("drive", "/driven")

    def heard_before_it_was_withdrawn() -> list[str]:
        failsafe = driven(bridge)
        command(bridge, 1)
        command(bridge, 2)
        bridge.ok("cancel", request=failsafe)
        assert bridge.answer(failsafe)[0]["ok"] == {"cancelled": True}
        return list(iter(lambda: line(listener), "2.0"))

    # A bridge that gets no processor for a quarter of a second is taken for a dead one: its stopper sends a zero.
    assert undisturbed(heard_before_it_was_withdrawn) == ["1.0"]
    refused = bridge.error("publish", cdr(TWIST, 3), topic="/driven", type=TWIST, qos=RELIABLE, epoch=0)
    assert refused["kind"] == "bad_request" and "no fail-safe is in force" in refused["message"]
    bridge.close()
    listener.terminate()
    assert listener.stdout
    assert listener.stdout.read() == b""


def driven(bridge: Client, topic: str = "/driven") -> int:
    return bridge.send("failsafe_publish", topic=topic, type=TWIST, qos=RELIABLE)


def command(bridge: Client, speed: float) -> dict[str, Any]:
    arguments = {"topic": "/driven", "type": TWIST, "qos": RELIABLE, "epoch": 0}
    return bridge.ok("publish", cdr(TWIST, speed), wait_match_s=PATIENCE_S, wait_ack_s=PATIENCE_S, **arguments)


def repeat(bridge: Client, **arguments: Any) -> int:
    arguments = {"qos": RELIABLE, "wait_match_s": PATIENCE_S, "epoch": 0, **arguments}
    return bridge.send("repeat", cdr(TWIST, 1), topic="/driven", type=TWIST, **arguments)


def test_a_call_is_answered_with_the_bytes_of_the_response(bridge: Client, peer) -> None:
    peer("serve", "/asked", "0")
    requests = {call(bridge, body): body for body in (TRUE, FALSE, TRUE)}
    for request, body in requests.items():
        response = bridge.answer(request)[1]
        assert response[4] == body[4]
        assert (b"asked True" if body == TRUE else b"asked False") in response
    assert undisturbed(lambda: bridge.answer(call(bridge))[0]["ok"]["elapsed_s"]) < 1


def test_a_call_to_nobody_a_slow_server_or_of_an_unknown_type_has_its_own_error(bridge: Client, peer) -> None:
    peer("serve", "/asked", "60")
    kinds = [
        bridge.answer(call(bridge, **changed))[0]["error"]["kind"]
        for changed in ({"service": "/nobody", "wait_s": 0.2}, {"timeout_s": 0.2}, {"type": "no_msgs/srv/No"})
    ]
    assert kinds == ["not_found", "timeout", "unknown_type"]


def test_a_server_that_leaves_ends_the_call_at_once(bridge: Client, peer) -> None:
    def seconds() -> float:
        server = peer("serve", "/asked", "60")
        request = call(bridge, timeout_s=60)
        assert line(server) == "asked True"
        server.terminate()
        server.wait(PATIENCE_S)
        started = time.monotonic()
        assert bridge.answer(request)[0]["error"]["kind"] == "server_gone"
        return time.monotonic() - started

    assert undisturbed(seconds) < 1


def test_a_cancelled_call_ends_at_once(bridge: Client, peer) -> None:
    peer("serve", "/asked", "60")
    request = call(bridge, timeout_s=60)
    bridge.ok("cancel", request=request)
    assert bridge.answer(request)[0]["error"]["kind"] == "cancelled"


def test_an_action_is_called_through_its_hidden_services(bridge: Client, peer) -> None:
    peer("act", "/count")
    feedback = {"topic": "/count/_action/feedback", "type": "test_msgs/action/Fibonacci_FeedbackMessage"}
    bridge.ok("subscribe", qos=RELIABLE, **feedback, **ALL)
    bridge.ok("wait_endpoints", topic=feedback["topic"], publishers=1, subscribers=1, timeout_s=PATIENCE_S)
    goal_id = bytes(range(16))
    arguments = {"wait_s": PATIENCE_S, "timeout_s": PATIENCE_S}
    request = b"\0\1\0\0" + goal_id + b"\5\0\0\0"
    action = {"service": "/count/_action/send_goal", "type": "test_msgs/action/Fibonacci_SendGoal"}
    assert bridge.answer(bridge.send("call", request, **action, **arguments))[1][4] == 1
    action = {"service": "/count/_action/get_result", "type": "test_msgs/action/Fibonacci_GetResult"}
    result = bridge.answer(bridge.send("call", b"\0\1\0\0" + goal_id, **action, **arguments))[1]
    assert result[4] == 4
    while not bridge.samples:
        bridge.ok("ping")
    assert bridge.samples[0][1][4:20] == goal_id


def test_many_subscriptions_leave_nothing_behind(bridge: Client) -> None:
    def cycle() -> None:
        number = bridge.ok("subscribe", topic="/said", type=STRING, qos=RELIABLE, **ALL)["sub"]
        bridge.ok("unsubscribe", sub=number)

    for _ in range(20):
        cycle()
    before = bridge.ok("stats")
    for _ in range(500):
        cycle()
    after, deadline = bridge.ok("stats"), time.monotonic() + PATIENCE_S
    for name in ("publishers", "subscriptions", "clients", "threads", "open_files"):
        while after[name] != before[name]:
            assert time.monotonic() < deadline, name
            after = bridge.ok("stats")
    assert after["rss_bytes"] - before["rss_bytes"] < 5_000_000


def test_a_bridge_that_others_cannot_reach_any_more_leaves(bridge: Client, domain_id: int) -> None:
    """So it is where another process takes its shared memory for a dead one's and replaces it."""
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
    noisy = {"RCUTILS_LOGGING_USE_STDOUT": "1", "RCUTILS_LOGGING_SEVERITY": "DEBUG"}

    def seconds() -> float:
        bridge = Client(start("ros2_mcp_bridge", env=noisy))
        assert bridge.error("publish", topic="not a name", type=STRING, qos=RELIABLE, epoch=0)["kind"] == "ros_error"
        assert "ros_idle_s" in bridge.ok("ping")
        took = bridge.close()
        with pytest.raises(EOFError):
            bridge.next_packet()
        return took

    assert undisturbed(seconds) < 1


def test_wrong_requests_are_answered_and_do_no_harm(bridge: Client) -> None:
    assert bridge.error("no_such_operation")["kind"] == "bad_request"
    assert bridge.error("publish", topic="/said", type=STRING, epoch=0)["kind"] == "bad_request"
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
