"""Names and types are matched by whole segments, and a service means the same whichever way it is called."""

from __future__ import annotations

import json

import pytest

from ros2_mcp_common.policy.checks import Checks
from ros2_mcp_common.policy.rules import Allowance, Forbidden, Limit, Rules, RuleSet, judged_part
from ros2_mcp_common.policy.verbs import META_TYPES, is_meta, matches, meaning

TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.parametrize(
    ("pattern", "name", "fits", "fits_hidden"),
    [
        ("/cmd_vel", "/cmd_vel", True, True),
        ("/cmd_vel", "/cmd_vel_raw", False, False),
        ("/cmd_vel", "/CMD_VEL", False, False),
        ("/cmd_vel", "/cmd_vel/x", False, False),
        ("/cmd_vel", "/a/cmd_vel", False, False),
        ("/*/cmd_vel", "/a/cmd_vel", True, True),
        ("/*/cmd_vel", "/cmd_vel", False, False),
        ("/*/cmd_vel", "/a/b/cmd_vel", False, False),
        ("/**/cmd_vel", "/cmd_vel", True, True),
        ("/**/cmd_vel", "/a/b/cmd_vel", True, True),
        ("/**", "/a/b/c", True, True),
        ("**", "/a", True, True),
        ("/**", "/a/_action/feedback", False, True),
        ("/*", "/_hidden", False, True),
        ("/**/feedback", "/a/_action/feedback", False, True),
        ("/a/_action/*", "/a/_action/feedback", True, True),
        ("/**/_action/feedback", "/a/_action/feedback", True, True),
        ("geometry_msgs/msg/*", TWIST, True, True),
        ("geometry_msgs/**", TWIST, True, True),
        ("geometry_msgs/*", TWIST, False, False),
        ("*/msg/Twist", TWIST, True, True),
        ("**", TWIST, True, True),
    ],
)
def test_a_pattern_fits_whole_segments(pattern: str, name: str, fits: bool, fits_hidden: bool) -> None:
    assert matches([pattern], name) is fits
    assert matches([pattern], name, hidden=True) is fits_hidden


@pytest.mark.timeout(20)
def test_no_pattern_takes_long_for_any_name() -> None:
    assert not matches(["/**/a" * 40 + "/b"], "/a" * 2000)
    assert matches(["/**/a" * 40 + "/**"], "/a" * 2000)


@pytest.mark.parametrize(
    ("service", "kind", "verb", "name", "meant_type"),
    [
        ("/arm/go/_action/send_goal", "m/action/Go_SendGoal", "goal", "/arm/go", "m/action/Go"),
        ("/proxy/send", "m/action/Go_SendGoal", "call", "/proxy/send", "m/action/Go_SendGoal"),
        ("/go/_action/send_goal", "std_srvs/srv/Trigger", "call", "/go/_action/send_goal", "std_srvs/srv/Trigger"),
        ("/go/_action/cancel_goal", "action_msgs/srv/CancelGoal", "cancel", "/go", "action_msgs/srv/CancelGoal"),
        ("/n/set_parameters", "rcl_interfaces/srv/SetParameters", "set", "/n", "rcl_interfaces/srv/SetParameters"),
        ("/n/set_parameters_atomically", "rcl_interfaces/srv/SetParametersAtomically", "set", "/n",
         "rcl_interfaces/srv/SetParametersAtomically"),
        ("/n/set", "rcl_interfaces/srv/SetParameters", "call", "/n/set", "rcl_interfaces/srv/SetParameters"),
        ("/n/change_state", "lifecycle_msgs/srv/ChangeState", "transition", "/n", "lifecycle_msgs/srv/ChangeState"),
        ("/n/get_state", "lifecycle_msgs/srv/GetState", "read", "/n/get_state", "lifecycle_msgs/srv/GetState"),
        ("/go/_action/get_result", "m/action/Go_GetResult", "read", "/go/_action/get_result", "m/action/Go_GetResult"),
    ],
)  # fmt: skip
def test_a_service_means_what_its_name_and_type_say(
    service: str, kind: str, verb: str, name: str, meant_type: str
) -> None:
    meant = meaning(service, kind)
    assert (meant.verb, meant.name, meant.type) == (verb, name, meant_type)


