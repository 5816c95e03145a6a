"""What is kept of messages that pass by: times of receipt, and chosen fields as columns of numbers, never the bytes.

So a recording of any size is measured in bounded memory. Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadData, BadValue
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.times import recorded_time
from ros2_mcp.ops.measure.flow import Holes, rate_hz
from ros2_mcp.ops.measure.signals import Numbers, flat
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.columns import ColumnReader
from ros2_mcp.values.select import FieldPath

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.flow import Times

MOST_ROWS = 1_000_000
"""Messages of one topic whose values are kept: an IMU at 200 Hz for 80 minutes. Looking for jumps takes ten times the
memory of one column, 80 MB."""


Parts: TypeAlias = "Numbers | list[Numbers]"
"""Values of messages: a number of each, a row of each, or where lists differ in length an array of each."""
_WHOLE = {"int64": np.int64, "uint64": np.uint64}
"""Whole numbers that float64 rounds: equal ones are told by these."""


@dataclass
class Room:
    """How many numbers all topics of one measurement may still keep: at eight bytes each, 24 MB and 32 MB."""

    times: int = 3_000_000
    values: int = 4_000_000


class Arrivals:
    """When the messages of one topic came. `times_ns` are those of the first messages, as many as there is room for.

    Those that `is_replayed` names were sent earlier and kept for late subscribers: they are `replayed`, the newest at
    `replayed_ns` (0: none) by its publisher's clock, and say nothing of counts, bytes, times and rates.
    """

    def __init__(self, room: Room, is_replayed: Callable[[Sample], bool] = lambda _: False) -> None:
        self.count = 0
        self.replayed = 0
        self.replayed_ns = 0
        self.bytes = 0
        self.first_ns = self.last_ns = 0
        self._room = room
        self._times = array("q")
        self._is_replayed = is_replayed

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time."""
        old = [sample for sample in samples if self._is_replayed(sample)]
        if old:
            self.replayed += len(old)
            self.replayed_ns = max(self.replayed_ns, *(sample.source_ns or sample.received_ns for sample in old))
            samples = [sample for sample in samples if not self._is_replayed(sample)]
        if not samples:
            return
        self.first_ns = self.first_ns if self.count else samples[0].received_ns
        self.last_ns = samples[-1].received_ns
        self.count += len(samples)
        self.bytes += sum(sample.size for sample in samples)
        kept = min(len(samples), self._room.times)
        self._room.times -= kept
        self._times.extend(sample.received_ns for sample in samples[:kept])

    @property
    def seen(self) -> int:
        """How many messages there are, with those from before."""
        return self.count + self.replayed

    @property
    def times_ns(self) -> Times:
        """Times of receipt."""
        return np.frombuffer(self._times, np.int64) if self._times else np.zeros(0, np.int64)

    @property
    def all_kept(self) -> bool:
        """Whether the times are those of all messages."""
        return len(self._times) == self.count

    def rate_hz(self, holes: Holes = ()) -> float | None:
        """Messages per second between the first and the last, without the time of holes, whether kept or not."""
        if self.all_kept:
            return rate_hz(self.times_ns, holes)
        inside = [(max(begin, self.first_ns), min(end, self.last_ns)) for begin, end in holes]
        lost_ns = [end - begin for begin, end in inside if end > begin]
        span_s = (self.last_ns - self.first_ns - sum(lost_ns)) / 1e9
        return (self.count - 1 - len(lost_ns)) / span_s if span_s > 0 else None


@dataclass
class Totals:
    """Numbers of finite values, added part by part, so that they need not be kept (Chan's formulas).

    Of all `total` values `not_finite` are NaN or infinite, `nan` of them NaN. `squares` is the sum of the squared
    distances from the mean.
    """

    total: int = 0
    not_finite: int = 0
    nan: int = 0
    min: float = np.inf
    max: float = -np.inf
    mean: float = 0.0
    squares: float = 0.0

    @property
    def count(self) -> int:
        """How many are finite."""
        return self.total - self.not_finite

    @property
    def std(self) -> float:
        """The standard deviation, divided by their number."""
        return float(np.sqrt(self.squares / self.count)) if self.count else np.nan

    def add(self, values: Numbers) -> None:
        """Takes in values."""
        finite = values[np.isfinite(values)]
        before, new = self.count, len(finite)
        self.total += len(values)
        self.not_finite += len(values) - new
        self.nan += int(np.count_nonzero(np.isnan(values)))
        if not new:
            return
        mean = float(finite.mean())
        away = mean - self.mean
        self.squares += float(((finite - mean) ** 2).sum()) + away * away * before * new / (before + new)
        self.mean += away * new / (before + new)
        self.min, self.max = min(self.min, float(finite.min())), max(self.max, float(finite.max()))


