"""Names and values of a robot in few characters: shorter, and still to be read in one way alone."""

from __future__ import annotations

import pytest

from ros2_mcp.ops.space.style import Named, Names, Style, braced, factors, same_or_each


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["/sonar/left", "/sonar/right"], "/sonar/{left,right}"),
        (["/a/left", "/a/light"], "/a/{left,light}"),
        (["LKneePitch", "RKneePitch"], "{L,R}KneePitch"),
        (["CameraBottom_frame", "CameraTop_frame"], "Camera{Bottom,Top}_frame"),
        (["joint_1", "joint_2", "joint_13"], "joint_{1,2,13}"),
        (["imu_0/data", "imu_0/data_raw"], "imu_0/{data,data_raw}"),
        (["fl.hx", "fr.hx"], "{fl,fr}.hx"),
        (["/cmd_vel", "/joy/cmd_vel"], "/cmd_vel, /joy/cmd_vel"),
        (["/bumper", "/touch"], "/bumper, /touch"),
        (["a{b", "a{c"], "a{b, a{c"),
        (["imu", "imu"], "imu, imu"),
        (["/arm_1/go", "/my_arm_1/go"], "/{arm,my_arm}_1/go"),
        (["joint_controller/go", "scaled_joint_controller/go"], "{joint,scaled_joint}_controller/go"),
        (["cmd_vel", "joy/cmd_vel", "nav/cmd_vel"], "cmd_vel, joy/cmd_vel, nav/cmd_vel"),
        (["imu"], "imu"),
    ],
)
def test_what_differs_stands_in_braces_where_words_end_and_nowhere_else(names: list[str], told: str) -> None:
    assert braced(names) == told


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (["10", "10", "10"], "10"),
        (["15", "10"], "15, 10"),
        (["0 0.2 1 yaw 22°", "0 -0.2 1 yaw -22°"], "0 ±0.2 1 yaw ±22°"),
        (["0 -0.2 1", "0 0.2 1"], "0 ∓0.2 1"),
        (["0 0.2 1", "0 -0.3 1"], "0 0.2 1, 0 -0.3 1"),
        (["0 0.2 1", "0 -0.2 1 yaw 180°"], "0 0.2 1, 0 -0.2 1 yaw 180°"),
        (["0.1", "-0.1"], "0.1, -0.1"),
    ],
)
def test_what_all_have_is_told_once_and_what_is_mirrored_with_its_signs(values: list[str], told: str) -> None:
    assert same_or_each(values) == told


def test_names_of_one_type_stand_together_and_how_many_more_there_are_is_told() -> None:
    types = {"/r/battery_state": "BatteryState", "/r/a": "Bool", "/r/x": "Odd", "/r/b": "Bool"}
    found = Names("told", [Named(name, kind) for name, kind in types.items()], 3)
    assert found.in_words(Style()) == ["told: /r/battery_state BatteryState; /r/a Bool; /r/x Odd; /r/b Bool; 3 more"]
    brief = Style(is_brief=True, namespace="/r")
    assert found.in_words(brief) == ["told: battery_state; a, b Bool; x Odd; 3 more"]
    assert found.in_words(Style(is_brief=True, has_types=False)) == ["told: /r/{battery_state,a,x,b}; 3 more"]
    assert Names("services", more=12).in_words(brief) == ["services: 12"]
    assert Names("told").in_words(brief) == []


def test_values_of_topics_below_one_name_stand_with_it() -> None:
    values = {"/status/estop": "false", "/status/wifi": "true", "/odom": "20 Hz", "/status/leases": "false"}
    found = Names("told", [Named(name, "Bool", value) for name, value in values.items()])
    told = "/status/{estop,leases} false; /status/wifi true; /odom 20 Hz"
    assert found.in_words(Style(is_brief=True, has_types=False)) == [f"told: {told}"]


def test_combinations_of_two_choices_have_two_pairs_of_braces() -> None:
    names = [f"/{kind}/{side}/image" for kind in ("camera", "depth") for side in ("back", "left", "right")]
    assert braced(names) == "/{camera,depth}/{back,left,right}/image"
    assert factors(names[:-1]) == [] == factors(names[::-1][1:]) == factors(["/a", "/b/c"])


def test_a_name_that_somebody_has_made_to_be_long_is_cut_where_nothing_else_helps() -> None:
    assert Style(is_brief=True).name("/x" * 100) == "/x" * 100
    assert Style(most_name=6).name("/x" * 100) == "«/x/x/x…»"
