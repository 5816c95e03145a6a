"""What the bridge sends last where it drives: a zero, whatever ends the command, the relay or the bridge itself."""

from __future__ import annotations

import itertools
import signal
import subprocess
import time
from typing import Any

import pytest

from support.agent import until
from support.bridge_client import PATIENCE_S, RELIABLE, Client, line
from support.standstill import undisturbed
from support.velocities import TWIST, cdr

ACKNOWLEDGED_S = 1.0
"""How long a relay waits until its first message is acknowledged."""
GIVES_UP_S = 1.0
ENDINGS = ("stdin ends", "SIGTERM", "broken frame")


@pytest.mark.promise("ros2_topic_publish", "Publish a message once, or repeatedly with frequency and duration")
@pytest.mark.promise("ros2_topic_publish", "A repeated velocity command ends with a zero command")
@pytest.mark.promise(
    "stopping", "a repeat, relay or playback of a velocity ends, for whatever reason: its zero: at once"
)
def test_every_turn_of_a_repeat_is_sent_or_told_to_be_late_and_it_ends_with_the_zero(
    bridge: Client, peer, name: str
) -> None:
    answer, count = repeated_for_a_second(bridge, peer("drive", name), name)
    assert answer["sent"] + answer["late"] == 100
    assert answer["elapsed_s"] > 0.95
    assert 1 <= count <= answer["sent"]


@pytest.mark.full
def test_repeated_publishing_keeps_its_rate(bridge: Client, peer, name: str) -> None:
    """A subscriber that is held up gets the newest command, not those before it: the depth is 1."""
    listener = peer("drive", name)
    answer, count = undisturbed(lambda: repeated_for_a_second(bridge, listener, name))
    assert answer["late"] < 50 and 0.95 < answer["elapsed_s"] < 1.3
    assert 0.8 * answer["sent"] <= count <= answer["sent"]


def repeated_for_a_second(bridge: Client, listener: subprocess.Popen[bytes], topic: str) -> tuple[dict[str, Any], int]:
    """What the bridge tells of a repeat at 100 Hz, and how many of its commands arrived before the zero."""
    failsafe = driven(bridge, topic)
    answer = bridge.answer(repeat(bridge, topic, rate_hz=100, duration_s=1))[0]["ok"]
    assert (answer["final_sent"], answer["ended_by"], answer["matched"]) == (True, "", 1)
    heard = [line(listener)]
    while heard == ["0.0"]:  # of the round before: it is sent twice
        heard = [line(listener)]
    while heard[-1] != "0.0":
        heard.append(line(listener))
    bridge.ok("cancel", request=failsafe)
    return answer, heard.count("1.0")


def test_a_cancelled_repeat_says_what_it_sent(bridge: Client, peer, name: str) -> None:
    peer("drive", name)
    driven(bridge, name)
    request = repeat(bridge, name, rate_hz=50, duration_s=60)
    while not bridge.ok("stats")["repeats"]:
        time.sleep(0.02)
    bridge.ok("cancel", request=request)
    answer = bridge.answer(request)[0]["ok"]
    assert answer["ended_by"] == "cancel"
    assert answer["sent"] >= 1
    assert answer["final_sent"]


@pytest.mark.promise("README", "The bridge sends the zero, in a process of its own")
@pytest.mark.parametrize("ending", ENDINGS)
def test_the_zero_is_sent_whatever_ends_the_bridge(start, peer, name: str, ending: str) -> None:
    zero_after_the_end(start, peer, name, ending)


@pytest.mark.full
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_bridge_that_drives_has_left_a_second_after_its_end(start, peer, name: str, ending: str) -> None:
    assert undisturbed(lambda: zero_after_the_end(start, peer, name, ending)) < 1


def zero_after_the_end(start, peer, topic: str, ending: str) -> float:
    """How long a bridge takes to leave; a zero follows the commands that it was repeating."""
    bridge = Client(start("ros2_mcp_bridge"))
    listener = peer("drive", topic, knows=bridge)
    driven(bridge, topic)
    repeat(bridge, topic, rate_hz=50, duration_s=60)
    while (text := line(listener)) == "0.0":  # of the round before
        pass
    took = leaves(bridge, ending)
    while text != "0.0":
        assert text == "1.0"
        text = line(listener)
    listener.terminate()
    listener.wait(PATIENCE_S)
    return took


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
    status, took_s = bridge.process.wait(PATIENCE_S), time.monotonic() - started
    assert status == 0 or (status == -signal.SIGALRM and took_s >= GIVES_UP_S)
    return took_s


