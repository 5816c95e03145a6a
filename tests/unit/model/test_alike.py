"""What differs in a list of objects is found by its path, and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ros2_mcp.model.alike import differences

TRANSFORMS = [{"transforms": [{"id": "a", "x": number}, {"id": "b", "x": 0}]} for number in range(9)]


def test_what_differs_is_named_by_its_path() -> None:
    assert differences(TRANSFORMS) == [("transforms[0].x", list(range(9)))]
    assert differences([{"ranges": [number] * 3, "angle": 1.5} for number in range(2)]) == [
        ("ranges", [[0, 0, 0], [1, 1, 1]])
    ]


def test_nothing_differs_in_equal_objects() -> None:
    assert differences([{"a": [], "b": {"c": 1.5}}] * 3) == []


def test_zero_differs_from_minus_zero_and_from_false() -> None:
    assert differences([{"x": 0}, {"x": -0.0}, {"x": False}]) == [("x", [0, -0.0, False])]


@pytest.mark.parametrize("elements", [[], ["a", "a"], [{"a": 1}, {"b": 2}], [{"a": 1}, 5]])
def test_what_are_no_objects_or_altogether_different_ones_has_no_paths(elements: list[Any]) -> None:
    assert differences(elements) is None


def test_paths_that_could_mean_two_things_are_not_written() -> None:
    assert differences([{"a": {"b": number}, "a.b": -number} for number in range(9)]) is None
    found = differences([{"v": {"a": {"b": number}, "a.b": -number}} for number in range(2)])
    assert found == [("v", [{"a": {"b": 0}, "a.b": 0}, {"a": {"b": 1}, "a.b": -1}])]


def test_numbers_of_numpy_are_compared_with_lists_and_with_nothing() -> None:
    values = [{"always": np.float64(0.0), "now": each} for each in ([], np.float64(1.0), None, [], np.float64(1.0))]
    found = differences(values)
    assert found and [path for path, _ in found] == ["now"]
