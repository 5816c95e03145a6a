from __future__ import annotations

import pytest

from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.goals import cancel_request, goal_id_bytes, goal_id_hex, new_goal_id, stamp_seconds


def test_a_goal_id_is_32_hexadecimal_digits_and_16_bytes() -> None:
    goal_id = new_goal_id()
    assert len(goal_id) == 32
    assert goal_id_hex(goal_id_bytes(goal_id)) == goal_id
    assert goal_id != new_goal_id()


@pytest.mark.parametrize("given", ["00010203-0405-0607-0809-0a0b0c0d0e0f", "000102030405060708090A0B0C0D0E0F"])
def test_a_goal_id_is_taken_in_every_usual_spelling(given: str) -> None:
    assert goal_id_bytes(given) == list(range(16))


@pytest.mark.parametrize("given", ["", "12", "x" * 32, "0" * 31, "0" * 33])
def test_what_is_no_goal_id_is_refused(given: str) -> None:
    with pytest.raises(BadValue, match=r"goal_id_hex: .* is not a goal id") as caught:
        goal_id_bytes(given)
    assert caught.value.path == "goal_id_hex"


def test_zeros_are_no_goal_id_since_they_would_stand_for_every_goal() -> None:
    with pytest.raises(BadValue, match="every goal"):
        goal_id_bytes("0" * 32)
    with pytest.raises(BadValue, match="every goal"):
        cancel_request("0" * 32)


def test_only_a_request_without_a_goal_id_cancels_every_goal() -> None:
    everything = cancel_request()["goal_info"]
    assert everything == {"goal_id": {"uuid": [0] * 16}, "stamp": {"sec": 0, "nanosec": 0}}
    one = cancel_request("ff" * 16, {"sec": 3, "nanosec": 4})["goal_info"]
    assert one == {"goal_id": {"uuid": [255] * 16}, "stamp": {"sec": 3, "nanosec": 4}}


def test_a_stamp_is_seconds() -> None:
    assert stamp_seconds({"sec": 2, "nanosec": 500_000_000}) == 2.5
