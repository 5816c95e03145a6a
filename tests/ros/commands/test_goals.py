"""Goals through the real server, against independent rclpy action servers and clients."""

from __future__ import annotations

import time
from contextlib import suppress

import pytest

from support.agent import FULL, until
from support.standstill import TIMES

FIBONACCI = "test_msgs/action/Fibonacci"
UNKNOWN_ID = "0123456789abcdef" * 2
LONG = 2000
"""Steps of 0.05 s: a goal that is ended long before its end, however busy the machine is."""


def send(agent, action: str, order: int, **options):
    return agent.call("ros2_send_action_goal", action_name=action, goal_fields={"order": order}, **options)


def result(agent, action: str, goal_id: str, **options):
    return agent.call("ros2_action_request_result", action_name=action, goal_id_hex=goal_id, **options)


def cancel(agent, action: str, **options):
    return agent.call("ros2_cancel_action_goal", action_name=action, **options)


def test_a_goal_whose_acceptance_is_not_answered_is_known_from_the_status(agent, start_peer) -> None:
    peer, begun = start_peer("late"), time.monotonic()
    sent = agent.call("ros2_send_action_goal", action_name=peer.name("late"), goal_fields={"order": 1})
    if FULL:
        assert time.monotonic() - begun < 30
    # Its stamp is that of the status: the answer has another, and takes a minute.
    assert (sent["accepted"], sent["status"], sent["send_goal_stamp"]["sec"]) == (True, "ACCEPTED", 7)


def test_a_result_whose_answer_is_lost_is_asked_for_again(agent, start_peer) -> None:
    peer = start_peer("lossy")
    ended = send(agent, peer.name("lossy"), 1, wait_for_result=True, timeout_sec=60)
    assert (ended["status"], ended["result"]) == ("SUCCEEDED", {"sequence": [7]})
    assert peer.count(name="lossy") >= 2  # once more where a busy machine is late with the second answer


@pytest.mark.promise(
    "ros2_list_actions", "List the actions of the robot with their types and the fields of their goals"
)
def test_an_action_is_listed_with_its_type_and_the_fields_of_its_goal(agent, robot) -> None:
    listed = agent.call("ros2_list_actions", pattern=robot.name("*"))["actions"]
    entry = {"name": robot.name("count"), "types": [FIBONACCI], "request_fields": {"order": "int32"}}
    assert entry in listed


@pytest.mark.promise("ros2_send_action_goal", "Without it, call ros2_action_request_result with the goal_id later")
def test_a_goal_that_is_not_waited_for_is_accepted_and_its_result_asked_for_later(agent, robot) -> None:
    began_at = int(time.time())
    sent = send(agent, robot.name("count"), 6, action_type="test_msgs/Fibonacci")
    assert (sent["accepted"], sent["status_code"], sent["status"], sent["waited"]) == (True, 1, "ACCEPTED", False)
    assert len(bytes.fromhex(sent["goal_id"])) == 16
    assert began_at <= sent["send_goal_stamp"]["sec"] <= time.time()
    assert (sent["result"], sent["result_timeout_sec"]) == (None, None)
    for goal_id in (sent["goal_id"], sent["goal_id"].upper()):  # asked twice
        ended = result(agent, robot.name("count"), goal_id)
        assert ended["service"] == robot.name("count/_action/get_result")
        assert (ended["goal_id"], ended["waited"], ended["result_timeout_sec"]) == (sent["goal_id"], True, 60.0)
        assert (ended["status_code"], ended["status"]) == (4, "SUCCEEDED")
        assert ended["result"] == {"sequence": [0, 1, 2, 3, 4, 5]}


def test_a_goal_that_nobody_waits_for_is_seen_to_end(agent, start_agent, robot) -> None:
    own, action = start_agent(), robot.name("count")
    own.until_answered("ros2_topic_info", topic_name=f"{action}/_action/status")

    sent = send(own, action, LONG)
    until(lambda: is_followed(own, action))
    cancel(agent, action, goal_id_hex=sent["goal_id"])  # by another client: its server alone tells the sender
    until(lambda: not is_followed(own, action))
    assert own.call("ros2_stop")["goals"] == []