SERVICES = [
    "composition_interfaces/srv/LoadNode", "controller_manager_msgs/srv/SwitchController", "slam_toolbox/srv/SaveMap",
    "nav2_msgs/srv/ManageLifecycleNodes", "nav2_msgs/srv/Toggle", "rosbag2_interfaces/srv/Play",
    "topic_tools_interfaces/srv/MuxSelect", "rosapi_msgs/srv/SetParam", "gazebo_msgs/srv/SetEntityState",
    "rcl_interfaces/srv/SetParameters", "lifecycle_msgs/srv/ChangeState", "made/action/Go_SendGoal",
    "action_msgs/srv/CancelGoal", "mavros_msgs/srv/CommandLong",
]  # fmt: skip


@pytest.mark.parametrize("kind", SERVICES)
def test_no_pattern_allows_a_service_that_changes_what_else_may_happen(kind: str) -> None:
    assert is_meta(kind)
    wide = Allowance("a", "call", ("/**",))
    named = Allowance("a", "call", ("/x/y",), types=(kind,))
    assert not wide.covers("call", "/x/y", kind)
    assert not named.covers("call", "/x/y", kind)
    assert Allowance("a", "call", ("/**",), meta=True).covers("call", "/x/y", kind)


def test_what_is_ordinary_is_no_such_service() -> None:
    assert not any(map(is_meta, ("std_srvs/srv/Trigger", "nav2_msgs/srv/ClearEntireCostmap", "made/srv/Set")))
    assert len(META_TYPES) == len(set(META_TYPES))


@pytest.mark.parametrize(
    ("entry", "verbs"),
    [
        (Forbidden("f", "publish", ("/x",)), {"publish", "relay", "play"}),
        (Forbidden("f", "call", ("/**",)), {"call", "set", "transition", "goal", "cancel"}),
        (Forbidden("f", types=("a/**",)), {"publish", "relay", "play", "call", "set", "transition", "goal", "cancel"}),
        (Forbidden("f", "goal", ("/x",)), {"goal"}),
    ],
)
def test_what_is_forbidden_is_so_by_every_way(entry: Forbidden, verbs: set[str]) -> None:
    every = ("publish", "relay", "play", "call", "set", "transition", "goal", "cancel")
    assert {verb for verb in every if entry.covers(verb, "/x", "a/msg/B")} == verbs


def limited(name: str, norm: float, **more: float) -> RuleSet:
    limits = (Limit("l", (TWIST,), checks=Checks(norm={"linear": norm}), hold_s=more.get("hold_s")),)
    allow = Allowance("a", "publish", ("/cmd_vel",), (TWIST,), rate_hz=more.get("rate_hz"), for_s=more.get("for_s"))
    return RuleSet(name, (allow, Allowance("b", "relay", ("/cmd_vel",), (TWIST,), sources=("/in",))), limits=limits)


def test_of_several_policies_the_least_bound_holds() -> None:
    rules = Rules("d", (limited("one", 0.3, rate_hz=50, hold_s=1.0), limited("two", 0.2, rate_hz=20, for_s=9)))
    ruling = rules.topic("/cmd_vel", TWIST)
    assert (ruling.most("rate_hz"), ruling.most("for_s"), ruling.most("per_minute")) == (20, 9, None)
    assert ruling.hold_s == 1.0
    value = {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}}
    settled = ruling.settle(value, "tool")
    assert (settled.rule, settled.clamped) == ("l", False)
    assert ruling.settle(value, "stream").clamped
    assert value["linear"]["x"] == pytest.approx(0.2, rel=1e-5)
    assert Rules.from_json(json.loads(json.dumps(rules.as_json()))) == rules


def test_a_relay_takes_only_from_the_sources_of_its_rule() -> None:
    ruling = Rules("d", (limited("one", 0.3),)).topic("/cmd_vel", TWIST, ("relay", "play"))
    assert not ruling.problem
    assert (ruling.allows_source("/in"), ruling.allows_source("/evil")) == (True, False)


def test_what_is_judged_of_a_request_is_what_it_is_about() -> None:
    value = {"type": 3, "double_value": 0.5, "integer_value": 9}
    request = {"parameters": [{"name": "speed", "value": value}]}
    assert judged_part("set", request) == {"speed": 0.5}
    assert judged_part("goal", {"goal_id": {}, "goal": {"order": 1}}) == {"order": 1}
    assert judged_part("call", request) is request
    with pytest.raises(ValueError, match="twice"):
        judged_part("set", {"parameters": request["parameters"] * 2})
