"""Numbers that are added part by part are those of the whole; where the room ends, that is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.measure.columns import Column, Columns, Room
from ros2_mcp.values.columns import ColumnReader
from ros2_mcp.values.select import measurable
from support.made_windows import CODEC, START_NS, encoded

ARRAY = "std_msgs/msg/Float64MultiArray"
NUMBER = "std_msgs/msg/Float64"


def samples_of(type_name: str, values) -> list[Sample]:
    bodies = [encoded(type_name, {"data": value}) for value in values]
    return [Sample(START_NS + 10_000_000 * at, 0, None, body) for at, body in enumerate(bodies)]


def columns(type_name: str, samples: list[Sample], room: Room, batch: int = 7, **more) -> Columns:
    kept = Columns(CODEC, type_name, measurable(CODEC.definitions, type_name, ["data"]), room, **more)
    for begin in range(0, len(samples), batch):
        kept.add(samples[begin : begin + batch])
    return kept


@pytest.mark.parametrize("room", [Room(), Room(times=20, values=50)], ids=["room", "little room"])
def test_totals_are_exact_whether_values_are_kept_or_not(room: Room) -> None:
    values = np.random.default_rng(5).normal(1e6, 2.0, 1000)
    values[[3, 500]] = np.nan, np.inf
    (column,) = columns(NUMBER, samples_of(NUMBER, values.tolist()), room).columns
    finite, at = values[np.isfinite(values)], np.flatnonzero(np.isfinite(values)) * 0.01
    totals = column.totals
    assert (totals.count, totals.not_finite, totals.nan) == (998, 2, 1)
    assert (totals.min, totals.max) == (finite.min(), finite.max())
    assert (totals.mean, totals.std) == (pytest.approx(finite.mean(), rel=1e-14), pytest.approx(finite.std(), rel=1e-9))
    assert column.line.slope == pytest.approx(np.polyfit(at, finite, 1)[0], rel=1e-6)
    assert (column.first, column.last, column.is_constant) == (finite[0], finite[-1], False)


def test_where_the_room_ends_is_said() -> None:
    kept = columns(NUMBER, samples_of(NUMBER, range(1000)), Room(times=20, values=50))
    assert (kept.count, kept.decoded, len(kept.times_ns), len(kept.read_ns)) == (1000, 1000, 20, 21)
    assert kept.columns[0].values.tolist() == list(range(21))
    assert kept.rate_hz() == pytest.approx(100.0)
    assert kept.bounds("The plot shows").startswith("The plot shows only the first 21 of 1000 messages, up to 20")


@pytest.mark.parametrize("room", [Room(), Room(times=20)], ids=["room", "little room"])
def test_the_time_of_a_hole_does_not_lower_the_rate(room: Room) -> None:
    before, after = samples_of(NUMBER, range(1000)), samples_of(NUMBER, range(1000))
    after = [replace(sample, received_ns=sample.received_ns + 50_000_000_000) for sample in after]
    hole = (before[-1].received_ns + 1, after[0].received_ns - 1)
    assert columns(NUMBER, before + after, room).rate_hz([hole]) == pytest.approx(100.0)


def test_of_lists_the_mean_of_each_message_or_all_elements_are_kept() -> None:
    lists = [[1.0, 3.0], [], [2.0], [np.nan], [5.0, np.nan, 7.0]]
    samples = samples_of(ARRAY, lists)
    (means,) = columns(ARRAY, samples, Room()).columns
    assert (means.rows.tolist(), means.values.tolist()) == ([0, 2, 4], [2.0, 2.0, 6.0])
    (whole,) = columns(ARRAY, samples, Room(), whole_lists=True).columns
    assert [part.tolist() for part in whole.by_row(5)] == [[0, 2, 2, 3, 4], [2, 0, 1, 1, 3]]
    assert whole.values[:3].tolist() == [1.0, 3.0, 2.0]
    assert whole.totals.count == 5 and whole.totals.nan == 2


def test_a_list_takes_as_much_room_as_is_kept_of_it() -> None:
    samples = samples_of(ARRAY, [[1.0] * 100] * 50)
    assert len(columns(ARRAY, samples, Room(values=100)).read_ns) == 50
    assert len(columns(ARRAY, samples, Room(values=100), whole_lists=True).read_ns) == 0


def test_a_message_that_is_not_what_its_type_says_is_counted_and_told() -> None:
    samples = samples_of(NUMBER, [1.0, 2.0, 3.0])
    samples.insert(1, Sample(START_NS + 1, 0, None, b"\0\1\0\0no"))
    kept = columns(NUMBER, samples, Room())
    assert (kept.count, kept.decoded, kept.undecodable) == (4, 3, 1)
    assert "1 message that cannot be decoded" in kept.skipped


def test_a_column_without_a_message_is_empty() -> None:
    column = Column(measurable(CODEC.definitions, NUMBER, ["data"])[0])
    assert (len(column.values), len(column.by_row(0)[0]), column.totals.count) == (0, 0, 0)


def test_times_count_from_the_first_message_although_it_came_at_0() -> None:
    kept = Columns(CODEC, "std_msgs/msg/Float64", measurable(CODEC.definitions, "std_msgs/msg/Float64"), Room())
    for at_s in range(3):
        kept.add([Sample(at_s * 10**9, 0, None, encoded("std_msgs/msg/Float64", {"data": float(at_s)}))])
    assert (kept.origin_ns, kept.columns[0].highest.at_s) == (0, 2.0)


@pytest.mark.parametrize("same_length", [True, False])
def test_what_is_measured_of_bytes_is_to_the_bit_what_is_measured_of_decoded_messages(
    same_length: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(3)
    lengths = [7 if same_length else int(length) for length in random.integers(0, 9, 60)]
    lists = samples_of(ARRAY, [random.normal(5, 3, length).tolist() for length in lengths])
    numbers = samples_of(NUMBER, random.normal(5, 3, 60).tolist())

    def measured() -> list[str]:
        found = [columns(ARRAY, lists, Room(), whole_lists=whole).columns[0] for whole in (True, False)]
        return [repr(column) for column in (*found, columns(NUMBER, numbers, Room()).columns[0])]

    of_bytes = measured()
    monkeypatch.setattr(ColumnReader, "read", lambda *_: None)
    assert of_bytes == measured()
