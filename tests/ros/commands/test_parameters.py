"""Parameters and lifecycle through the real server, against independent rclpy nodes."""

from __future__ import annotations

import re
import time

import pytest

from support.agent import until
from support.peer_process import reachable
from support.standstill import undisturbed

ALL = {
    "speed": 0.5,
    "steps": 5,
    "serial": "A-1",
    "enabled": True,
    "label": "3",
    "big": str(2**62 + 1),
    "pid.p": 1.5,
    "octets": [1, 255],
    "flags": [True, False],
    "counts": [1, str(2**60)],
    "gains": [0.5, "inf"],
    "names": ["a", "b"],
    "any": 1,
}


def get(agent, robot, *names: str):
    return agent.call("ros2_parameter_get", node_name=robot.name("tuned"), names=list(names) or None)


def put(agent, robot, atomic: bool = False, **values: object):
    return agent.call("ros2_parameter_set", node_name=robot.name("tuned"), values=values, atomic=atomic)


@pytest.fixture(autouse=True)
def as_it_was(agent, robot):
    yield
    values = {name: value for name, value in ALL.items() if name != "serial"}
    assert put(agent, robot, **values)["successful"]


@pytest.mark.promise(
    "ros2_parameter_get", "Read parameters of a node as name → value, in the form in which they can be set"
)
@pytest.mark.promise("ros2_parameter_set", "Set parameters of a node")
def test_a_whole_node_is_read_in_a_form_that_can_be_set_back(agent, robot) -> None:
    dump = get(agent, robot)
    own = {name: value for name, value in dump["parameters"].items() if name in ALL}
    assert own == ALL
    assert "serial" in dump["read_only"]
    put(agent, robot, speed=1.0, big=7, gains=[0.0], names=[], octets=[], label="other")
    assert put(agent, robot, **dump["parameters"])["successful"] is True
    assert get(agent, robot) == dump


def test_a_parameter_of_a_megabyte_is_told_by_its_length_and_given_whole_where_that_is_asked(agent, robot) -> None:
    text = "x" * 1_000_000
    set_to = put(agent, robot, label=text, counts=list(range(50_000)))
    assert set_to["successful"] and len(str(set_to)) < 50_000
    node = agent.call("ros2_parameter_list", node_names=[robot.name("tuned")])["nodes"][0]
    label = next(one for one in node["parameters"] if one["name"] == "label")
    assert (label["value"], label["omitted"]) == (None, "1000000 characters")
    assert len(str(node)) < 100_000
    dump = get(agent, robot)
    assert dump["omitted"] == {"label": "1000000 characters", "counts": "50000 elements"}
    assert not {"label", "counts"} & dump["parameters"].keys()
    assert put(agent, robot, **dump["parameters"])["successful"]
    whole = agent.call("ros2_parameter_get", node_name=robot.name("tuned"), names=["label"], whole=True)
    assert whole["parameters"] == {"label": text}


@pytest.mark.promise(
    "ros2_parameter_list", "List parameters with value, type, description, range and whether they are read-only"
)
@pytest.mark.promise("ros2_parameter_list", "several nodes at once")
def test_parameters_of_several_nodes_are_listed_at_once_with_what_their_descriptors_say(agent, robot) -> None:
    _, (tuned, opened, dumb, nobody, deaf) = several_listed(agent, robot)
    found = {parameter["name"]: parameter for parameter in tuned["parameters"]}
    assert found["speed"] == {
        "name": "speed",
        "type": "double",
        "value": 0.5,
        "description": "Fastest speed [m/s]",
        "read_only": False,
        "range": {"from": 0.0, "to": 2.0, "step": 0.0},
        "constraints": "",
        "omitted": "",
    }
    assert "not_set" not in found["speed"]
    assert found["steps"]["range"] == {"from": 0, "to": 10, "step": 5}
    assert (found["serial"]["read_only"], found["serial"]["range"]) == (True, None)
    assert opened["error"] == ""
    assert dumb["error"].startswith(f"{robot.name('dumb')} offers no parameter services.")
    assert nobody["error"].startswith(f"There is no node {robot.name('nobody')}.")
    assert deaf["error"] == f"{robot.name('deaf')} did not answer within 5 s: it is busy, or it hangs."