@dataclass
class Line:
    """The straight line that fits points best, added part by part."""

    count: int = 0
    time: float = 0.0
    value: float = 0.0
    spread: float = 0.0
    product: float = 0.0

    def add(self, times: Numbers, values: Numbers) -> None:
        """Takes in points."""
        new = len(times)
        if not new:
            return
        time, value = float(times.mean()), float(values.mean())
        whole = self.count + new
        away_t, away_v, weight = time - self.time, value - self.value, self.count * new / whole
        self.spread += float(((times - time) ** 2).sum()) + away_t * away_t * weight
        self.product += float((times - time) @ (values - value)) + away_t * away_v * weight
        self.time += away_t * new / whole
        self.value += away_v * new / whole
        self.count = whole

    @property
    def slope(self) -> float:
        """The change per second; NaN where there are not two different times."""
        return self.product / self.spread if self.spread > 0 else np.nan


@dataclass
class Extreme:
    """Where the smallest value was, or with `sign` -1 the largest: the time, and of a list the index of the element."""

    sign: float = 1.0
    at_s: float = 0.0
    element: int = 0
    _least: float = np.inf

    def add(self, numbers: Numbers, lengths: NDArray[np.int32], times_s: Numbers) -> None:
        """Takes in the values of messages; of lists also how many each message has, else that is empty."""
        signed = np.where(np.isfinite(numbers), self.sign * numbers, np.inf)
        at = int(signed.argmin())
        if signed[at] >= self._least:
            return
        self._least = float(signed[at])
        row, self.element = at, 0
        if len(lengths):
            ends = np.cumsum(lengths)
            row = int(np.searchsorted(ends, at, side="right"))
            self.element = at - int(ends[row]) + int(lengths[row])
        self.at_s = float(times_s[row])


