"""What a policy says to a command: name and type, value, rate, duration, sources, force, and who else publishes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ros2_mcp.guard.document import Mode
from ros2_mcp.guard.policy import Decision, Facts, Policy
from ros2_mcp.guard.policy_file import compiled, document_of
from ros2_mcp.model.commands import SERVER, CancelGoals, Command, Feed, Play, Publish, Record, Relay, Repeat
from ros2_mcp.model.qos import QoS
from support.noting_bridge import CHOICE, EVERY, LOCAL, TWIST, call, goal

SLOW = """
policy: 1
name: slow
allow:
  - {publish: [/cmd_vel, /*/cmd_vel], type: geometry_msgs/msg/Twist, rate_hz: 50, for_s: 10, sole_publisher: true}
  - {relay: /cmd_vel, type: geometry_msgs/msg/Twist, from: /teleop, for_s: 60}
  - {play: /cmd_vel, type: geometry_msgs/msg/Twist, for_s: 60}
  - {goal: /go, type: made/action/Go, consent: each, fields: {order: {range: [0, 5]}}}
  - {set: /camera, names: [exposure], fields: {exposure: {range: [1, 500]}}}
  - {transition: /camera, transitions: [activate]}
  - {call: "/**", type: "**"}
  - {record: [/odom]}
forbid:
  - {call: "/**/toggle"}
  - {types: ["secret_msgs/**"]}
limits:
  base: {types: geometry_msgs/msg/Twist, norm: {linear: 0.2, angular: 0.5}, zero: [linear.z]}
"""


def policy(*texts: str) -> Policy:
    documents = [document_of(text, "p.yaml") for text in texts]
    return Policy(documents=documents, rules=compiled(documents))


def twist(x: float = 0.0, z: float = 0.0) -> dict[str, Any]:
    return {"linear": {"x": x, "y": 0.0, "z": z}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


def publish(name: str = "/cmd_vel", kind: str = TWIST) -> Publish:
    return Publish(principal=LOCAL, name=name, type=kind, choice=CHOICE, wait_match_s=0.0)


def repeat(**more: Any) -> Repeat:
    return Repeat(principal=LOCAL, name="/cmd_vel", type=TWIST, choice=CHOICE, wait_match_s=0.0, **more)


def relay(**more: Any) -> Relay:
    common: dict[str, Any] = {
        "relay_id": "r",
        "qos": QoS(),
        "wait_match_s": 0.0,
        "source": "/teleop",
        "duration_s": 9.0,
    }
    return Relay(principal=LOCAL, name="/cmd_vel", type=TWIST, **{**common, **more})


def play(**more: Any) -> Play:
    common: dict[str, Any] = {"relay_id": "r", "qos": QoS(), "wait_match_s": 0.0, "bag": "b", "topic": "/t"}
    return Play(principal=LOCAL, name="/cmd_vel", type=TWIST, **{**common, "duration_s": 9.0, **more})


def said(
    command: Command[Any], value: object = None, publishers: tuple[str, ...] = (), mode: Mode = "autonomous"
) -> str:
    decision = policy(SLOW).decide(command, Facts(value=value, publishers=publishers), mode)
    return decision.verdict if decision.verdict != "refused" else decision.reason


@pytest.mark.parametrize(
    ("command", "value"),
    [
        (publish(), twist(0.2)),
        (publish("/robot1/cmd_vel"), twist(-0.2)),
        (repeat(rate_hz=50.0, duration_s=10.0), twist(0.1)),
        (relay(), None),
        (play(), None),
        (Feed(principal=LOCAL, name="/cmd_vel", type=TWIST, relay_id="r"), None),
        (call("rcl_interfaces/srv/SetParameters", "/camera/set_parameters", {}), {"exposure": 100}),
        (call("lifecycle_msgs/srv/ChangeState", "/camera/change_state", {}), {"transition": {"id": 3, "label": ""}}),
        (call("lifecycle_msgs/srv/ChangeState", "/camera/change_state", {}),
         {"transition": {"id": 0, "label": "activate"}}),
        (call("std_srvs/srv/SetBool", "/lamp", {}), {"data": True}),
        (call("rcl_interfaces/srv/GetParameters", "/any/get_parameters", {}), None),
        (Record(principal=LOCAL, name="bag", topics=["/odom"]), None),
        (Record(principal=SERVER, name="black box", topics=[]), None),
    ],
)  # fmt: skip
def test_what_a_rule_allows_is_allowed(command: Command[Any], value: object) -> None:
    assert said(command, value) == "allowed"


@pytest.mark.parametrize(
    ("command", "value", "reason"),
    [
        (publish("/a/b/cmd_vel"), twist(), "no rule allows it"),
        (publish("/cmd_vel_raw"), twist(), "no rule allows it"),
        (publish(kind="geometry_msgs/msg/TwistStamped"), twist(), "no rule allows it"),
        (publish("/go/_action/feedback"), twist(), "no rule allows it"),
        (publish(), twist(0.21), "linear is 0.21, at most 0.2 is allowed"),
        (publish(), twist(float("nan")), "at most 0.2"),
        (publish(), twist("nan"), "at most 0.2"),
        (publish(), twist(0.1, 0.1), "linear.z is 0.1, only 0 is allowed"),
        (publish(), {"speed": 0.0}, "there is no field linear"),
        (repeat(rate_hz=51.0), twist(), "at most 50 Hz"),
        (repeat(rate_hz=50.0, duration_s=10.5), twist(), "at most 10 s"),
        (relay(source="/evil"), None, "messages of /evil may not be relayed there"),
        (relay(duration_s=0.0), None, "no end is asked for"),
        (relay(duration_s=None, is_fed=True), None, "no end is asked for"),
        (play(force=True), None, "force is not allowed"),
        (play(speed=2.0), None, "1 at most"),
        (play(duration_s=0.0), None, "no end is asked for"),
        (goal(), {"order": 6}, "order is 6, 0 to 5 is allowed"),
        (call("rcl_interfaces/srv/SetParameters", "/camera/set_parameters", {}), {"exposure": 0}, "1 to 500"),
        (call("rcl_interfaces/srv/SetParameters", "/camera/set_parameters", {}), {"gain": 1}, "only exposure"),
        (call("rcl_interfaces/srv/SetParameters", "/base/set_parameters", {}), {"exposure": 1}, "no rule allows it"),
        (call("rcl_interfaces/srv/SetParameters", "/camera/set", {}), {"exposure": 1}, "no rule allows it"),
        (call("lifecycle_msgs/srv/ChangeState", "/camera/change_state", {}),
         {"transition": {"id": 4, "label": "activate"}}, "only activate"),
        (call("lifecycle_msgs/srv/ChangeState", "/camera/change_state", {}),
         {"transition": {"id": 4, "label": ""}}, "only activate"),
        (call("lifecycle_msgs/srv/ChangeState", "/camera/other", {}), {}, "no rule allows it"),
        (call("composition_interfaces/srv/LoadNode", "/container/_container/load_node", {}), {}, "no rule allows it"),
        (call("nav2_msgs/srv/Toggle", "/monitor/switch", {}), {}, "no rule allows it"),
        (call("std_srvs/srv/SetBool", "/monitor/toggle", {}), {}, "is forbidden"),
        (call("secret_msgs/srv/X", "/x", {}), {}, "is forbidden"),
        (call("made/action/Go_SendGoal", "/proxy/send", {}), {}, "no rule allows it"),
        (call("made/action/Go_SendGoal", "/other/_action/send_goal", {}), {}, "no rule allows it"),
        (CancelGoals(principal=LOCAL, name="/go", timeout_s=1.0), None, "no rule allows it"),
        (Record(principal=LOCAL, name="bag", topics=["/odom", "/camera"]), None, "no rule allows it"),
        (Record(principal=LOCAL, name="bag", topics=[]), None, "recording all topics"),
        (Record(principal=LOCAL, name="bag", topics=["/odom"], patterns=["*"]), None, "recording all topics"),
    ],
)  # fmt: skip
def test_what_no_rule_allows_is_refused_with_the_reason(command: Command[Any], value: object, reason: str) -> None:
    told = said(command, value)
    assert reason in told
    assert "slow" in told  # the rule, by the name of its policy


@pytest.mark.parametrize(
    ("service", "kind"),
    [
        ("/go/_action/send_goal", "made/action/Go_SendGoal"),
        ("/go/_action/cancel_goal", "action_msgs/srv/CancelGoal"),
        ("/camera/set_parameters", "rcl_interfaces/srv/SetParameters"),
        ("/camera/change_state", "lifecycle_msgs/srv/ChangeState"),
    ],
)
def test_a_service_that_may_not_be_called_is_not_called_whatever_it_means(service: str, kind: str) -> None:
    """As the reference says: `call` forbids every service, also those of actions, parameters and transitions."""
    acts = "{goal: /go, type: '**'}, {cancel: /go}, {set: /camera, names: ['**']}"
    text = f"policy: 1\nallow: [{acts}, {{transition: /camera, transitions: ['**']}}]"
    command = call(kind, service, {})
    assert policy(text).decide(command).verdict == "allowed"
    forbidden = policy(f"{text}\nforbid: [{{call: {service}}}]").decide(command)
    assert forbidden.verdict == "refused" and f"calling {service}" in forbidden.reason


def test_where_the_robot_itself_publishes_nothing_is_published_and_the_node_is_named() -> None:
    assert "/velocity_smoother of the robot publishes there itself" in said(publish(), twist(), ("/velocity_smoother",))


def test_each_of_several_policies_has_to_allow() -> None:
    slower = SLOW.replace("linear: 0.2", "linear: 0.1").replace("name: slow", "name: slower")
    only_publish = "policy: 1\nname: p\nallow: [{publish: /cmd_vel, type: '**'}]"
    both = policy(SLOW, slower)
    assert both.decide(publish(), Facts(value=twist(0.1))).verdict == "allowed"
    assert both.decide(publish(), Facts(value=twist(0.15))).verdict == "refused"
    assert policy(SLOW, only_publish).decide(relay()).verdict == "refused"
    assert policy(SLOW, only_publish).decide(publish("/a/cmd_vel")).verdict == "refused"
    assert policy(only_publish, SLOW).decide(publish(), Facts(value=twist(0.3))).verdict == "refused"
    assert replace(policy(only_publish), read_only=True).decide(publish()).verdict == "refused"


@pytest.mark.parametrize(
    ("consent", "mode", "verdict"),
    [
        ("", "autonomous", "allowed"),
        ("", "confirm", "consent"),
        ("each", "autonomous", "consent"),
        ("each", "confirm", "consent"),
        ("never", "confirm", "allowed"),
        ("never", "autonomous", "allowed"),
        ("never", "observe", "refused"),
        ("each", "observe", "refused"),
    ],
)
def test_who_has_to_approve_is_said_by_the_rule_and_by_the_mode(consent: str, mode: Mode, verdict: str) -> None:
    said = f", consent: {consent}" if consent else ""
    made = policy(f"policy: 1\nallow: [{{publish: /a, type: '**'{said}}}]")
    assert made.decide(publish("/a"), mode=mode).verdict == verdict


def test_of_several_rules_that_fit_the_mildest_counts_in_any_order() -> None:
    rules = ["{publish: /a, type: '**', consent: each}", "{publish: '/**', type: '**', consent: never}"]
    for order in (rules, rules[::-1]):
        made = policy(f"policy: 1\nallow: [{', '.join(order)}]")
        assert made.decide(publish("/a"), mode="confirm").verdict == "allowed"


def test_the_strictest_mode_of_the_policies_holds() -> None:
    assert (
        policy("policy: 1\nmode: autonomous", "policy: 1\nmode: observe", "policy: 1\nmode: confirm").mode == "observe"
    )
    assert Policy().mode == "autonomous"


@pytest.mark.parametrize("command", EVERY, ids=lambda command: type(command).__name__)
def test_without_a_policy_everything_is_allowed_and_with_an_empty_one_nothing(command: Command[Any]) -> None:
    assert Policy().decide(command) == Decision(verdict="allowed")
    assert policy("policy: 1\nname: nothing").decide(command).verdict == "refused"


def test_a_refusal_by_name_says_what_is_allowed_instead() -> None:
    decision = policy(SLOW).decide(publish("/joy"))
    assert decision.instead == "Publishing is allowed for /cmd_vel, /*/cmd_vel. ros2_policy shows what is allowed."