@pytest.mark.promise("ros2_send_action_goal", "Send a goal to an action server")
@pytest.mark.promise(
    "ros2_send_action_goal", "With wait_for_result, waits for the result and reports feedback as progress"
)
def test_a_goal_that_is_waited_for_brings_result_and_every_feedback(agent, robot) -> None:
    ended = send(agent, robot.name("count"), 4, wait_for_result=True, timeout_sec=30)
    assert (ended["status"], ended["result"], ended["waited"]) == ("SUCCEEDED", {"sequence": [0, 1, 2, 3]}, True)
    assert (ended["feedback_count"], ended["last_feedback"]) == (4, {"sequence": [0, 1, 2, 3]})


def test_no_feedback_is_lost_that_comes_at_once_and_together_with_the_result(agent, robot) -> None:
    for _ in range(100 if FULL else 15):
        ended = send(agent, robot.name("burst"), 20, wait_for_result=True)
        assert (ended["status"], ended["feedback_count"]) == ("SUCCEEDED", 20)


@pytest.mark.parametrize("wait", [True, False])
def test_a_rejected_goal_says_so(agent, robot, wait) -> None:
    sent = send(agent, robot.name("reject"), 3, wait_for_result=wait)
    assert (sent["accepted"], sent["status_code"], sent["status"]) == (False, -1, "NOT_ACCEPTED")
    assert sent["note"].startswith("The action server rejected the goal")
    assert f"{robot.name('peer')} WARN: «reject: the motors are disabled»" in sent["note"]
    assert sent["goal_id"] not in [goal["goal_id"] for goal in agent.call("ros2_stop")["goals"]]


def test_an_aborted_goal_says_so_with_its_result(agent, robot) -> None:
    ended = send(agent, robot.name("abort"), 3, wait_for_result=True)
    assert (ended["accepted"], ended["status_code"], ended["status"]) == (True, 6, "ABORTED")
    assert ended["result"] == {"sequence": [6]}


@pytest.mark.promise("ros2_send_action_goal", "after a time-out the goal continues (status TIMEOUT)")
@pytest.mark.promise("ros2_action_request_result", "A time-out does not cancel the goal")
def test_a_waiting_that_times_out_leaves_the_goal_running_and_says_so(agent, robot) -> None:
    action = robot.name("held")
    ended = send(agent, action, 1, wait_for_result=True, timeout_sec=0.3)
    assert (ended["status"], ended["status_code"], ended["result"]) == ("TIMEOUT", 0, None)
    assert "not cancelled" in ended["note"]
    assert result(agent, action, ended["goal_id"], timeout_sec=0)["status"] == "TIMEOUT"
    robot.release()
    assert result(agent, action, ended["goal_id"], timeout_sec=None)["status"] == "SUCCEEDED"
    wait_until(lambda: result(agent, action, ended["goal_id"], timeout_sec=0)["status"] == "SUCCEEDED")


@pytest.mark.promise("ros2_send_action_goal", "reports feedback as progress")
def test_waiting_reports_feedback_as_readable_progress(agent, robot) -> None:
    arguments = {"action_name": robot.name("count"), "goal_fields": {"order": 50}, "wait_for_result": True}

    def reported() -> list[str | None]:
        heard: list[tuple[float, float | None, str | None]] = []

        async def note(done: float, whole: float | None, line: str | None) -> None:
            heard.append((done, whole, line))

        agent.whole("ros2_send_action_goal", arguments, progress=note)
        assert [done for done, _, _ in heard] == sorted(done for done, _, _ in heard)
        assert {whole for _, whole, _ in heard} == {60.0}
        return [line for _, _, line in heard]

    lines = until(lambda: len(told := reported()) >= 3 and told)  # a bridge that is held up brings many at once
    assert any(line and line.startswith("sequence «[0,1") for line in lines)