def test_nothing_follows_the_zero_of_a_relay_that_is_being_fed(bridge: Client, peer, name: str) -> None:
    """Stopped while the first message of a feed waits for its acknowledgement, the others of that feed are not sent."""
    listener, numbers = peer("drive", name), itertools.count(1)
    driven(bridge, name)
    # On a machine that is held up for a second in between, it has given up that wait.
    until(lambda: fed_and_stopped(bridge, listener, name, next(numbers))[0] == 1, 2 * PATIENCE_S)


@pytest.mark.full
def test_a_relay_that_is_being_fed_is_stopped_before_its_first_message_is_acknowledged(
    bridge: Client, peer, name: str
) -> None:
    listener, numbers = peer("drive", name), itertools.count(1)
    driven(bridge, name)
    passed, took = undisturbed(lambda: fed_and_stopped(bridge, listener, name, next(numbers)))
    assert took < ACKNOWLEDGED_S
    assert passed == 1


def fed_and_stopped(bridge: Client, listener: subprocess.Popen[bytes], topic: str, number: int) -> tuple[int, float]:
    """How many messages a relay passed on that was fed three and stopped while its listener could not acknowledge the
    first, and how long after the feed; nothing of the feed comes after its zero.
    """
    relay = bridge.send("relay", name="fed", topic=topic, type=TWIST, qos=RELIABLE, epoch=0)
    until(lambda: (fed := bridge.ok("relays")["relays"].get("fed")) and fed["matched"] and fed["running"])
    listener.send_signal(signal.SIGSTOP)
    feed, started = cdr(TWIST, number), time.monotonic()
    bridge.send("relay_feed", feed * 3, name="fed", sizes=[len(feed)] * 3, epoch=0)
    while not bridge.ok("relays")["relays"]["fed"]["passed"]:
        time.sleep(0.01)
    assert bridge.ok("relay_stop", name="fed")["relays"] == 1
    took = time.monotonic() - started
    listener.send_signal(signal.SIGCONT)
    answer = bridge.answer(relay)[0]["ok"]
    assert (answer["ended_by"], answer["final_sent"]) == ("cancel", True)
    assert command(bridge, topic, -number)["acked"]
    heard = [line(listener)]
    while heard[-1] != f"{-float(number)}":
        heard.append(line(listener))
    go = f"{float(number)}"
    own = heard[heard.index(go) :] if go in heard else heard[-1:]  # before it, the zeros of the round before
    assert set(own) <= {go, "0.0", f"{-float(number)}"}
    assert go not in (own[own.index("0.0") :] if "0.0" in own else own)
    return answer["passed"], took


def test_a_fail_safe_that_is_withdrawn_is_answered_and_not_carried_out(own_bridge: Client, peer, name: str) -> None:
    bridge, listener, rounds = own_bridge, peer("drive", name), itertools.count()

    def withdrawn() -> bool:
        """Whether that was judged: a bridge that gets no processor for a quarter of a second is taken for a dead one,
        and its stopper sends a zero, of which it is told.
        """
        bridge.samples.clear()
        is_first = next(rounds) == 0
        failsafe = driven(bridge, name)
        command(bridge, name, 1)
        command(bridge, name, 2)
        bridge.ok("cancel", request=failsafe)
        assert bridge.answer(failsafe)[0]["ok"] == {"cancelled": True}
        heard = list(iter(lambda: line(listener), "2.0"))
        bridge.ok("ping")
        if any(header["event"] == "stopper" for header, _ in bridge.samples):
            return False
        while not is_first and heard[:1] == ["0.0"]:  # of the stopper in the round before
            heard.pop(0)
        assert heard == ["1.0"]
        return True

    until(withdrawn)
    refused = bridge.error("publish", cdr(TWIST, 3), topic=name, type=TWIST, qos=RELIABLE, epoch=0)
    assert refused["kind"] == "bad_request" and "no fail-safe is in force" in refused["message"]
    bridge.close()
    listener.terminate()
    assert listener.stdout
    assert listener.stdout.read() == b""


def driven(bridge: Client, topic: str) -> int:
    return bridge.send("failsafe_publish", topic=topic, type=TWIST, qos=RELIABLE)


def command(bridge: Client, topic: str, speed: float) -> dict[str, Any]:
    arguments = {"topic": topic, "type": TWIST, "qos": RELIABLE, "epoch": 0}
    return bridge.ok("publish", cdr(TWIST, speed), wait_match_s=PATIENCE_S, wait_ack_s=PATIENCE_S, **arguments)


def repeat(bridge: Client, topic: str, **arguments: Any) -> int:
    arguments = {"qos": RELIABLE, "wait_match_s": PATIENCE_S, "epoch": 0, **arguments}
    return bridge.send("repeat", cdr(TWIST, 1), topic=topic, type=TWIST, **arguments)
