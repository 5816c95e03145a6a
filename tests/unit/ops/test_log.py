"""Which lines of the log are meant."""

from __future__ import annotations

import pytest

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.ops import log

NOW = 1_900_000_000_000_000_000


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("", 0),
        ("30", NOW - 30_000_000_000),
        ("0.5", NOW - 500_000_000),
        ("2030-01-31T12:00:00Z", 1_896_091_200_000_000_000),
        ("2030-01-31T12:00:00", 1_896_091_200_000_000_000),
        ("2030-01-31T13:00:00.250000+01:00", 1_896_091_200_250_000_000),
    ],
)
def test_a_time_is_seconds_ago_or_iso(given, expected) -> None:
    assert log.since(given, NOW) == expected


@pytest.mark.parametrize("given", ["yesterday", "-3", "nan", "inf"])
def test_a_time_that_is_none_is_refused(given) -> None:
    with pytest.raises(BadValue, match="since"):
        log.since(given, NOW)


@pytest.mark.parametrize(("name", "number"), [("", 0), ("warn", 30), ("WARNING", 30), (" Error ", 40)])
def test_levels_have_names(name, number) -> None:
    assert log.level_number(name) == number


def test_an_unknown_level_is_refused_with_the_nearest() -> None:
    with pytest.raises(BadInput, match="Did you mean debug"):
        log.level_number("debgu")


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        ("", True),
        ("/arm/driver", True),
        ("/driver", False),
        ("driver", True),
        ("/arm", True),
        ("/ar", False),
        ("arm.*", True),
        ("/arm/*", True),
        ("other", False),
    ],
)
def test_a_node_is_found_by_its_name_a_part_or_a_glob(wanted, expected) -> None:
    assert log.is_node("arm.driver.left", wanted) is expected


def test_a_text_is_found_whatever_its_case() -> None:
    assert log.has_text("The Arm is stuck", "arm")
    assert log.has_text("The Arm is stuck", "the * stuck")
    assert not log.has_text("The Arm is stuck", "arm*")