@pytest.mark.full
def test_a_node_that_does_not_answer_holds_up_a_list_for_its_five_seconds_only(agent, robot) -> None:
    assert undisturbed(lambda: several_listed(agent, robot))[0] < 7


def several_listed(agent, robot) -> tuple[float, list[dict]]:
    """How long a list of several nodes took, and the nodes: one of them does not answer."""
    wanted = [robot.name(name) for name in ("tuned", "open", "dumb", "nobody", "deaf")]
    started = time.monotonic()
    nodes = agent.call("ros2_parameter_list", node_names=wanted, pattern="s*")["nodes"]
    return time.monotonic() - started, nodes


def test_what_every_node_has_is_left_out_of_a_list_unless_it_is_asked_for_or_set(agent, robot) -> None:
    def listed(pattern: str = "") -> tuple[dict[str, object], str]:
        answer = agent.call("ros2_parameter_list", node_names=[robot.name("tuned")], pattern=pattern)
        return {one["name"]: one["value"] for one in answer["nodes"][0]["parameters"]}, answer["note"]

    found, note = listed()
    assert "speed" in found and "use_sim_time" not in found
    assert re.match(r"Not shown: \d standard parameters \(use_sim_time at its default, ", note)
    assert listed("use_sim*") == ({"use_sim_time": False}, "")
    put(agent, robot, use_sim_time=True)
    assert listed()[0]["use_sim_time"] is True
    put(agent, robot, use_sim_time=False)


def test_a_set_tells_what_each_value_was(agent, robot) -> None:
    values = {"speed": 1.5, "label": "other"}
    found = agent.whole("ros2_parameter_set", {"node_name": robot.name("tuned"), "values": values})
    said = f"{robot.name('tuned')}: 2 of 2 parameters set: speed = 1.5 (was 0.5), label = «other» (was «3»)."
    assert found.content[0].text.startswith(said)


@pytest.mark.parametrize(
    "name, given, taken",
    [("speed", 1, 1.0), ("steps", 10.0, 10), ("gains", [1, 2.5, "-inf"], [1.0, 2.5, "-inf"]), ("any", "text", "text")],
)
def test_values_are_converted_where_nothing_is_lost(agent, robot, name, given, taken) -> None:
    answer = put(agent, robot, **{name: given})
    assert answer["parameters"] == [{"name": name, "successful": True, "reason": "", "value": taken, "omitted": ""}]
    assert type(answer["parameters"][0]["value"]) is type(taken)


@pytest.mark.promise("ros2_parameter_set", "Values are checked against type and range first, and read back afterwards")
@pytest.mark.parametrize(
    "name, given, said",
    [
        ("steps", "5", 'steps: "5" is not of type integer.'),
        ("steps", True, "steps: true is not of type integer."),
        ("steps", 5.5, "steps: 5.5 is not of type integer."),
        ("steps", 10**19, "steps: 10000000000000000000 does not fit"),
        ("enabled", 1, "enabled: 1 is not of type bool."),
        ("enabled", "true", 'enabled: "true" is not of type bool.'),
        ("label", 3, "label: 3 is not of type string."),
        ("speed", "fast", 'speed: "fast" is not of type double.'),
        ("speed", 2.5, "speed: 2.5 is out of range. It takes 0.0 to 2.0."),
        ("steps", 11, "steps: 11 is out of range. It takes 0 to 10."),
        ("gains", [1.0, "x"], 'gains[1]: "x" is not of type double.'),
        ("flags", True, "flags: true is not an array."),
        ("octets", [256], "octets[0]: 256 is not a byte."),
        ("serial", "B-2", "serial: it is read-only."),
        ("sped", 1.0, "sped: "),
    ],
)
def test_a_wrong_value_names_the_parameter_and_nothing_is_set(agent, robot, name, given, said) -> None:
    before = robot.count(name="set")
    values = {"enabled": False, name: given}
    refusal = agent.refusal("ros2_parameter_set", node_name=robot.name("tuned"), values=values)
    assert refusal.startswith(f"BadValue: {said}")
    assert refusal.endswith("Nothing was set.")
    assert robot.count(name="set") == before
    assert get(agent, robot, "enabled")["parameters"] == {"enabled": True}