def test_cancelling_the_call_that_waits_cancels_its_goal(agent, robot) -> None:
    before, cancelled = robot.count(name="count executing"), robot.count(name="canceled")
    waiting = agent.begin(
        "ros2_send_action_goal", action_name=robot.name("count"), goal_fields={"order": LONG}, wait_for_result=True
    )
    wait_until(lambda: robot.count(name="count executing") > before)
    waiting.cancel()
    wait_until(lambda: robot.count(name="canceled") > cancelled)


def test_a_cancelled_call_cancels_a_goal_that_is_accepted_only_then(agent, robot) -> None:
    for _ in range(TIMES):  # again where the answer came before a busy machine had cancelled the call
        judged, cancelled = robot.count(name="hesitate"), robot.count(name="canceled")
        sending = agent.begin("ros2_send_action_goal", action_name=robot.name("hesitate"), goal_fields={"order": 200})
        wait_until(lambda judged=judged: robot.count(name="hesitate") > judged)
        with suppress(AssertionError):
            if sending.cancel():
                return wait_until(lambda cancelled=cancelled: robot.count(name="canceled") > cancelled, 8.0)
    raise AssertionError("the goal was not cancelled with its call")


@pytest.mark.promise("ros2_wait_until", "Hidden topics work too, such as /navigate_to_pose/_action/status")
def test_goals_are_waited_for_on_the_hidden_topics_of_their_action(agent, robot) -> None:
    action = robot.name("count")
    ended = "any(status_list, status == STATUS_SUCCEEDED)"
    for topic, condition in (("feedback", "len(feedback.sequence) > 2"), ("status", ended)):
        waiting = agent.begin("ros2_wait_until", topic_name=f"{action}/_action/{topic}", condition=condition)
        while not waiting.done():  # whoever listens late misses the feedback of one goal
            send(agent, action, 5, wait_for_result=True)
        assert waiting.result()["met"]


@pytest.mark.promise("ros2_action_request_result", "Wait for the result of a goal, whoever sent the goal")
@pytest.mark.promise("ros2_action_status", "with its state and age")
@pytest.mark.promise(
    "ros2_action_subscribe_feedback",
    "Report the feedback of an action's goals for duration_sec, whoever sent the goals",
)
@pytest.mark.promise("ros2_cancel_action_goal", "Ask an action server to cancel a goal")
def test_goals_of_another_client_are_followed_and_cancelled(agent, robot, start_peer) -> None:
    action, other = robot.name("count"), start_peer()
    assert other.reaches(service=robot.name("there"))
    goal_id = other.send_goal(action=action, order=LONG)
    feedback = agent.call(
        "ros2_action_subscribe_feedback", action_name=action, goal_id_hex=goal_id, duration_sec=20, max_messages=5
    )
    assert feedback["topic"] == f"{action}/_action/feedback"
    assert (feedback["action_type"], feedback["goal_id_filter"]) == (FIBONACCI, goal_id)
    assert len(feedback["messages"]) == 5  # and not what would come in 20 s
    if FULL:
        assert feedback["duration_sec"] < 10
    sequences = [message["feedback"]["sequence"] for message in feedback["messages"]]
    assert [len(sequence) - len(sequences[0]) for sequence in sequences] == [0, 1, 2, 3, 4]
    assert all(m["goal_id"] == goal_id and m["recv_stamp"].endswith("Z") for m in feedback["messages"])
    (known,) = until(lambda: known_goals(agent, goal_id))  # an action is asked for a moment only
    assert (known["action_name"], known["status"], known["from_this_server"]) == (action, "EXECUTING", False)
    assert known["age_sec"] >= 0
    if FULL:
        assert known["age_sec"] < 25
    assert cancel(agent, action, goal_id_hex=goal_id)["goals_canceling"][0]["goal_id"] == goal_id
    assert result(agent, action, goal_id)["status"] == "CANCELED"
    assert other.result(goal_id=goal_id)[0] == 5


def known_goals(agent, goal_id: str):
    return [goal for goal in agent.call("ros2_action_status")["goals"] if goal["goal_id"] == goal_id]


