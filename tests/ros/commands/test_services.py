"""Services through the real server, against independent rclpy servers."""

from __future__ import annotations

import itertools
import time
from concurrent.futures import wait

import pytest

from support.agent import FULL, until
from support.standstill import undisturbed

SWITCH = "std_srvs/srv/SetBool"
SLOW = "test_msgs/srv/BasicTypes"
ROUNDS = 200 if FULL else 3
HINT = "The server may still be working on it; give a longer timeout_sec."


def slow_request(text: str, delay_s: float = 0.0) -> dict[str, object]:
    return {"string_value": text, "float64_value": delay_s}


@pytest.mark.promise(
    "ros2_service_list", "List the services of the robot with their types, request fields and the nodes that serve them"
)
def test_a_service_is_listed_with_its_request_fields_and_the_node_that_serves_it(agent, robot) -> None:
    listed = agent.call("ros2_service_list", pattern=robot.name("*"))
    (entry,) = [one for one in listed["services"] if one["service_name"] == robot.name("switch")]
    assert entry == {
        "service_name": robot.name("switch"),
        "service_type": SWITCH,
        "request_fields": {"data": "bool"},
        "providers": [robot.name("peer")],
    }
    assert not [one for one in listed["services"] if "_action" in one["service_name"]]
    hint = "include_hidden=true lists them"
    assert hint in listed["note"] and hint in agent.call("ros2_service_list")["note"]
    exact = robot.name("peer/set_parameters")  # every node has it: shown where it was asked for
    assert exact in [one["service_name"] for one in agent.call("ros2_service_list", pattern=exact)["services"]]
    assert exact not in [one["service_name"] for one in agent.call("ros2_service_list", limit=2000)["services"]]
    hidden = agent.call("ros2_service_list", pattern=robot.name("*"), include_hidden=True, limit=200)
    assert robot.name("count/_action/send_goal") in [one["service_name"] for one in hidden["services"]]


@pytest.mark.promise("ros2_service_call", "Call a service and wait for its answer")
def test_the_response_is_an_object(agent, robot) -> None:
    answer = agent.call(
        "ros2_service_call", service_name=robot.name("switch"), service_type="std_srvs/SetBool", fields={"data": True}
    )
    assert answer["called"] is True
    assert answer["service_type"] == SWITCH
    assert answer["result"] == {"success": True, "message": "asked True"}


@pytest.mark.promise(
    "ros2_service_call", "If request fields are missing, the service is not called, and the result names them"
)
def test_missing_fields_are_named_and_nothing_is_called_unless_forced(agent, robot) -> None:
    before = robot.count(name="switch")
    asked = {"service_name": robot.name("switch"), "service_type": SWITCH, "fields": {}}
    answer = agent.call("ros2_service_call", **asked)
    assert (answer["called"], answer["result"], answer["missing_fields"]) == (False, None, ["data"])
    assert "force_call" in answer["note"]
    assert robot.count(name="switch") == before
    forced = agent.call("ros2_service_call", force_call=True, **asked)
    assert forced["result"]["message"] == "asked False"
    assert robot.count(name="switch") == before + 1


@pytest.mark.promise(
    "README", "Every value is checked against the definition that the robot itself has, before anything is sent"
)
@pytest.mark.promise(
    "README", "A wrong field, kind, length or range is an error that names the path and what would be right"
)
@pytest.mark.parametrize(
    "fields, path",
    [
        ({"data": "false"}, "data"),
        ({"data": 1}, "data"),
        ({"dato": True}, "dato"),
        ({"data": True, "extra": 1}, "extra"),
    ],
)
def test_a_wrong_request_names_the_path_and_is_not_sent(agent, robot, fields, path) -> None:
    before = robot.count(name="switch")
    said = agent.refusal("ros2_service_call", service_name=robot.name("switch"), fields=fields, force_call=True)
    assert said.startswith(f"BadValue: {path}: ")
    assert robot.count(name="switch") == before


@pytest.mark.promise("README", "nothing is cut or wrapped to fit")
@pytest.mark.parametrize("fields, path", [({"uint8_value": 300}, "uint8_value"), ({"int32_value": 1.5}, "int32_value")])
def test_a_number_that_does_not_fit_is_not_sent(agent, robot, fields, path) -> None:
    before = robot.count(name="slow")
    said = agent.refusal("ros2_service_call", service_name=robot.name("slow"), fields=fields, force_call=True)
    assert said.startswith(f"BadValue: {path}: ")
    assert robot.count(name="slow") == before


