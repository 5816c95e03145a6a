"""What a robot tells of itself in one value: by the name that the type has for it, and faults as such."""

from __future__ import annotations

import pytest

from ros2_mcp.ops.space.states import states_of
from ros2_mcp.values.definitions import DefinitionText
from support.made_windows import CODEC, Make, Recorded

MODE = "robot_msgs/msg/SafetyMode"
MANY = "robot_msgs/msg/ManyThings"


async def test_a_number_is_told_by_the_name_of_its_constant_and_that_of_a_stop_is_a_fault(window: Make) -> None:
    texts = {
        MODE: "uint8 NORMAL=1\nuint8 PROTECTIVE_STOP=3\nuint8 mode\n",
        MANY: "std_msgs/Header header\nbool stop\nuint8 mode\n",
    }
    CODEC.definitions.add({name: DefinitionText("msg", text) for name, text in texts.items()})
    made = [
        window("/safety_mode", MODE, [(1.0, {"mode": 3})]),
        window("/tool_mode", MODE, [(1.0, {"mode": 7})]),
        window("/arm_mode", MODE, [(1.0, {"mode": 1})]),
        window("/many", MANY, [(1.0, {"stop": True})]),
        window("/scaling", "std_msgs/msg/Float64", [(1.0, {"data": 0.12345})]),
        window("/is_on", "std_msgs/msg/Bool", [(1.0, {"data": False})]),
        window("/said", "std_msgs/msg/String", [(1.0, {"data": "ERROR " * 20})]),
        window("/silent", "std_msgs/msg/Bool", []),
    ]
    values, faults = await states_of(Recorded(made), {one.topic: one.type for one in made})
    assert values == {
        "/safety_mode": "PROTECTIVE_STOP",
        "/tool_mode": "7",
        "/arm_mode": "NORMAL",
        "/scaling": "0.123",
        "/is_on": "false",
        "/said": "«ERROR ERROR ERROR ERROR ERROR…»",
    }
    assert faults == ["/safety_mode is PROTECTIVE_STOP."], "what a robot says in words is no name of its makers"


@pytest.mark.parametrize(
    ("constant", "is_fault"),
    [
        ("PROTECTIVE_STOP", True),
        ("ROBOT_EMERGENCY_STOP", True),
        ("STATE_ESTOPPED", True),
        ("MOTOR_FAULT", True),
        ("NO_ERROR", False),
        ("FAULT_NONE", False),
        ("STATE_NOT_ESTOPPED", False),
        ("ESTOP_RELEASED", False),
        ("STOPPED", False),
        ("TERROR", False),
    ],
)
async def test_a_robot_that_stands_or_has_no_fault_has_none(window: Make, constant: str, is_fault: bool) -> None:
    kind = f"robot_msgs/msg/Of{constant.title().replace('_', '')}"
    CODEC.definitions.add({kind: DefinitionText("msg", f"uint8 {constant}=1\nuint8 state\n")})
    values, faults = await states_of(Recorded([window("/state", kind, [(1.0, {"state": 1})])]), {"/state": kind})
    assert (values, bool(faults)) == ({"/state": constant}, is_fault)
