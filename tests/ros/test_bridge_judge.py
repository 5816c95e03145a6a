"""Hostile velocity commands before the one function that judges them: what it lets through is finite and whole."""

from __future__ import annotations

import math
import random
import struct

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels")

from rclpy.serialization import deserialize_message, serialize_message

from ros2_mcp_bridge.exit.velocities import judged
from ros2_mcp_bridge.request import OperationError
from ros2_mcp_bridge.ros import interfaces
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES
from support.velocities import cdr

COUNT = 10_000
OF_EACH_TYPE = sorted(kind for kind in VELOCITY_TYPES if kind.startswith("geometry_msgs"))
"""ackermann_msgs is not installed where tests run; over DDS it is tested with the others."""
NUMBERS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, 1.7e308, -1.7e308, 0.5)


def hostile(kind: str, dice: random.Random) -> bytes:
    """A command with a number that is odd, or bytes that are."""
    stamp = dice.randrange(-(2**31), 2**31), dice.randrange(2**32)
    good = cdr(kind, dice.choice(NUMBERS), stamp=stamp, frame="b" * dice.randrange(5))
    way = dice.randrange(6)
    if way == 0:  # any bits anywhere
        at = dice.randrange(len(good))
        return good[:at] + dice.randbytes(1) + good[at + 1 :]
    if way == 1:
        return good[: dice.randrange(len(good))]
    if way == 2:
        return good + dice.randbytes(dice.randrange(1, 40))
    if way == 3:
        return dice.randbytes(dice.randrange(200))
    if way == 4:  # another number
        at = len(good) - 8 * dice.randrange(1, 7)
        return good[:at] + struct.pack("<d", dice.choice(NUMBERS)) + good[at + 8 :]
    return b"\0" + bytes([dice.randrange(12)]) + good[2:]  # another byte order or encoding


@pytest.mark.parametrize("kind", OF_EACH_TYPE)
def test_what_is_judged_to_be_a_command_is_finite_and_carries_nothing_else(kind: str) -> None:
    dice, interface = random.Random(kind), interfaces.load(kind)
    judged_count = {"passed": 0, "refused": 0}
    for _ in range(COUNT):
        try:
            message = judged(hostile(kind, dice), interface, kind)
        except OperationError as refused:
            assert refused.kind == "bad_request"
            judged_count["refused"] += 1
            continue
        judged_count["passed"] += 1
        sent = serialize_message(message)
        arrived = deserialize_message(sent, interface)
        assert all(map(math.isfinite, struct.unpack("<6d", sent[-48:])))
        frame_id = arrived.header.frame_id if VELOCITY_TYPES[kind] else ""
        assert len(sent) <= 4 + 8 + 4 + len(frame_id.encode()) + 1 + 7 + 6 * 8
    assert min(judged_count.values()) > COUNT / 10


@pytest.mark.parametrize(
    "alias",
    ["geometry_msgs.msg/_twist/Twist", "geometry_msgs/msg/Twist ", "geometry_msgs/msg/Twist\n", "geometry_msgs//Twist"],
)
def test_a_type_has_one_name(alias: str) -> None:
    with pytest.raises(OperationError) as refused:
        interfaces.load(alias)
    assert refused.value.kind == "unknown_type"