def test_an_unknown_service_is_said_to_be_unknown_with_the_nearest_name(agent, robot) -> None:
    said = agent.refusal("ros2_service_call", service_name=robot.name("swich"), fields={"data": True})
    assert said.startswith(f"NotFound: There is no service {robot.name('swich')}.")
    assert robot.name("switch") in said


def test_a_service_that_does_not_appear_is_told_with_the_nearest_name(agent, robot) -> None:
    absent_s(agent, robot)


@pytest.mark.full
def test_a_service_that_does_not_appear_ends_with_the_time_out(agent, robot) -> None:
    assert 0.5 <= undisturbed(lambda: absent_s(agent, robot)) < 1.5


def absent_s(agent, robot) -> float:
    """How long a call took that may take 0.5 s, of a service that is not there."""
    asked = {"service_name": robot.name("swich"), "service_type": SWITCH, "fields": {"data": True}}
    took, said = refused(agent, timeout_sec=0.5, **asked)
    assert said.startswith(f"NotFound: No server of {robot.name('swich')} appeared within 0.5 s.")
    assert robot.name("switch") in said
    return took


def refused(agent, **asked) -> tuple[float, str]:
    """How long a call took that was refused, and with what words."""
    started = time.monotonic()
    said = agent.refusal("ros2_service_call", **asked)
    return time.monotonic() - started, said


def test_another_type_than_the_services_own_is_refused_with_the_right_one(agent, robot) -> None:
    said = agent.refusal(
        "ros2_service_call", service_name=robot.name("switch"), service_type="std_srvs/srv/Trigger", fields={}
    )
    assert said.startswith(f"TypeConflict: {robot.name('switch')} has the type {SWITCH}, not std_srvs/srv/Trigger.")


def test_a_service_that_came_back_with_another_type_is_told(agent, start_peer) -> None:
    name = f"/changed{time.monotonic_ns()}"
    asked = {"service_name": f"{name}/switch", "service_type": SWITCH, "fields": {"data": True}, "timeout_sec": 2}
    before = start_peer("services", namespace=name)
    assert agent.call("ros2_service_call", **asked)["called"]
    before.leave()
    start_peer("changed", namespace=name)
    told = f"TypeConflict: {name}/switch has the type std_srvs"
    until(lambda: agent.refusal("ros2_service_call", **asked).startswith(told))  # the old one's goodbye may be late


def test_a_server_that_appears_within_the_time_out_is_used(agent, start_peer) -> None:
    name = f"/late{time.monotonic_ns()}"
    call = agent.begin(
        "ros2_service_call",
        service_name=f"{name}/switch",
        service_type=SWITCH,
        fields={"data": True},
        timeout_sec=50,
    )
    start_peer("services", namespace=name)
    assert call.result(60)["result"]["success"] is True


def test_a_server_that_appears_late_and_does_not_answer_in_the_rest_of_the_time_is_told(agent, start_peer) -> None:
    late_server_s(agent, start_peer, 10)


@pytest.mark.full
def test_the_time_out_bounds_waiting_for_the_server_and_its_answer_together(agent, start_peer) -> None:
    assert 2.0 <= undisturbed(lambda: late_server_s(agent, start_peer, 2)) < 3.0


def late_server_s(agent, start_peer, timeout_s: int) -> float:
    """How long a call took whose server comes while it waits, and would answer after a minute."""
    peer, started = start_peer(), time.monotonic()
    call = agent.begin(
        "ros2_service_call",
        service_name=peer.name("slow"),
        service_type=SLOW,
        fields=slow_request("x", 60.0),
        force_call=True,
        timeout_sec=timeout_s,
    )
    wait({call}, 0.5)
    assert not call.done()
    peer.offer(role="services")
    said = str(call.exception(60))
    assert "did not answer within" in said
    return time.monotonic() - started


def test_a_service_that_never_answers_is_reported_as_that(agent, robot) -> None:
    def said() -> str:
        """Why; nothing where a bridge that was held up had sent nothing until the time was over."""
        _, told = refused(agent, timeout_sec=0.4, **never_answered(robot))
        return "" if "nothing was sent" in told else told

    assert until(said) == f"TimedOut: {robot.name('slow')} did not answer within 0.4 s. {HINT}"


@pytest.mark.full
def test_a_service_that_never_answers_is_reported_within_the_time_out(agent, robot) -> None:
    took, _ = undisturbed(lambda: refused(agent, timeout_sec=0.4, **never_answered(robot)))
    assert 0.4 <= took < 1.4