@dataclass
class Column:
    """One field of all messages: `totals` of all its values, `line` and ends of its series, and what is kept of them.

    The series has one value for each message: the value itself, of a list the mean of its finite elements. What is
    kept is the series, or with `whole_lists` all elements.
    """

    path: FieldPath
    whole_lists: bool = False
    totals: Totals = field(default_factory=Totals)
    line: Line = field(default_factory=Line)
    lowest: Extreme = field(default_factory=Extreme)
    highest: Extreme = field(default_factory=lambda: Extreme(-1.0))
    first: float = np.nan
    last: float = np.nan
    messages: int = 0
    is_constant: bool = True
    _first_part: NDArray[Any] = field(default_factory=lambda: flat([]))
    _rows: array[int] = field(default_factory=lambda: array("i"))
    _lengths: array[int] = field(default_factory=lambda: array("i"))
    _values: array[float] = field(default_factory=lambda: array("d"))

    def read(self, values: Sequence[Any] | NDArray[Any]) -> tuple[Sequence[int], Parts]:
        """Which of the messages have the field, and its values in each: one, or those of a list that is not empty.

        Args:
            values: of each message one value, None where it has no such field.
        """
        whole = _WHOLE.get(self.path.type.base)
        if isinstance(values, np.ndarray):
            rows, present = range(len(values) if values.ndim == 1 or values.shape[1] else 0), values
        else:
            rows = [
                row for row, value in enumerate(values) if value is not None and (not self.path.is_list or len(value))
            ]
            present = [values[row] for row in rows]
        if not rows:
            return rows, []
        if self.path.is_list and not isinstance(present, np.ndarray):
            self._compare([np.asarray(one, whole).ravel() for one in present] if whole else list(map(flat, present)))
            return rows, [flat(value) for value in present]
        numbers = np.asarray(present, np.float64)
        self._compare(np.asarray(present, whole) if whole else numbers)
        return rows, numbers

    def add(self, rows: Sequence[int], parts: Parts, times_s: Numbers, first_row: int | None) -> None:
        """Takes in what `read` gave; `first_row` is where to keep it, None: nowhere."""
        if not rows:
            return
        numbers = parts.ravel() if isinstance(parts, np.ndarray) else np.concatenate(parts)
        lengths = _lengths(parts) if self.path.is_list else np.zeros(0, np.int32)
        self.totals.add(numbers)
        self.messages += len(rows)
        whole = np.array(rows, np.int32)
        for extreme in (self.lowest, self.highest):
            extreme.add(numbers, lengths, times_s[whole])
        is_finite = np.isfinite(numbers)
        if not self.path.is_list:
            series_rows, series = whole[is_finite], numbers[is_finite]
        elif isinstance(parts, np.ndarray) and is_finite.all():
            series_rows, series = whole, parts.mean(axis=1)
        else:
            finite = [part[np.isfinite(part)] for part in parts]
            present = [bool(len(part)) for part in finite]
            series_rows, series = whole[present], flat([part.mean() for part in finite if len(part)])
        if len(series):
            self.first = float(series[0]) if not self.line.count else self.first
            self.last = float(series[-1])
            self.line.add(times_s[series_rows], series)
        if first_row is None:
            return
        if self.path.is_list and not self.whole_lists:
            whole, numbers = series_rows, series
        elif self.path.is_list:
            self._lengths.frombytes(lengths.tobytes())
        self._rows.frombytes((whole + np.int32(first_row)).tobytes())
        self._values.frombytes(numbers.tobytes())

    def kept_of(self, rows: Sequence[int], parts: Parts) -> int:
        """How many numbers are kept of what `read` gave: of a list one, unless whole lists are."""
        is_list = self.path.is_list
        return int(_lengths(parts).sum()) if rows and is_list and self.whole_lists else len(rows)

    def _compare(self, parts: Sequence[NDArray[Any]] | NDArray[Any]) -> None:
        """Whether it is the same in every message that has it; a NaN is never the same, unless it is in a list."""
        if not self.messages:
            self._first_part = parts[0] if self.path.is_list else np.asarray(parts[:1])
        if self.is_constant and isinstance(parts, np.ndarray):
            same = parts == self._first_part if parts.shape[1:] == self._first_part.shape[: parts.ndim - 1] else None
            if self.path.is_list and parts.dtype.kind == "f" and same is not None:
                same |= np.isnan(parts) & np.isnan(self._first_part)
            self.is_constant = same is not None and bool(same.all())
        elif self.is_constant:
            self.is_constant = all(
                np.array_equal(part, self._first_part, equal_nan=part.dtype.kind == "f") for part in parts
            )

    @property
    def first_value(self) -> NDArray[Any]:
        """Its value in the first message, or of a list all of that one's; of 64-bit whole numbers these, exactly."""
        return self._first_part

    @property
    def rows(self) -> NDArray[np.int32]:
        """The rows (numbers of decoded messages) of what is kept."""
        return np.frombuffer(self._rows, np.int32) if self._rows else np.zeros(0, np.int32)

    @property
    def values(self) -> Numbers:
        """What is kept: a value for each row, or all elements of all lists one after the other."""
        return np.frombuffer(self._values) if self._values else flat([])

    @property
    def lengths(self) -> NDArray[np.int32]:
        """Of whole lists how many elements each row has."""
        return np.frombuffer(self._lengths, np.int32) if self._lengths else np.zeros(0, np.int32)

    def by_row(self, rows: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """For each of the first rows where in `values` its own begin, and how many they are: 0 without the field."""
        counts = np.zeros(rows, np.int32)
        counts[self.rows] = self.lengths if self.path.is_list else 1
        return np.cumsum(counts, dtype=np.int32) - counts, counts


def _lengths(parts: Parts) -> NDArray[np.int32]:
    """How many values each message has."""
    if isinstance(parts, np.ndarray):
        return np.full(len(parts), parts.shape[1] if parts.ndim > 1 else 1, np.int32)
    return np.array([len(part) for part in parts], np.int32)


class Columns(Arrivals):
    """The chosen fields of one topic's messages, replayed ones too. `read_ns` are the times of the rows that are kept.

    The times of lines and extremes are seconds from `origin_ns`, when the first message came.

    Messages that are not what their type says are left out, and counted as `undecodable`; `trouble` is of the first.
    """

    def __init__(
        self,
        codec: Codec,
        type_name: str,
        fields: Sequence[FieldPath],
        room: Room,
        *,
        whole_lists: bool = False,
        is_replayed: Callable[[Sample], bool] = lambda _: False,
    ) -> None:
        super().__init__(room, is_replayed)
        self.origin_ns: int | None = None
        self.columns = [Column(path, whole_lists) for path in fields]
        self.decoded = 0
        self.undecodable = 0
        self.trouble: BadData | None = None
        self._codec = codec
        self._type = type_name
        self._reader = ColumnReader(codec.definitions, type_name, fields)
        self._read = array("q")

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time; each is read once, and let go."""
        super().add(samples)
        if not self.columns or not samples:
            return
        origin_ns = self.origin_ns = samples[0].received_ns if self.origin_ns is None else self.origin_ns
        readable, values = self._values_in(samples)
        times_s = flat([(sample.received_ns - origin_ns) / 1e9 for sample in readable])
        batches = [column.read(of_field) for column, of_field in zip(self.columns, values, strict=True)]
        kept = [column.kept_of(*batch) for column, batch in zip(self.columns, batches, strict=True)]
        numbers = len(readable) + sum(kept)
        first_row = None
        if self.all_read and numbers <= self._room.values and len(self._read) + len(readable) <= MOST_ROWS:
            first_row = len(self._read)
            self._room.values -= numbers
            self._read.extend(sample.received_ns for sample in readable)
            self.keep(readable)
        self.decoded += len(readable)
        with np.errstate(over="ignore", invalid="ignore"):  # numbers at the end of their range
            for column, (rows, parts) in zip(self.columns, batches, strict=True):
                column.add(rows, parts, times_s, first_row)

    def _values_in(self, samples: Sequence[Sample]) -> tuple[Sequence[Sample], Sequence[Any]]:
        """The messages that can be read, and of each field its values in them."""
        found = self._reader.read([sample.data for sample in samples])
        if found is not None:
            return samples, found
        readable: list[Sample] = []
        values: list[list[Any]] = [[] for _ in self.columns]
        for sample in samples:
            try:
                message = self._codec.decode(self._type, sample.data)
            except BadData as error:
                self.undecodable += 1
                self.trouble = self.trouble or error
                continue
            readable.append(sample)
            for column, of_field in zip(self.columns, values, strict=True):
                of_field.append(value_of(column.path, message))
        return readable, values

    def keep(self, samples: Sequence[Sample]) -> None:
        """For who keeps more of each row."""

    @property
    def read_ns(self) -> Times:
        """The times of the rows that are kept."""
        return np.frombuffer(self._read, np.int64) if self._read else np.zeros(0, np.int64)

    @property
    def all_read(self) -> bool:
        """Whether all rows are kept."""
        return len(self._read) == self.decoded

    def check(self) -> None:
        """Raises `BadData` if there are messages and none is what its type says."""
        if self.trouble and not self.decoded:
            raise self.trouble

    @property
    def skipped(self) -> str:
        """In words, how many messages could not be decoded; empty where all could."""
        return undecodable(self.undecodable, str(self.trouble)) if self.undecodable else ""

    def bounds(self, what: str, began_ns: int | None = None) -> str:
        """In words, of which part the values were kept, which `what` is of; empty where they all were."""
        if not self.columns or self.all_read:
            return ""
        rows = len(self._read)
        until = f", up to {recorded_time(self._read[-1], began_ns)}" if rows else ""
        return f"{what} of only the first {rows} of {self.decoded} messages{until}: later values did not fit in memory."


def value_of(path: FieldPath, message: object) -> Any:
    """The value of a field in a message; None where a list has no such element."""
    try:
        return path.value_in(message)
    except BadValue:
        return None


def seconds(times_ns: Times, start_ns: int) -> Numbers:
    """Times in seconds from the beginning of a capture; latched messages may be from before it."""
    result: Any = (times_ns - start_ns) / 1e9
    return result
