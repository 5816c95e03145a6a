"""What a program gives is copied with a count of its parts before anything walks through it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ros2_mcp.model.errors import BadInput
from ros2_mcp.programs.crossing import MOST_NUMBERS, MOST_PARTS, crossed


def test_small_lists_that_share_their_parts_are_refused_and_not_walked_through() -> None:
    value: Any = ["x"]
    for _ in range(30):
        value = [value, value]
    with pytest.raises(BadInput, match=f"more than {MOST_PARTS} parts"):
        crossed(value, "It", for_json=True)


def test_what_is_in_itself_is_refused() -> None:
    value: list[Any] = []
    value.append(value)
    with pytest.raises(BadInput, match="nested"):
        crossed(value, "It")


def test_what_json_has_no_word_for_becomes_text() -> None:
    given = {1: (math.inf, math.nan), "a": {2}, "b": b"x", "c": 2**80, "d": "\ud800"}
    assert crossed(given, "It", for_json=True) == {
        "1": ["inf", "nan"],
        "a": [2],
        "b": "<bytes>",
        "c": str(2**80),
        "d": "?",
    }


def test_a_number_of_thousands_of_digits_is_refused() -> None:
    with pytest.raises(BadInput, match="digits"):
        crossed([7**1000], "It", for_json=True)


def test_a_long_list_of_numbers_is_copied_as_a_whole() -> None:
    cells = [number % 101 - 1 for number in range(10 * MOST_PARTS)]
    copied = crossed({"data": cells}, "It")
    assert copied == {"data": cells} and copied["data"] is not cells
    with pytest.raises(BadInput, match=f"more than {MOST_NUMBERS} numbers"):
        crossed([cells, cells, cells], "It")


@pytest.mark.parametrize(
    ("odd", "shown"), [(True, True), (None, None), ("x", "x"), (2**60, str(2**60)), (math.nan, "nan")]
)
def test_one_odd_value_in_a_long_list_is_not_overlooked(odd: Any, shown: Any) -> None:
    [*numbers, last] = crossed([*range(1000), odd], "It", for_json=True)
    assert numbers == list(range(1000))
    assert last == shown


def test_a_huge_number_in_a_long_list_is_refused() -> None:
    with pytest.raises(BadInput, match="digits"):
        crossed([*range(1000), 7**1000], "It")