def test_what_the_node_refuses_is_told_in_its_words_and_the_rest_is_set(agent, robot) -> None:
    answer = put(agent, robot, label="bad", enabled=False)
    assert answer["successful"] is False
    assert answer["parameters"] == [
        {
            "name": "label",
            "successful": False,
            "reason": "the label is bad, says the node",
            "value": "3",
            "omitted": "",
        },
        {"name": "enabled", "successful": True, "reason": "", "value": False, "omitted": ""},
    ]


def test_a_step_that_the_range_does_not_allow_is_refused_by_the_node(agent, robot) -> None:
    (one,) = put(agent, robot, steps=4)["parameters"]
    assert (one["successful"], one["value"]) == (False, 5)
    assert "step" in one["reason"]


def test_atomic_setting_takes_all_or_none(agent, robot) -> None:
    answer = put(agent, robot, atomic=True, enabled=False, label="bad")
    assert (answer["successful"], answer["atomic"]) == (False, True)
    assert {one["reason"] for one in answer["parameters"]} == {"the label is bad, says the node"}
    assert get(agent, robot, "enabled", "label")["parameters"] == {"enabled": True, "label": "3"}
    assert put(agent, robot, atomic=True, enabled=False, label="good")["successful"] is True
    assert get(agent, robot, "enabled", "label")["parameters"] == {"enabled": False, "label": "good"}


def test_an_unknown_parameter_is_named_with_the_nearest(agent, robot) -> None:
    said = agent.refusal("ros2_parameter_get", node_name=robot.name("tuned"), names=["sped"])
    assert said.startswith(f"NotFound: {robot.name('tuned')} has no parameter sped. Did you mean speed?")


def test_a_node_that_allows_undeclared_parameters_takes_new_ones(agent, robot) -> None:
    node = robot.name("open")
    answer = agent.call("ros2_parameter_set", node_name=node, values={"fresh": 3, "more": [1, 2.5]})
    assert [one["value"] for one in answer["parameters"]] == [3, [1.0, 2.5]]


@pytest.fixture(scope="module")
def unset(nursery, agent):
    peer = reachable(agent, nursery, "unset")
    yield peer
    peer.leave()


UNSET = {
    "a_first": "integer",
    "gain_07_name": "string",
    "loose": "dynamic",
    "plugins": "string_array",
    "z_last": "bool",
}


def test_parameters_that_are_declared_and_not_set_take_nothing_from_the_others(agent, unset) -> None:
    (node,) = agent.call("ros2_parameter_list", node_names=[unset.name("mapper")])["nodes"]
    found = {one["name"]: one for one in node["parameters"]}
    assert {name: one["type"] for name, one in found.items() if one.get("not_set")} == UNSET
    assert [found[f"gain_{number:02d}"]["value"] for number in range(20)] == [float(number) for number in range(20)]
    assert found["gain_07_name"]["description"] == "Of the seventh" and found["z_last"]["read_only"]
    dump = agent.call("ros2_parameter_get", node_name=unset.name("mapper"))
    assert dump["unset_types"] == UNSET and dump["parameters"]["gain_19"] == 19.0
    assert agent.call("ros2_parameter_get", node_name=unset.name("mapper"), names=["plugins", "gain_03"])[
        "parameters"
    ] == {"gain_03": 3.0}


