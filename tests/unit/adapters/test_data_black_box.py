"""The wire format of both generations of the Data Black Box."""

from __future__ import annotations

import base64
from types import SimpleNamespace

import pytest

from ros2_mcp.adapters.data_black_box import (
    Question,
    full_date_time,
    read_second,
    requests,
    split_payload,
    time_range,
    unix_ns,
)
from ros2_mcp.model.errors import BadData

NEW_YEAR_NS = 1_767_225_600 * 10**9


def second(*messages: str, moments: int) -> SimpleNamespace:
    times = [SimpleNamespace(**full_date_time(NEW_YEAR_NS + i)) for i in range(moments)]
    return SimpleNamespace(message_type="std_msgs/Bool", messages=messages, timestamps=times)


@pytest.mark.parametrize("at_ns", [0, 1, -1, NEW_YEAR_NS + 999_999_999, 253_402_300_799 * 10**9])
def test_a_moment_survives_the_way_to_the_box_and_back(at_ns: int) -> None:
    assert unix_ns(SimpleNamespace(**full_date_time(at_ns))) == at_ns


def test_a_moment_of_zeros_is_unknown() -> None:
    parts = ("year", "month", "day", "hour", "minute", "second", "nanosecond")
    assert unix_ns(SimpleNamespace(**dict.fromkeys(parts, 0))) == 0


def test_an_open_end_is_filled_in_and_no_end_is_everything() -> None:
    assert time_range(Question("/a")) == ({}, {})
    start, end = time_range(Question("/a", start_ns=NEW_YEAR_NS))
    assert start["year"] == 2026 and end["year"] >= 2026 and end["month"]
    start, end = time_range(Question("/a", end_ns=NEW_YEAR_NS))
    assert (start["year"], end["year"]) == (1970, 2026)


def test_the_first_generation_gets_no_leading_slash_and_its_own_names_of_types() -> None:
    assert [each["topic_name"] for each in requests(Question("/a/b"), 1)] == ["a/b"]
    assert [each["message_type"] for each in requests(Question("/a", "std_msgs/msg/Int32"), 1)] == [
        "std_msgs/Int32",
        "any",
    ]
    assert [each["message_type"] for each in requests(Question("/a", "std_msgs/msg/Bool"), 1)] == ["any"]


@pytest.mark.parametrize("cut", [1, 3, 4, 6])
def test_a_payload_that_breaks_off_gives_its_whole_messages(cut: int) -> None:
    whole = b"\0\0\0\x03abc" + b"\0\0\0\0" + b"\0\0\0\x02de"
    assert split_payload(whole) == ([b"abc", b"", b"de"], "")
    bodies, problem = split_payload(whole[:-cut])
    assert bodies == [b"abc", b""] and (problem == "") == (cut == 6)


def test_messages_are_sorted_by_time_and_a_missing_time_is_told() -> None:
    texts = [base64.b64encode(body).decode() for body in (b"one", b"two")]
    answered = read_second(second(*texts, moments=2))
    assert answered.type == "std_msgs/msg/Bool"
    assert [(each.received_ns, each.data) for each in answered.samples] == [
        (NEW_YEAR_NS, b"one"),
        (NEW_YEAR_NS + 1, b"two"),
    ]
    short = read_second(second(*texts, moments=1))
    assert len(short.samples) == 2 and "1 times for 2 messages" in short.problem


def test_what_is_not_base64_is_refused() -> None:
    with pytest.raises(BadData, match="not base64"):
        read_second(second("§§", moments=1))
