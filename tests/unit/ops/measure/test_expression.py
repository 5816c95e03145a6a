"""Conditions: what they mean, what is refused, and that nothing gets past the grammar."""

from __future__ import annotations

import math
import random
import string
import time

import pytest

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.ops.measure.expression import condition
from ros2_mcp.values.definitions import Definitions
from support.made_windows import decoded

ODOMETRY = "nav_msgs/msg/Odometry"
JOINTS = "sensor_msgs/msg/JointState"
STATE = "odd_msgs/msg/State"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

POSE = {
    "pose": {"pose": {"position": {"x": 1.5, "y": -2.0}}},
    "twist": {"twist": {"linear": {"x": 0.0}}},
    "child_frame_id": "base_link",
}
SICK = {
    "status": [
        {"name": "x", "level": 1},
        {"name": "battery", "level": 2, "values": [{"key": "volts", "value": "11.1"}]},
    ]
}
ARM = {"name": ["shoulder", "elbow"], "position": [0.5, -1.25], "velocity": [float("nan"), 3.0]}


@pytest.mark.parametrize("degrees", [-170, -90, 0, 30, 179])
@pytest.mark.parametrize("length", [1.0, 0.5])
def test_the_heading_of_a_quaternion_is_known(definitions: Definitions, degrees: int, length: float) -> None:
    half = math.radians(degrees) / 2
    quaternion = {"z": length * math.sin(half), "w": length * math.cos(half)}
    turned = decoded(ODOMETRY, {"pose": {"pose": {"orientation": quaternion}}})
    asked = condition(definitions, ODOMETRY, "yaw(pose.pose.orientation) > 0")
    assert asked.values(turned) == {"yaw(pose.pose.orientation)": pytest.approx(math.radians(degrees))}
    assert (asked.holds(turned), list(asked.fields)) == (degrees > 0, [])


def test_a_heading_is_asked_of_a_quaternion_only(definitions: Definitions) -> None:
    zeros = decoded(ODOMETRY, {"pose": {"pose": {"orientation": dict.fromkeys("xyzw", 0.0)}}})
    assert condition(definitions, ODOMETRY, "yaw(pose.pose.orientation) > 0").holds(zeros) is None
    for other in ("pose.pose.position", "pose.pose.position.x", "pose.pose.orientation, 1"):
        with pytest.raises(BadInput, match="does not take") as refused:
            condition(definitions, ODOMETRY, f"yaw({other}) > 0")
        assert "yaw(pose.pose.orientation)" in refused.value.hint


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pose.pose.position.x > 1.0 and twist.twist.linear.x == 0", True),
        ("pose.pose.position.x > 2 or pose.pose.position.y < -1", True),
        ("not pose.pose.position.x > 1", False),
        ("1 < pose.pose.position.x <= 1.5", True),
        ("1 < pose.pose.position.x < 1.5", False),
        ("(pose.pose.position.x + pose.pose.position.y) * 2 == -1", True),
        ("abs(pose.pose.position.y) / 4 == 0.5", True),
        ("hypot(pose.pose.position.x - 1.5, pose.pose.position.y) <= 2", True),
        ("sqrt(pose.pose.position.x * 6) == 3", True),
        ("sqrt(pose.pose.position.y) == 3", None),
        ("abs(atan2(pose.pose.position.y, 0) + 1.5707963) < 1e-6", True),
        ("min(pose.pose.position.x, pose.pose.position.y, 7) == -2", True),
        ("max(pose.covariance) == 0 and len(pose.covariance) == 36", True),
        ("pose.covariance[-1] == 0", True),
        ("child_frame_id == 'base_link'", True),
        ("'link' in child_frame_id and len(child_frame_id) == 9", True),
        ("child_frame_id != \"odom\"", True),
        ("pose.pose.position.x / twist.twist.linear.x > 1", None),
        ("pose.pose.position.x == nan", False),
        ("pose.pose.position.x < inf", True),
        ("true", True),
    ],
)  # fmt: skip
def test_a_condition_means_what_it_says(definitions: Definitions, text: str, expected: bool | None) -> None:
    assert condition(definitions, ODOMETRY, text).holds(decoded(ODOMETRY, POSE)) is expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("position[1] < -1", True),
        ("position[7] < -1", None),
        ("'elbow' in name and 'wrist' not in name", True),
        ("name[0] == 'shoulder'", True),
        ("max(velocity) == 3", True),
        ("min(effort) > 0", None),
        ("len(effort) == 0 or effort[0] > 1", True),
        ("min(position[0:1]) == 0.5", True),
    ],
)
def test_lists_may_be_shorter_than_a_condition_hopes(
    definitions: Definitions, text: str, expected: bool | None
) -> None:
    assert condition(definitions, JOINTS, text).holds(decoded(JOINTS, ARM)) is expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("max(status[*].level) == 2", True),
        ("max( status[ * ].level ) == 1", False),
        ("2 in status[*].level and 'gps' not in status[*].name", True),
        ('any(status[*], name == "x" and level == 2)', False),
        ('any(status, name == "x" and level == 1)', True),
        ("any(status, name == '[*]')", False),
        ("any(status, level == ERROR)", True),
        ("all(status[0:1], level < ERROR)", True),
        ("all(status, level < ERROR)", False),
        ("all(status[7:9], level == 5) and not any(status[7:9], level == 0)", True),
        ("any(status, any(values, key == 'volts' and value == '11.1'))", True),
        ("any(status, values[0].value == '11.1')", True),  # the first has no values
        ("any(status, values[0].value == '12')", None),
        ("all(status, values[0].value == '12')", False),
        ("len(status[*].name) == 2", True),
    ],
)
def test_all_elements_of_a_list_can_be_asked(definitions: Definitions, text: str, expected: bool | None) -> None:
    assert condition(definitions, DIAGNOSTICS, text).holds(decoded(DIAGNOSTICS, SICK)) is expected


