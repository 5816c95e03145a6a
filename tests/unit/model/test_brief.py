"""Lists of like objects in short say all that the whole lists say."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

from ros2_mcp.model.brief import MAX_COLUMNS, brief


def put(message: Any, path: str, value: Any) -> None:
    *way, last = [int(part) if part.isdigit() else part for part in re.findall(r"[^.\[\]]+", path)]
    for part in way:
        message = message[part]
    message[last] = value


def restored(short: dict[str, Any]) -> list[Any]:
    """What a reader makes of it, by the words that explain it."""
    changes = short.get("changes") or [
        dict(zip(short.get("columns", ()), row, strict=True)) for row in short.get("rows", ())
    ]
    found = [short["first"]]
    for changed in [*changes, *[{}] * short.get("same", 0)]:
        message = json.loads(json.dumps(short["first"]))
        for path, value in changed.items():
            put(message, path, value)
        found.append(message)
    return found


def odometry(number: int) -> dict[str, Any]:
    return {
        "header": {"stamp": {"sec": 7, "nanosec": number}, "frame_id": "odom"},
        "pose": {"x": number / 3, "covariance": [0.5] * 9},
        "twist": {"linear": {"x": 0 if number else -0.0}, "name": ["a", "b"][: number % 3]},
    }


TRANSFORMS = [{"transforms": [{"id": "a", "x": number}, {"id": "b", "x": 0}]} for number in range(9)]


@pytest.mark.parametrize(
    ("elements", "form"),
    [
        ([odometry(number) for number in range(10)], "rows"),
        (TRANSFORMS, "rows"),
        ([{"ranges": [number] * 40, "angle": 1.5, "time": 0.1} for number in range(5)], "rows"),
        ([{f"joint_{joint}": number * (joint < 20) for joint in range(40)} for number in range(3)], "changes"),
        ([odometry(4)] * 6, "same"),
    ],
)
def test_what_is_the_same_is_said_once_and_nothing_is_lost(elements: list[Any], form: str) -> None:
    short = brief(elements)
    assert short and form in short
    assert json.dumps(restored(short)) == json.dumps(elements)
    assert len(json.dumps(short)) < len(json.dumps(elements))


def test_columns_are_the_paths_that_change() -> None:
    short = brief(TRANSFORMS)
    assert short and (short["columns"], short["rows"][1]) == (["transforms[0].x"], [2])


def test_wide_rows_have_the_path_beside_each_value() -> None:
    elements = [{f"joint_{joint}": number for joint in range(MAX_COLUMNS + 1)} for number in range(3)]
    assert brief([{**element, "same": "x" * 200} for element in elements])["changes"][0]["joint_3"] == 1  # type: ignore[index]


@pytest.mark.parametrize(
    "elements",
    [[], [odometry(1)], ["a", "a"], [{"a": 1}, {"b": 2}], [{"a": 1}, {"a": 2}], [{"a": 1}, 5], [{}, {}]],
)
def test_lists_that_would_not_become_shorter_stay_as_they_are(elements: list[Any]) -> None:
    assert brief(elements) is None


def test_paths_that_could_mean_two_things_are_not_written() -> None:
    same = {"long": "x" * 200}
    assert brief([{"a": {"b": number}, "a.b": -number, **same} for number in range(9)]) is None
    found = brief([{"v": {"a": {"b": number}, "a.b": -number}, **same} for number in range(9)])
    assert found and found["columns"] == ["v"] and found["rows"][0] == [{"a": {"b": 1}, "a.b": -1}]


def test_numbers_of_numpy_are_compared_with_lists_and_with_nothing() -> None:
    values = [{"always": np.float64(0.0), "now": each} for each in ([], np.float64(1.0), None, [], np.float64(1.0))]
    short = brief(values)
    assert short and short["columns"] == ["now"]
