"""The one rule for numbers that are not finite: they are named."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_mcp_common.finite import in_words, not_finite
from support.made_windows import decoded


def test_the_first_number_that_is_not_finite_is_named() -> None:
    odometry = decoded("nav_msgs/msg/Odometry", {"pose": {"pose": {"orientation": {"z": math.nan, "w": -math.inf}}}})
    assert not_finite(odometry, "pose.pose.position") == ""
    assert not_finite(odometry, "pose.pose") == "pose.pose.orientation.z is NaN"
    assert not_finite(odometry.pose.pose, "orientation.w", within="pose.pose") == (
        "pose.pose.orientation.w is negative infinite"
    )


@pytest.mark.parametrize("numbers", [[1.0, math.inf], np.array([1.0, np.inf], np.float32), (1, math.inf)])
def test_every_number_of_a_list_counts(numbers: object) -> None:
    assert not_finite(SimpleNamespace(k=numbers), "k") == "k[1] is infinite"


def test_texts_and_whole_numbers_are_finite() -> None:
    assert (
        not_finite(SimpleNamespace(name="nan", count=3, flag=True, names=["inf"]), "name", "count", "flag", "names")
        == ""
    )


def test_a_number_in_a_sentence_is_unknown_where_it_is_none() -> None:
    assert (in_words(0.25, ".1f"), in_words(math.nan), in_words(math.inf)) == (
        "0.2",
        "unknown (NaN)",
        "unknown (infinite)",
    )