def test_the_fields_of_elements_are_known_by_their_whole_path(definitions: Definitions) -> None:
    found = condition(
        definitions, DIAGNOSTICS, 'any(status, level > 1 and any(values, key == "a")) and header.stamp.sec > 1'
    )
    assert found.fields == ["status[*].level", "status[*].values[*].key", "header.stamp.sec"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("status.level == 2", "[*]"),
        ("status[*].level == 2", "any()"),
        ("any(status)", "Give it a list of messages and a condition"),
        ("any(status, level)", "a condition is needed"),
        ("any(status, lvl == 2)", "Did you mean level?"),
        ("any(header, frame_id == '')", "Give it a list of messages"),
        ("any(status[*].level, level == 2)", "Give it a list of messages"),
        ("any(level == 2 for level in status)", "any() and all()"),
        ("all(status, level == 2, true)", "Give it a list of messages"),
        ("any()", "cannot be called"),
    ],
)
def test_what_cannot_be_asked_of_elements_says_what_can(definitions: Definitions, text: str, says: str) -> None:
    with pytest.raises(BadInput) as caught:
        condition(definitions, DIAGNOSTICS, text)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("state == BUSY", True), ("on", True), ("not on", False), ("on == 1", True), ("on + 1 == 2", True)],
)
def test_constants_and_booleans_can_be_named(definitions: Definitions, text: str, expected: bool) -> None:
    assert condition(definitions, STATE, text).holds(decoded(STATE, {"state": 3, "on": True})) is expected


