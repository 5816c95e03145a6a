"""Which lines of the log are meant."""

from __future__ import annotations

import pytest

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.ops.log import read as log
from support.made_windows import START_NS, Make, Recorded

NOW = 1_900_000_000_000_000_000


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("", 0),
        ("30", NOW - 30_000_000_000),
        ("0.5", NOW - 500_000_000),
        ("30 s ago", NOW - 30_000_000_000),
        ("last 2 min", NOW - 120_000_000_000),
        ("2030-01-31T12:00:00Z", 1_896_091_200_000_000_000),
        ("2030-01-31T12:00:00", 1_896_091_200_000_000_000),
        ("2030-01-31T13:00:00.250000+01:00", 1_896_091_200_250_000_000),
    ],
)
def test_a_time_is_seconds_ago_or_iso(given, expected) -> None:
    assert log.since(given, NOW) == expected


@pytest.mark.parametrize("given", ["yesterday", "-3", "nan", "inf", "30 s in"])
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
    assert log.is_node("arm.driver.left", wanted) is log.is_node("/arm/driver/left", wanted) is expected


def test_a_text_is_found_whatever_its_case() -> None:
    assert log.has_text("The Arm is stuck", "arm")
    assert log.has_text("The Arm is stuck", "the * stuck")
    assert not log.has_text("The Arm is stuck", "arm*")


async def test_of_a_recording_lines_also_count_from_its_beginning(window: Make) -> None:
    said = [(i / 10, {"level": 20 + 10 * (i % 2), "name": "left.arm", "msg": f"line {i}"}) for i in range(6)]
    source = Recorded([window("/rosout", "rcl_interfaces/msg/Log", said)])
    source.began_ns = START_NS - 1_000_000_000
    found = await log.read_recorded(source, log.LogRequest(level="warn", limit=2), 32_000)
    assert {line.node for line in found.lines} == {"/left/arm"}
    for node in ("/left/arm", "left.arm", "arm", "/left"):
        asked = log.LogRequest(node=node, level="warn", limit=2)
        assert (await log.read_recorded(source, asked, 32_000)).lines == found.lines
    assert [line.text for line in found.lines] == ["line 3", "line 5"] and found.seconds_from_start == [1.3, 1.5]
    assert found.summary() == "6 lines in made, 3 matching, the newest 2 shown."
    for limit in (-1, 0):
        with pytest.raises(BadInput, match="limit"):
            await log.read_recorded(source, log.LogRequest(limit=limit), 32_000)