@pytest.mark.promise("ros2_action_subscribe_status", "the last known states come first")
@pytest.mark.promise("ros2_action_subscribe_status", "Report state changes of an action's goals for duration_sec")
def test_the_states_of_a_goal_of_another_client_are_followed(agent, robot, start_peer) -> None:
    action, other = robot.name("count"), start_peer()
    assert other.reaches(service=robot.name("there"))

    def seen() -> list[str]:
        """The states of a goal that is cancelled meanwhile: in the 3 s of the call, unless the machine is busy."""
        goal_id = other.send_goal(action=action, order=LONG)
        follow = agent.begin("ros2_action_subscribe_status", action_name=action, duration_sec=3)
        until(lambda: follow.done() or is_followed(agent, action))
        assert cancel(agent, action, goal_id_hex=goal_id)["goals_canceling"][0]["goal_id"] == goal_id
        frames = follow.result(60)["frames"]
        return [s["status"] for frame in frames for s in frame["statuses"] if s["goal_id"] == goal_id]

    until(lambda: (states := seen()) and (states[0], states[-1]) == ("EXECUTING", "CANCELED"))


def is_followed(agent, action: str) -> bool:
    """Whether this server has subscribed to the states of the goals."""
    found = agent.call("ros2_topic_info", topic_name=f"{action}/_action/status")
    return any(row["from_this_server"] for row in found["subscribers"])


def test_feedback_of_no_goal_says_that_none_came(agent, robot) -> None:
    heard = agent.call("ros2_action_subscribe_feedback", action_name=robot.name("abort"), duration_sec=0.3)
    assert (heard["messages"], heard["goal_id_filter"]) == ([], None)
    assert heard["note"].startswith("No feedback")


def test_every_cancel_code_is_told(agent, robot) -> None:
    count, stubborn = robot.name("count"), robot.name("refuse_once")
    running = send(agent, count, LONG)["goal_id"]
    done = cancel(agent, count, goal_id_hex=running)
    assert (done["service"], done["return_code"], done["return_code_text"]) == (
        f"{count}/_action/cancel_goal",
        0,
        "ERROR_NONE",
    )
    assert [goal["goal_id"] for goal in done["goals_canceling"]] == [running]
    assert result(agent, count, running)["status"] == "CANCELED"
    refused = cancel(agent, robot.name("raw"), goal_id_hex=UNKNOWN_ID)
    assert (refused["return_code"], refused["return_code_text"]) == (1, "ERROR_REJECTED")
    kept = cancel(agent, stubborn, goal_id_hex=send(agent, stubborn, 1)["goal_id"])  # how rclpy refuses
    assert (kept["return_code"], kept["goals_canceling"]) == (0, [])
    assert kept["note"] == "The server refused to cancel this goal."
    unknown = cancel(agent, count, goal_id_hex=UNKNOWN_ID)
    assert (unknown["return_code"], unknown["return_code_text"]) == (2, "ERROR_UNKNOWN_GOAL_ID")
    ended = cancel(agent, count, goal_id_hex=running)
    assert (ended["return_code"], ended["return_code_text"]) == (3, "ERROR_GOAL_TERMINATED")


@pytest.mark.promise("ros2_cancel_action_goal", "or all goals")
def test_all_goals_or_those_up_to_a_time_are_cancelled(agent, robot) -> None:
    action = robot.name("count")
    first = send(agent, action, LONG)
    between_ns = at_ns(first["send_goal_stamp"]) + 1_000_000_000  # its server notes it a moment later
    until(lambda: time.time_ns() > between_ns)
    second = send(agent, action, LONG)
    sec, nanosec = divmod(between_ns, 10**9)
    older = cancel(agent, action, cancel_all=True, stamp_sec=sec, stamp_nanosec=nanosec)
    assert [goal["goal_id"] for goal in older["goals_canceling"]] == [first["goal_id"]]
    assert result(agent, action, first["goal_id"])["status"] == "CANCELED"
    rest = cancel(agent, action, cancel_all=True)
    assert [goal["goal_id"] for goal in rest["goals_canceling"]] == [second["goal_id"]]
    assert result(agent, action, second["goal_id"])["status"] == "CANCELED"
    assert cancel(agent, action, cancel_all=True)["note"] == "No goal was running, or the server refused."


def at_ns(stamp) -> int:
    return stamp["sec"] * 10**9 + stamp["nanosec"]


