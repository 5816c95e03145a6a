"""Finding the first message that meets a condition, in a source that is no robot."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ros2_mcp.model.errors import BadInput
from ros2_mcp.ops.measure.wait_until import wait_until
from ros2_mcp.values.columns import ExcerptReader
from support.made_windows import START_NS, Make, Recorded

FLOAT = "std_msgs/msg/Float64"


def ramp(window: Make) -> Recorded:
    return Recorded([window("/x", FLOAT, [(i / 1000, {"data": float(i)}) for i in range(1000)])])


@pytest.mark.promise("ros2_wait_until", "Wait until a message of a topic meets a condition")
@pytest.mark.promise("ros2_wait_until", "In a recording, returns the first that met it")
async def test_the_first_message_that_meets_the_condition_is_returned(window: Make) -> None:
    found = await wait_until(ramp(window), "/x", "data > 400")
    assert (found.met, found.messages_checked, found.message, dict(found.values)) == (
        True,
        402,
        {"data": 401.0},
        {"data": 401.0},
    )
    assert found.at == "2023-11-14T22:13:20.401000Z"
    assert "is met" in found.summary()


async def test_the_last_seen_is_returned_if_none_meets_it(window: Make) -> None:
    found = await wait_until(ramp(window), "/x", "data < 0")
    assert (found.met, found.messages_checked, found.message) == (False, 1000, {"data": 999.0})
    assert "was not met" in found.summary()


@pytest.mark.parametrize(
    ("type_name", "condition", "reads_excerpts"),
    [
        ("nav_msgs/msg/Odometry", "pose.pose.position.x > 6 and twist.twist.angular.z <= 1", True),
        ("nav_msgs/msg/Odometry", "1 / (pose.pose.position.x - 3) > 0.9", True),
        ("nav_msgs/msg/Odometry", "hypot(pose.pose.position.x, pose.pose.position.y) > 9", False),
        ("nav_msgs/msg/Odometry", "pose.covariance[7] > 8.5", False),
        ("nav_msgs/msg/Odometry", "header.frame_id == 'f9'", False),
        ("odd_msgs/msg/State", "state == BUSY and on", True),
        ("odd_msgs/msg/State", "1 < 2", False),
    ],
)
async def test_what_is_told_is_the_same_whether_messages_are_decoded_or_read_in_part(
    window: Make, monkeypatch: pytest.MonkeyPatch, type_name: str, condition: str, reads_excerpts: bool
) -> None:
    if type_name.endswith("State"):
        values = [{"state": number % 4, "on": number > 9} for number in range(20)]
    else:
        values = [
            {
                "header": {"frame_id": f"f{number}"},
                "pose": {"pose": {"position": {"x": number, "y": -number}}, "covariance": [number] * 36},
            }
            for number in range(12)
        ]

    def source() -> Recorded:
        return Recorded([window("/t", type_name, [(at / 10, value) for at, value in enumerate(values)])])

    read: list[bool] = []
    real = ExcerptReader.read
    monkeypatch.setattr(ExcerptReader, "read", lambda *given: read.append(True) or real(*given))
    in_part = await wait_until(source(), "/t", condition)
    assert bool(read) is reads_excerpts
    monkeypatch.setattr(ExcerptReader, "read", lambda *_: None)
    whole = await wait_until(source(), "/t", condition)
    assert in_part.met
    assert replace(in_part, waited=0.0) == replace(whole, waited=0.0)


async def test_silence_says_so(window: Make) -> None:
    found = await wait_until(Recorded([window("/x", FLOAT, [])]), "/x", "data < 0")
    assert (found.met, found.message, found.note) == (False, None, "No message came.")


async def test_messages_without_an_answer_are_counted(window: Make) -> None:
    found = await wait_until(ramp(window), "/x", "1 / data > 0.9")
    assert (found.met, found.messages_checked, found.not_evaluable) == (True, 2, 1)


async def test_why_a_message_has_no_answer_is_told_with_the_indices_that_there_are(window: Make) -> None:
    scans = [(i / 10, {"ranges": [1.0, 2.0, 3.0]}) for i in range(4)]
    source = Recorded([window("/scan", "sensor_msgs/msg/LaserScan", scans)])
    found = await wait_until(source, "/scan", "ranges[5] < 1.0")
    assert (found.met, found.not_evaluable) == (False, 4)
    said = "4 of 4 messages could not be checked: ranges[5]: there is no element [5], only [0] to [2]."
    assert found.note == said
    empty = Recorded([window("/scan", "sensor_msgs/msg/LaserScan", [(0.0, {})])])
    assert (await wait_until(empty, "/scan", "ranges[0] < 1.0")).note.endswith("there is no element [0], it is empty.")
    assert (await wait_until(empty, "/scan", "min(ranges) < 1.0")).note.endswith(
        "the list is empty, or all in it are NaN."
    )
    assert (await wait_until(empty, "/scan", "1 / angle_min < 1.0")).note.endswith("division by zero.")


async def test_an_index_that_no_message_can_have_is_refused_before_waiting(window: Make) -> None:
    odometry = Recorded([window("/odom", "nav_msgs/msg/Odometry", [(0.0, {})])])
    with pytest.raises(BadInput, match=r"there is no element \[36\], only \[0\] to \[35\]\."):
        await wait_until(odometry, "/odom", "pose.covariance[36] > 1")


async def test_a_time_in_a_recording_also_counts_from_its_beginning(window: Make) -> None:
    source = ramp(window)
    source.began_ns = START_NS - 2_000_000_000
    found = await wait_until(source, "/x", "data > 400")
    assert found.seconds_from_start == 2.401
    assert "is met in made, at 2023-11-14T22:13:20.401000Z (2.401 s in) (data = 401)." in found.summary()
    assert (
        "last message at 2023-11-14T22:13:20.999000Z (2.999 s in)"
        in (await wait_until(source, "/x", "data < 0")).summary()
    )


async def test_a_bad_condition_is_refused_before_waiting(window: Make) -> None:
    with pytest.raises(BadInput, match="dat"):
        await wait_until(ramp(window), "/x", "dat > 1")


async def test_what_a_condition_computes_is_told_instead_of_the_list(window: Make) -> None:
    scans = [(0.0, {"ranges": [1.5, 3.0, 2.0], "range_max": 5.0})]
    source = Recorded([window("/scan", "sensor_msgs/msg/LaserScan", scans)])
    found = await wait_until(source, "/scan", "min(ranges) < 1.0 and abs(range_max) > 4 or len(ranges) == 2")
    assert found.values == {"min(ranges)": 1.5, "abs(range_max)": 5, "range_max": 5, "len(ranges)": 3}
    assert "(range_max = 5, min(ranges) = 1.5, abs(range_max) = 5, len(ranges) = 3)" in found.summary()
    assert (await wait_until(source, "/scan", "min(ranges[5:]) < 1")).values == {"min(ranges[5:])": None}
