"""The ring of log lines is bounded, tells of every new line, and takes none twice."""

from __future__ import annotations

import pytest

from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot.log import LogRing
from ros2_mcp.settings import Settings


def ring(**bounds: int) -> LogRing:
    return LogRing(Bridge(lambda: start_carrier(Settings())), **bounds)


def line(number: int, level: int = 20, size: int = 20) -> Sample:
    data = b"\0\1\0\0" + number.to_bytes(8, "little") + bytes([level]) + bytes(size - 13)
    return Sample(number, number, None, data)


@pytest.mark.promise("ros2_log_read", "keeps the newest 5000 lines")
def test_the_newest_5000_lines_are_kept() -> None:
    log = ring()
    for number in range(5001):
        log.add(line(number))
    assert [sample.received_ns for sample in log.lines] == list(range(1, 5001))


def test_the_oldest_lines_give_way_and_are_counted() -> None:
    log = ring(max_lines=3)
    for number in range(5):
        log.add(line(number))
    assert [sample.received_ns for sample in log.lines] == [2, 3, 4]
    assert log.dropped == 2


def test_bytes_are_bounded_too() -> None:
    log = ring(max_bytes=100)
    for number in range(10):
        log.add(line(number, size=40))
    assert [sample.received_ns for sample in log.lines] == [8, 9]


def test_the_newest_line_stays_however_long_it_is() -> None:
    log = ring(max_bytes=10)
    log.add(line(1))
    assert len(log.lines) == 1


def test_a_line_that_comes_again_is_not_taken_twice() -> None:
    log, heard = ring(), []
    log.on_line(lambda level, _: heard.append(level))
    for number in (1, 2, 1, 2):
        log.add(line(number, level=10 * number))
    assert (len(log.lines), heard) == (2, [10, 20])


def test_a_listener_can_leave() -> None:
    log, heard = ring(), []
    leave = log.on_line(lambda level, _: heard.append(level))
    log.add(line(1))
    leave()
    leave()
    log.add(line(2))
    assert heard == [20]
