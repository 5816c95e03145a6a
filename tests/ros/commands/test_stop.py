"""Whatever ends the server, and whatever else it is busy with, what it moves comes to a stop."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from ros2_mcp.model.names import UNKNOWN_NODE
from support.agent import FULL
from support.peer_process import reachable
from support.raw_server import MODERN, RawServer, children
from support.standstill import TIMES, undisturbed

ROUNDS = 50
NOT_SETTLED = "Discovery had not settled"
MOVING = {"linear": {"x": 0.5}}
STOP_S, LAST_S = 0.5, 0.1
UNOBSERVED = "Not observed: no odometry reports whether the robot has stopped."
LIMITS_S = {"stdin closed": 0.3, "SIGTERM": 0.3, "SIGKILL": 1.0}


@pytest.fixture(scope="module")
def field(nursery, agent):
    """The robot that is driven: listens to velocities and counts."""
    peer = reachable(agent, nursery, "watch", "counting")
    yield peer
    peer.leave()


def wait_until(condition: Callable[[], object], within_s: float = 30.0) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


def tool(server: RawServer, name: str, **arguments: object) -> int:
    return server.send("tools/call", name=name, arguments=arguments)


def begun(server: RawServer, field) -> RawServer:
    """A server as soon as it has discovered the field, and discovery has settled: until then a stop waits for the names
    of others before it answers.
    """
    server.begin(MODERN)
    listed = {"pattern": field.name("count")}

    def is_discovered() -> bool:
        found = server.call("ros2_list_actions", **listed)["structuredContent"]
        return bool(found["actions"]) and NOT_SETTLED not in found["note"]

    wait_until(is_discovered)
    return server


def drive(server: RawServer, field, **repeat: float) -> int:
    topic, kind = field.name("cmd_vel"), "geometry_msgs/msg/Twist"
    return tool(server, "ros2_topic_publish", topic_name=topic, message_type=kind, data=MOVING, **repeat)


def wait_until_named(server: RawServer, field) -> None:
    """Until the node of everybody on the velocity topic is known: a stop waits for that before it answers."""
    topic = {"topic_name": field.name("cmd_vel")}
    wait_until(lambda: UNKNOWN_NODE not in str(server.call("ros2_topic_info", **topic)["structuredContent"]))


def nonzero(field) -> list[float]:
    return [at for at, speed in field.driven() if speed]


def last_is_zero(field) -> bool:
    return field.driven()[-1][1] == 0.0


def end(server: RawServer, how: str) -> None:
    if how == "stdin closed":
        assert server.process.stdin
        server.process.stdin.close()
    else:
        server.process.send_signal(getattr(signal, how))


@pytest.mark.promise("stopping", "a client over stdio closes its side, or dies")
@pytest.mark.timeout(240)
@pytest.mark.parametrize("how", LIMITS_S)
def test_a_server_that_goes_away_leaves_nothing_moving(how, start_raw, field) -> None:
    """A velocity at 50 Hz and a goal."""
    gone_and_last_velocity_s(how, start_raw, field)


@pytest.mark.full
@pytest.mark.timeout(900)
@pytest.mark.parametrize("how", LIMITS_S)
def test_after_a_server_has_gone_the_last_velocity_comes_in_time(how, start_raw, field) -> None:
    latest: list[float] = []
    for _ in range(ROUNDS):
        latest.append(undisturbed(lambda: gone_and_last_velocity_s(how, start_raw, field)))
        assert latest[-1] <= LIMITS_S[how]
    print(f"{how}: {len(latest)} rounds, last velocity after at most {max(latest) * 1000:.0f} ms")


def gone_and_last_velocity_s(how: str, start_raw, field) -> float:
    """How long after the end of a server the last velocity came that is not zero; what it moved has ended."""
    server = begun(start_raw(), field)
    goal = tool(server, "ros2_send_action_goal", action_name=field.name("count"), goal_fields={"order": 2000})
    assert server.answer(goal)["result"]["structuredContent"]["accepted"]
    cancelled, before = field.count(name="canceled"), len(nonzero(field))
    drive(server, field, frequency=50, duration=30)
    wait_until(lambda: len(nonzero(field)) > before + 20)
    ended_at = time.monotonic()
    end(server, how)
    server.process.wait(20)
    wait_until(lambda: last_is_zero(field))
    wait_until(lambda: field.count(name="canceled") > cancelled)
    assert last_is_zero(field)
    return nonzero(field)[-1] - ended_at


@pytest.mark.promise("README", "everything that was driven when the server dies")
@pytest.mark.promise("stopping", "the server is killed: the same")
def test_one_velocity_followed_by_sigkill_is_followed_by_zero(start_raw, field) -> None:
    killed_and_zero_s(start_raw, field)


@pytest.mark.full
@pytest.mark.promise("stopping", "the server is killed: the same: 1 s")
def test_the_zero_comes_within_a_second_of_a_sigkill(start_raw, field) -> None:
    assert undisturbed(lambda: killed_and_zero_s(start_raw, field)) < 1.0


def killed_and_zero_s(start_raw, field) -> float:
    """How long after a server was killed that has sent one velocity the zero came."""
    server = begun(start_raw(), field)
    before = len(nonzero(field))
    server.answer(drive(server, field))
    wait_until(lambda: len(nonzero(field)) > before)
    killed_at = time.monotonic()
    end(server, "SIGKILL")
    wait_until(lambda: last_is_zero(field))
    return time.monotonic() - killed_at


@pytest.mark.promise("README", "and when the bridge dies")
@pytest.mark.promise("stopping", "the bridge is killed")
@pytest.mark.parametrize("kills", [1, 3])
def test_a_bridge_that_is_killed_is_replaced_by_one_that_sends_zero(start_raw, field, kills: int) -> None:
    """Also if its successors are killed before they have begun."""
    server = begun(start_raw(), field)
    before = len(nonzero(field))
    repeat = drive(server, field, frequency=50, duration=30)
    wait_until(lambda: len(nonzero(field)) > before + 20)
    assert not last_is_zero(field)
    killed: set[int] = set()
    while len(killed) < kills:
        for pid in children(server.process.pid):  # a bridge before its stoppers, whose death would end the repeat
            if pid not in killed:
                with suppress(ProcessLookupError):  # it has just ended by itself
                    os.kill(pid, signal.SIGKILL)
                killed.add(pid)
    wait_until(lambda: last_is_zero(field))
    assert "BridgeLost" in server.answer(repeat)["result"]["content"][0]["text"]
    stopped = server.call("ros2_stop")["structuredContent"]
    assert stopped["topics"][0]["other_publishers"] == []  # although the graph still shows the dead one
    wait_until(lambda: server.call("ros2_stop")["structuredContent"]["topics"][0]["acknowledged"])


@pytest.mark.promise("README", "ros2_stop ends at once what this server has set in motion")
@pytest.mark.promise("ros2_stop", "Stop at once everything that this server has set in motion")
@pytest.mark.promise("ros2_stop", "Reports what was confirmed")
def test_stop_waits_behind_nothing_and_says_what_was_confirmed(start_raw, start_peer, robot) -> None:
    # Who is held up for longer than a stop waits for acknowledgements is told of as unconfirmed.
    assert any(busy_stop(start_raw(), start_peer("watch", "counting"), robot)[0] for _ in range(TIMES))


@pytest.mark.full
def test_a_busy_server_stops_in_half_a_second(start_raw, start_peer, robot) -> None:
    def seconds() -> tuple[bool, float, float]:
        # with a peer of its own: killed bridges seem to publish to the shared one
        return busy_stop(start_raw(), start_peer("watch", "counting"), robot)

    is_confirmed, took_s, last_s = undisturbed(seconds)
    assert is_confirmed
    assert took_s < STOP_S
    assert last_s < LAST_S


def busy_stop(server: RawServer, field, robot) -> tuple[bool, float, float]:
    """Whether what a busy server stops was confirmed, how long that took, and when the last command came."""
    begun(server, field)
    reading = tool(server, "ros2_topic_subscribe", topic_name="/rosout", duration=600, message_limit=1000)
    slow = {"service_name": robot.name("mute"), "fields": {"data": True}, "timeout_sec": 600}
    calling = tool(server, "ros2_service_call", **slow)
    goal = {"action_name": field.name("count"), "goal_fields": {"order": 2000}, "wait_for_result": True}
    waiting = tool(server, "ros2_send_action_goal", **goal)
    repeat = drive(server, field, frequency=50, duration=600)
    wait_until(lambda: len(nonzero(field)) > 20)
    wait_until(lambda: field.count(name="count executing"))
    wait_until(lambda: robot.take(name="mute"))
    wait_until_named(server, field)
    started = time.monotonic()
    result = server.call("ros2_stop")["structuredContent"]
    took = time.monotonic() - started
    assert not {reading, calling} & {line.get("id") for line in server.answers()}  # the stop waited for neither
    # The slow service was called, and nobody knows what that has begun: the whole is not confirmed.
    assert (result["confirmed"], result["repeats_stopped"]) == (False, 1)
    assert result["unknown_services"] == [f"{robot.name('mute')} (std_srvs/srv/SetBool)"]
    assert "NOT judged: this server has called 1 service (" in result["note"]
    assert server.answer(waiting)["result"]["structuredContent"]["status"] == "CANCELED"
    assert server.answer(repeat)["result"]["structuredContent"]["stopped_with_zero"] is True
    if FULL:
        assert last_is_zero(field)
    wait_until(lambda: last_is_zero(field))
    assert server.call("ros2_stop")["structuredContent"]["goals"] == []
    topic = {
        "topic_name": field.name("cmd_vel"),
        "subscribers": 1,
        "other_publishers": [],
        "error": "",
        "unreached_subscribers": 0,
    }
    goals = [(one["action_name"], one["status"], one["confirmed"]) for one in result["goals"]]
    is_confirmed = result["topics"] == [topic | {"acknowledged": True}]
    is_confirmed &= goals == [(field.name("count"), "CANCELED", True)] and result["note"].startswith(UNOBSERVED)
    return is_confirmed, took, nonzero(field)[-1] - started


def held(server: RawServer) -> tuple[int, int]:
    """How many publishers and clients of services its bridge has: one more for a request that waits there."""
    status = server.call("ros2_status")["structuredContent"]
    return status["publishers"], status["service_clients"]


@pytest.mark.promise("README", "What was accepted before it and has not been sent is not sent after it")
@pytest.mark.promise("ros2_stop", "commands accepted earlier but not yet sent are dropped")
def test_what_waits_when_a_stop_comes_is_not_sent_and_says_so(start_raw, robot) -> None:
    """A call that waits for its server, and a publish that waits for its first subscriber."""
    server = begun(start_raw(), robot)
    drive = {"message_type": "geometry_msgs/msg/Twist", "data": MOVING}

    def stopped_meanwhile(topic: str, service: str) -> bool:
        """A stop while both wait; not where a busy machine stops after the second that a publish waits."""
        absent = {"service_name": service, "service_type": "std_srvs/srv/SetBool", "fields": {"data": True}}
        none = held(server)
        call = tool(server, "ros2_service_call", **absent, timeout_sec=30)
        publish = tool(server, "ros2_topic_publish", topic_name=topic, **drive)
        wait_until(lambda: all(now > before for now, before in zip(held(server), none, strict=True)))
        stopped = server.call("ros2_stop")["structuredContent"]
        said = [server.answer(waiting)["result"]["content"][0]["text"] for waiting in (call, publish)]
        if "no subscribers" in said[1]:
            return False
        assert all("Stopped: " in text for text in said), said
        assert set(stopped["dropped"]) == {f"calling {service}", f"publishing on {topic}"}
        return True

    assert any(stopped_meanwhile(f"/nobody_yet_{number}", f"/not_there_yet_{number}") for number in range(TIMES))
    again = server.call("ros2_stop")["structuredContent"]
    assert (again["unknown_services"], again["unknown_topics"], again["dropped"]) == ([], [], [])


def test_what_was_begun_before_a_stop_is_stopped_by_it_and_not_confirmed_where_nothing_tells_that_it_stands(
    start_raw, field
) -> None:
    server = begun(start_raw(), field)

    def is_acknowledged() -> bool:
        """One stop; who is held up for longer than it waits for acknowledgements is told of besides."""
        before = len(nonzero(field))
        repeat = drive(server, field, frequency=50, duration=600)
        wait_until(lambda: len(nonzero(field)) > before + 5)
        wait_until_named(server, field)  # a server of the test before may just be leaving
        result = server.call("ros2_stop")
        stopped = result["structuredContent"]
        assert (stopped["confirmed"], stopped["repeats_stopped"]) == (False, 1)
        assert "It was ended by ros2_stop." in server.answer(repeat)["result"]["structuredContent"]["note"]
        told = "Stopped, partly confirmed: 1 repeated publication ended"
        return stopped["note"] == UNOBSERVED and result["content"][0]["text"].startswith(told)

    assert any(is_acknowledged() for _ in range(TIMES))


def test_stop_cancels_a_goal_that_is_accepted_only_then(agent, robot) -> None:
    judged = robot.count(name="hesitate")
    sending = agent.begin("ros2_send_action_goal", action_name=robot.name("hesitate"), goal_fields={"order": 600})
    wait_until(lambda: robot.count(name="hesitate") > judged)
    stopped = agent.call("ros2_stop")["goals"]
    goal_id = sending.result(60)["goal_id"]
    (goal,) = [one for one in stopped if one["goal_id"] == goal_id]
    assert (goal["status"], goal["confirmed"], goal["cancelled"]) == ("CANCELED", True, True)


@pytest.mark.promise("README", "every goal has ended")
@pytest.mark.promise("stopping", "every goal that this server sent has ended")
def test_stop_does_not_claim_what_it_could_not_do(agent, robot) -> None:
    stubborn = robot.name("refuse_cancel")
    goal_id = agent.call("ros2_send_action_goal", action_name=stubborn, goal_fields={"order": 400})["goal_id"]
    result = agent.whole("ros2_stop", {})
    assert result.structured_content["confirmed"] is False
    assert result.content[0].text.startswith("NOT confirmed")
    assert f"Goal {goal_id} has not ended yet." in result.structured_content["note"]
    (goal,) = [one for one in result.structured_content["goals"] if one["goal_id"] == goal_id]
    assert (goal["confirmed"], goal["cancelled"]) == (False, False)