def test_a_condition_knows_its_fields(definitions: Definitions) -> None:
    found = condition(definitions, ODOMETRY, "pose.pose.position.x > 1 and pose.covariance[0] < pose.pose.position.x")
    assert found.fields == ["pose.pose.position.x", "pose.covariance[0]"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("pose.pose.positon.x > 1", "Did you mean position?"),
        ("pose.pose.position > 1", "Name one of its fields"),
        ("pose.pose.position.x", "Compare it"),
        ("pose.pose.position.x + 1", "Compare it"),
        ("pose.covariance > 1", "Pick an element"),
        ("pose.covariance[0] > 'a'", "Numbers compare with numbers"),
        ("pose.pose.position.x > 1 && pose.pose.position.y > 1", "Write and, or, not."),
        ("pose.pose.position.x = 1", "Write =="),
        ("child_frame_id + 1 == 2", "but a number is needed"),
        ("'a' * 999999999 == 'b'", "but a number is needed"),
        ("2 ** 999999999 > 1", "cannot be used"),
        ("pose.pose.position.x % 2 == 1", "cannot be used"),
        ("1 << 99 > 1", "cannot be used"),
        ("__import__('os').system('true') == 0", "cannot be called"),
        ("().__class__ == 1", "is not a field"),
        ("child_frame_id.upper() == 'X'", "cannot be called"),
        ("pose.__class__ == 1", "is not a field"),
        ("[x for x in pose.covariance] == 1", "cannot be used"),
        ("(lambda: 1)() == 1", "cannot be called"),
        ("f'{child_frame_id}' == 'x'", "cannot be used"),
        ("(x := 1) == 1", "cannot be used"),
        ("abs(pose.covariance) > 1", "Give it one number"),
        ("len(1) > 1", "Give it one list"),
        ("max() > 1", "cannot be called"),
        ("9" * 30 + " > 1", "cannot be used"),
        ("1 > 2" * 300, "At most 1000"),
        ("(" * 300 + "1" + ")" * 300, "cannot be read"),
        ("-" * 300 + "1 > 1", "nested too deeply"),
        ("not " * 100 + "true", "nested too deeply"),
        ("a" + ".a" * 400 + " > 1", "nested too deeply"),
        ("pose.pose.position.x > 1\0", "cannot be read"),
        ("pose.pose.position.x is 1", "cannot be compared"),
    ],
)  # fmt: skip
def test_what_is_no_condition_is_refused_with_what_would_be_right(
    definitions: Definitions, text: str, says: str
) -> None:
    with pytest.raises(BadInput) as caught:
        condition(definitions, ODOMETRY, text)
    assert says in str(caught.value)


_TOKENS = r"""
pose.pose.position.x pose pose.covariance pose.covariance[3] child_frame_id header.stamp.sec x 1 0 -7 1e308
18446744073709551615 'text' true nan inf None ... 1j b'x' f'{x}' and or not in is if else lambda for await yield := * **
/ // + - < <= == != > @ % ~ ^ | & ( ) [ ] , : . { } abs( min( max( len( hypot( sqrt( atan2( yaw( any( all(
[*] eval( __class__ .__init__ # é \
"""
WORDS = [*_TOKENS.split(), "\n", "\t", "\0", "\ud800"]


def test_no_input_hangs_or_raises_anything_else(definitions: Definitions) -> None:
    message = decoded(ODOMETRY, POSE)
    choose = random.Random(11)
    understood, slowest = 0, 0.0
    for number in range(20_000):
        if number % 4:
            text = " ".join(choose.choice(WORDS) for _ in range(choose.randint(1, 12)))
        else:
            text = "".join(choose.choice(string.printable) for _ in range(choose.randint(1, 60)))
        started = time.thread_time()  # a machine that stalls is no slow condition
        try:
            answer = condition(definitions, ODOMETRY, text).holds(message)
            assert answer in (True, False, None)
            understood += 1
        except (BadInput, BadValue):
            pass
        slowest = max(slowest, time.thread_time() - started)
    assert understood > 20
    assert slowest < 1.0


def test_every_sensible_combination_is_understood(definitions: Definitions) -> None:
    """Grammatical conditions of random shape: all are accepted, and agree with Python's own arithmetic."""
    choose = random.Random(12)
    values = {"pose.pose.position.x": 1.5, "pose.pose.position.y": -2.0, "twist.twist.linear.x": 0.0}
    message = decoded(ODOMETRY, POSE)

    def number(depth: int) -> str:
        if depth == 0 or choose.random() < 0.3:
            return choose.choice([*values, "2", "0.5", "10"])
        if choose.random() < 0.2:
            return f"abs({number(depth - 1)})"
        return f"({number(depth - 1)} {choose.choice('+-*')} {number(depth - 1)})"

    def truth(depth: int) -> str:
        if depth == 0 or choose.random() < 0.3:
            return f"{number(2)} {choose.choice(['<', '<=', '>', '>=', '==', '!='])} {number(2)}"
        if choose.random() < 0.2:
            return f"not ({truth(depth - 1)})"
        return f"({truth(depth - 1)}) {choose.choice(['and', 'or'])} ({truth(depth - 1)})"

    for _ in range(500):
        text = truth(3)
        plain = text
        for path, value in values.items():
            plain = plain.replace(path, f"({value})")
        assert condition(definitions, ODOMETRY, text).holds(message) is eval(plain), text