def test_cancelling_without_a_goal_or_with_zeros_is_refused_since_it_would_mean_all(agent, robot) -> None:
    def said(goal_id: str) -> str:
        return agent.refusal("ros2_cancel_action_goal", action_name=robot.name("count"), goal_id_hex=goal_id)

    before = robot.count(name="count cancel")
    assert said("").startswith("BadValue: goal_id_hex: no goal id is given.")
    assert said("0" * 32).startswith("BadValue: goal_id_hex: an id of zeros stands for every goal.")
    assert said("xyz").startswith("BadValue: goal_id_hex: 'xyz' is not a goal id.")
    assert robot.count(name="count cancel") == before


def test_a_goal_that_the_server_never_knew_or_has_forgotten_is_unknown(agent, robot) -> None:
    action = robot.name("forget")
    never = result(agent, action, UNKNOWN_ID)
    assert never["status"] == "UNKNOWN"
    assert never["note"] == "The server does not know this goal: the id is wrong, or the server has dropped the goal."
    # Of a goal that is kept for a second: who is held up for longer asks for one that has been forgotten.
    sent = until(lambda: (one := send(agent, action, 1, wait_for_result=True))["status"] == "SUCCEEDED" and one)
    wait_until(lambda: result(agent, action, sent["goal_id"])["status"] == "UNKNOWN")
    ended = result(agent, action, sent["goal_id"])
    assert (ended["status_code"], ended["result"]) == (0, None)
    assert "does not know this goal any more" in ended["note"]
    assert "it was accepted; it was seen to end: SUCCEEDED" in ended["note"]
    open_now = [goal["goal_id"] for goal in agent.call("ros2_stop")["goals"]]
    assert not {UNKNOWN_ID, sent["goal_id"]} & set(open_now)


def test_an_unknown_action_is_said_to_be_unknown_with_the_nearest_name(agent, robot) -> None:
    for tool, more in (
        ("ros2_send_action_goal", {"goal_fields": {}}),
        ("ros2_action_request_result", {"goal_id_hex": UNKNOWN_ID}),
        ("ros2_cancel_action_goal", {"cancel_all": True}),
        ("ros2_action_subscribe_feedback", {}),
        ("ros2_action_subscribe_status", {}),
    ):
        said = agent.refusal(tool, action_name=robot.name("cuont"), **more)
        assert said.startswith(f"NotFound: There is no action {robot.name('cuont')}"), tool
        assert robot.name("count") in said


@pytest.mark.parametrize(
    "goal, path",
    [
        ({"order": "3"}, "order"),
        ({"order": 3.5}, "order"),
        ({"order": 2**31}, "order"),
        ({"ordre": 3}, "ordre"),
    ],
)
def test_a_wrong_goal_names_the_path_and_is_not_sent(agent, robot, goal, path) -> None:
    before = robot.count(name="count")
    said = agent.refusal("ros2_send_action_goal", action_name=robot.name("count"), goal_fields=goal)
    assert said.startswith(f"BadValue: {path}: ")
    assert robot.count(name="count") == before


@pytest.mark.promise(
    "README", "Every value is checked against the definition that the robot itself has, before anything is sent"
)
def test_a_wrong_value_deep_inside_a_goal_names_its_path_and_is_not_sent(agent, robot) -> None:
    goal = {"nested_field_no_pkg": {"duration_value": {"sec": "soon"}}}
    said = agent.refusal("ros2_send_action_goal", action_name=robot.name("nested"), goal_fields=goal)
    assert said.startswith("BadValue: nested_field_no_pkg.duration_value.sec: ")
    assert robot.count(name="nested") == 0
    assert send_nested(agent, robot)["status"] == "SUCCEEDED"
    assert robot.count(name="nested") == 1


def send_nested(agent, robot):
    goal = {"nested_field_no_pkg": {"duration_value": {"sec": 2}}}
    name = robot.name("nested")
    return agent.call("ros2_send_action_goal", action_name=name, goal_fields=goal, wait_for_result=True)


def wait_until(condition, within_s: float = 30.0) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.02)