def test_a_parameter_that_is_not_set_is_set_by_its_declared_type(agent, unset) -> None:
    node = unset.name("mapper")
    said = agent.refusal("ros2_parameter_set", node_name=node, values={"gain_07_name": 7})
    assert said.startswith("BadValue: gain_07_name: 7 is not of type string.")
    found = agent.whole("ros2_parameter_set", {"node_name": node, "values": {"gain_07_name": "seven"}})
    assert "gain_07_name = «seven» (was not set)" in found.content[0].text
    got = agent.call("ros2_parameter_get", node_name=node, names=["gain_07_name"])
    assert (got["parameters"], got["unset_types"]) == ({"gain_07_name": "seven"}, {})


def test_a_node_that_answers_for_fewer_than_it_is_asked_for_is_asked_for_each(agent, unset) -> None:
    dump = agent.call("ros2_parameter_get", node_name=unset.name("terse"))
    assert (dump["parameters"], dump["unset_types"]) == ({"here": 7, "there": 0.5}, {"gone": "string"})


def test_a_node_that_takes_one_at_a_time_is_given_one_after_the_other(agent, unset) -> None:
    node = unset.name("one_at_a_time")
    found = agent.call("ros2_parameter_set", node_name=node, values={"gain": 2.5, "offset": 3, "mode": "fast"})
    told = {one["name"]: (one["successful"], one["value"]) for one in found["parameters"]}
    assert told == {"gain": (True, 2.5), "offset": (True, 3), "mode": (False, "slow")}
    assert found["successful"] is False and "only by hand" in found["parameters"][2]["reason"]


def test_a_part_of_a_long_parameter_is_read_by_its_place_in_it(agent, robot) -> None:
    text = "".join(f"<{number}>" for number in range(5000))
    assert put(agent, robot, label=text)["successful"]
    dump = get(agent, robot)
    hint = agent.whole("ros2_parameter_get", {"node_name": dump["node"]}).content[0].text
    assert 'names=["label[0:8000]"]' in hint and "with whole=true neither" in hint
    assert 'names=["label[0:8000]"]' in agent.call("ros2_parameter_list", node_names=[dump["node"]])["note"]
    found = get(agent, robot, "label[0:8000]", "label[20000:]", "counts[:1]", "steps")
    assert found["parts"] == {"label[0:8000]": text[:8000], "label[20000:]": text[20000:], "counts[:1]": [1]}
    assert found["parameters"] == {"steps": 5}
    assert "neither a string" in agent.refusal(
        "ros2_parameter_get", node_name=robot.name("tuned"), names=["steps[0:2]"]
    )


def test_a_hint_is_never_what_was_asked_for(agent, unset) -> None:
    said = agent.refusal("ros2_parameter_get", node_name=unset.name("mapper"), names=["gain_99"])
    assert said.startswith(f"NotFound: {unset.name('mapper')} has no parameter gain_99. Did you mean gain_")
    assert "gain_99?" not in said


def test_an_empty_list_tells_how_it_is_declared(agent, unset) -> None:
    node = unset.name("mapper")
    assert agent.call("ros2_parameter_get", node_name=node)["empty_list_types"] == {"untyped_list": "byte_array"}
    said = agent.refusal("ros2_parameter_set", node_name=node, values={"untyped_list": ["a"]})
    assert "declared as byte_array" in said and "declared as integer" not in said


def test_a_value_whose_node_does_not_answer_may_still_take_effect_and_that_is_said(agent, unset) -> None:
    node = unset.name("slow_to_set")
    said = agent.refusal("ros2_parameter_set", node_name=node, values={"gain": 5.0})
    assert said.startswith(f"TimedOut: {node} did not answer") and "may still take effect" in said
    unset.release()
    until(lambda: agent.call("ros2_parameter_get", node_name=node, names=["gain"])["parameters"] == {"gain": 5.0})