def never_answered(robot) -> dict[str, object]:
    return {"service_name": robot.name("slow"), "fields": slow_request("never", 10.0), "force_call": True}


def test_a_late_answer_is_never_given_to_another_call(agent, robot) -> None:
    def call(text: str, delay_s: float, timeout_s: float) -> dict[str, object]:
        return agent.begin(
            "ros2_service_call",
            service_name=robot.name("slow"),
            fields=slow_request(text, delay_s),
            force_call=True,
            timeout_sec=timeout_s,
        )

    numbers = itertools.count()

    def was_late() -> bool:
        """One more round; a call whose bridge was held up until the answer came was not."""
        number = next(numbers)
        late = call(f"late {number}", 0.3, 0.2)
        told = late.exception(60)
        assert told is not None or late.result()["result"]["string_value"] == f"late {number}"
        waiting = [call(f"{number}-{index}", 0.15, 30.0) for index in range(3)]
        assert [one.result(60)["result"]["string_value"] for one in waiting] == [f"{number}-{i}" for i in range(3)]
        return "did not answer" in str(told)

    for _ in range(ROUNDS):
        until(was_late)


@pytest.mark.full
def test_a_hundred_calls_in_flight_are_all_answered_each_with_its_own(agent, robot) -> None:
    calls = [
        agent.begin(
            "ros2_service_call",
            service_name=robot.name("slow"),
            fields={"int64_value": number, "float64_value": 0.05},
            force_call=True,
            timeout_sec=20,
        )
        for number in range(100)
    ]
    assert [call.result(30)["result"]["int64_value"] for call in calls] == list(range(100))


def test_more_calls_than_the_queue_of_a_slow_server_holds_are_all_answered(agent, robot) -> None:
    """A server that takes one request after the other loses what does not fit its queue of ten."""
    calls = [
        agent.begin("ros2_service_call", service_name=robot.name("serial"), fields={"data": True}, timeout_sec=50)
        for _ in range(40)
    ]
    assert all(call.result(60)["result"]["success"] for call in calls)


def test_what_changes_nothing_is_asked_once_more_where_the_answer_may_have_been_lost(agent, robot) -> None:
    asked = {"service_name": robot.name("state"), "service_type": "lifecycle_msgs/srv/GetState"}
    call = agent.begin("ros2_service_call", **asked, timeout_sec=30)
    until(lambda: robot.take(name="state"))
    until(lambda: robot.answer(name="state"))
    assert call.result(60)["result"] == {"current_state": {"id": 0, "label": ""}}


def test_a_slow_call_does_not_delay_others(agent, robot) -> None:
    """They are answered before it, which takes as long as the call may take."""
    slow = agent.begin("ros2_service_call", service_name=robot.name("mute"), fields={"data": True}, timeout_sec=50)
    for _ in range(5):
        agent.call("ros2_service_call", service_name=robot.name("switch"), fields={"data": True})
    assert not slow.done()
    slow.cancel()


@pytest.mark.full
def test_beside_a_slow_call_five_others_take_less_than_a_second(agent, robot) -> None:
    def others() -> tuple[float, bool]:
        slow = agent.begin(
            "ros2_service_call", service_name=robot.name("slow"), fields=slow_request("x", 1.5), force_call=True
        )
        started = time.monotonic()
        for _ in range(5):
            agent.call("ros2_service_call", service_name=robot.name("switch"), fields={"data": True})
        took, was_done = time.monotonic() - started, slow.done()
        assert slow.result(60)["result"]["string_value"] == "x"
        return took, was_done

    took, was_done = undisturbed(others)
    assert took < 1.0
    assert not was_done


def test_a_service_whose_server_left_is_not_listed_although_we_once_called_it(agent, start_peer) -> None:
    peer = start_peer("services")
    agent.call("ros2_service_call", service_name=peer.name("switch"), fields={"data": True})
    peer.leave()
    deadline = time.monotonic() + 30
    while agent.call("ros2_service_list", pattern=peer.name("*"))["services"] and time.monotonic() < deadline:
        time.sleep(0.1)
    assert agent.call("ros2_service_list", pattern=peer.name("*"))["services"] == []
    said = agent.refusal("ros2_service_call", service_name=peer.name("switch"), fields={"data": True})
    assert said.startswith(f"NotFound: There is no service {peer.name('switch')}.")