@pytest.mark.promise(
    "ros2_node_info",
    "Show what a node publishes, subscribes to, serves and calls, its lifecycle state and number of parameters",
)
def test_node_info_tells_parameters_lifecycle_services_and_actions(agent, robot) -> None:
    tuned = answered(agent, robot.name("tuned"), "parameters")
    assert (tuned["parameters"], tuned["lifecycle_state"]) == (len(get(agent, robot)["parameters"]), None)
    valve = answered(agent, robot.name("valve"), "lifecycle_state")
    assert (valve["is_lifecycle"], valve["lifecycle_state"]) == (True, "unconfigured")
    assert valve["omitted"] == 6  # those for parameters
    peer = agent.call("ros2_node_info", node_name=robot.name("peer"))
    assert peer["omitted"] > 6
    assert {"name": robot.name("switch"), "type": "std_srvs/srv/SetBool"} in peer["services"]
    assert {"name": robot.name("count"), "type": "test_msgs/action/Fibonacci"} in peer["actions"]


def answered(agent, node: str, what: str):
    """The information about a node, as soon as it has this: it tells only what the node has answered in a moment."""
    return until(lambda: (info := agent.call("ros2_node_info", node_name=node))[what] is not None and info)


def test_node_info_leaves_out_what_a_node_does_not_answer(agent, robot) -> None:
    _, deaf = asked_of_the_deaf(agent, robot)
    assert (deaf["has_parameters"], deaf["parameters"]) == (True, None)
    dumb = agent.call("ros2_node_info", node_name=robot.name("dumb"))
    assert (dumb["has_parameters"], dumb["parameters"]) == (False, None)


@pytest.mark.full
def test_node_info_does_not_wait_long_for_a_node_that_does_not_answer(agent, robot) -> None:
    assert undisturbed(lambda: asked_of_the_deaf(agent, robot))[0] < 0.6


def asked_of_the_deaf(agent, robot) -> tuple[float, dict]:
    """How long the information about a node that never answers took, and what it is."""
    started = time.monotonic()
    info = agent.call("ros2_node_info", node_name=robot.name("deaf"))
    return time.monotonic() - started, info


@pytest.mark.promise("ros2_lifecycle_state", "Show the state of lifecycle nodes and the transitions possible now")
@pytest.mark.promise("ros2_lifecycle_change", "Trigger a transition of a lifecycle node by name")
def test_a_lifecycle_node_is_moved_by_name_and_says_what_is_possible(agent, robot) -> None:
    node = robot.name("valve")

    def change(transition: str):
        return agent.call("ros2_lifecycle_change", node_name=node, transition=transition)

    states = agent.call("ros2_lifecycle_state")["nodes"]
    expected = {"node": node, "state": "unconfigured", "transitions": ["configure", "shutdown"], "error": ""}
    assert expected in states
    done = change("configure")
    assert (done["successful"], done["state_before"], done["state"]) == (True, "unconfigured", "inactive")
    assert done["transitions"] == ["activate", "cleanup", "shutdown"]
    failed = change("activate")
    assert (failed["successful"], failed["state"]) == (False, "inactive")
    assert failed["note"] == f"The robot logged meanwhile: {node} ERROR: «the valve sticks»."
    assert change("activate")["state"] == "active"
    said = agent.refusal("ros2_lifecycle_change", node_name=node, transition="configure")
    possible = "Possible now: deactivate, shutdown."
    assert said == f"BadInput: {node} is active, where the transition 'configure' is not possible. {possible}"
    assert change("deactivate")["state"] == "inactive"
    assert change("cleanup")["state"] == "unconfigured"


def test_a_node_without_a_lifecycle_says_so(agent, robot) -> None:
    said = agent.refusal("ros2_lifecycle_change", node_name=robot.name("tuned"), transition="configure")
    assert said.startswith(f"NotFound: {robot.name('tuned')} is not a running lifecycle node.")
    (state,) = agent.call("ros2_lifecycle_state", node_names=[robot.name("tuned")])["nodes"]
    assert state["error"].startswith(f"{robot.name('tuned')} is not a running lifecycle node.")
