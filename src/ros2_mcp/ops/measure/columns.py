"""Receive times and chosen numeric fields of messages, kept as columns of numbers without the messages themselves.

Thus a recording of any size is measured in bounded memory. Import it inside functions only: it needs NumPy.
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
"""The most messages of one topic whose values are kept: 80 minutes of an IMU at 200 Hz. The search for jumps takes ten
times the memory of one column, 80 MB."""


Parts: TypeAlias = "Numbers | list[Numbers]"
"""Values of messages: one number for each, a row for each, or, if lists differ in length, an array for each."""
_WHOLE = {"int64": np.int64, "uint64": np.uint64}
"""Integer types that float64 rounds: their values are compared for equality as integers."""


@dataclass
class Room:
    """How many times and values all topics of one measurement may still keep: at eight bytes each, 24 MB and 32 MB."""

    times: int = 3_000_000
    values: int = 4_000_000


class Arrivals:
    """The receive times of one topic's messages. `times_ns` holds those of the first messages, as many as there is room
    for.

    Messages for which `is_replayed` is true were sent earlier and kept for late subscribers. They are counted as
    `replayed`, the newest at `replayed_ns` by its publisher's clock (0: none), and not in counts, bytes, times and
    rates.
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
        """Add messages, in the order of time."""
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
        """The number of messages, replayed messages included."""
        return self.count + self.replayed

    @property
    def times_ns(self) -> Times:
        """Receive times, Unix time in ns."""
        return np.frombuffer(self._times, np.int64) if self._times else np.zeros(0, np.int64)

    @property
    def all_kept(self) -> bool:
        """Whether the times of all messages are kept."""
        return len(self._times) == self.count

    def rate_hz(self, holes: Holes = ()) -> float | None:
        """Return the rate in messages per second from the first message to the last. Times that the recording cannot
        give (`holes`) do not count; messages whose times are not kept do. None if no two times differ.
        """
        if self.all_kept:
            return rate_hz(self.times_ns, holes)
        inside = [(max(begin, self.first_ns), min(end, self.last_ns)) for begin, end in holes]
        lost_ns = [end - begin for begin, end in inside if end > begin]
        span_s = (self.last_ns - self.first_ns - sum(lost_ns)) / 1e9
        return (self.count - 1 - len(lost_ns)) / span_s if span_s > 0 else None


@dataclass
class Totals:
    """Statistics of finite values, updated batch by batch without keeping the values (Chan's formulas).

    Of all `total` values, `not_finite` are NaN or infinite, of which `nan` are NaN. `squares` is the sum of the squared
    deviations from the mean.
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
        """The number of finite values."""
        return self.total - self.not_finite

    @property
    def std(self) -> float:
        """The standard deviation of the population (divided by the number of values); NaN without finite values."""
        return float(np.sqrt(self.squares / self.count)) if self.count else np.nan

    def add(self, values: Numbers) -> None:
        """Add values."""
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
    """The least-squares straight line through points, updated batch by batch."""

    count: int = 0
    time: float = 0.0
    value: float = 0.0
    spread: float = 0.0
    product: float = 0.0

    def add(self, times: Numbers, values: Numbers) -> None:
        """Add points; times in s."""
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
        """The slope per second; NaN if there are no two different times."""
        return self.product / self.spread if self.spread > 0 else np.nan


@dataclass
class Extreme:
    """The place of the smallest value, or with `sign` -1 of the largest: its time, and in a list the element's
    index.
    """

    sign: float = 1.0
    at_s: float = 0.0
    element: int = 0
    _least: float = np.inf

    def add(self, numbers: Numbers, lengths: NDArray[np.int32], times_s: Numbers) -> None:
        """Add the values of messages; `lengths` is the number of elements of each message's list, empty if the field is
        no list.
        """
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
    """One numeric field over all messages: `totals` of all values, `line`, first and last value of its series, and kept
    values.

    The series has one value for each message: the value itself, or the mean of a list's finite elements. Kept is the
    series, or with `whole_lists` every element.
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
        """Return the indices of the messages that have the field, and their values: a number, or a list that is not
        empty.

        Args:
            values: one value for each message; None if the message lacks the field.
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
        """Add the result of `read`. `first_row` is the kept row of the first of these messages; None: keep none of
        them.
        """
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
        """Return how many numbers of the result of `read` are kept: one number for a list, or all its elements with
        `whole_lists`.
        """
        is_list = self.path.is_list
        return int(_lengths(parts).sum()) if rows and is_list and self.whole_lists else len(rows)

    def _compare(self, parts: Sequence[NDArray[Any]] | NDArray[Any]) -> None:
        """Update `is_constant`: whether all messages with the field have the same value. NaN equals NaN only inside
        lists.
        """
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
        """The value in the first message (of a list: all elements); 64-bit integers are exact."""
        return self._first_part

    @property
    def rows(self) -> NDArray[np.int32]:
        """The rows of the kept values, i.e. the indices of decoded messages."""
        return np.frombuffer(self._rows, np.int32) if self._rows else np.zeros(0, np.int32)

    @property
    def values(self) -> Numbers:
        """The kept values: one for each row, or the elements of all lists in sequence."""
        return np.frombuffer(self._values) if self._values else flat([])

    @property
    def lengths(self) -> NDArray[np.int32]:
        """The number of elements in each row, if whole lists are kept."""
        return np.frombuffer(self._lengths, np.int32) if self._lengths else np.zeros(0, np.int32)

    def by_row(self, rows: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return, for each of the first `rows` rows, the index of its first element in `values` and the number of its
        elements (0 if the message lacks the field).
        """
        counts = np.zeros(rows, np.int32)
        counts[self.rows] = self.lengths if self.path.is_list else 1
        return np.cumsum(counts, dtype=np.int32) - counts, counts


def _lengths(parts: Parts) -> NDArray[np.int32]:
    """Return the number of values of each message."""
    if isinstance(parts, np.ndarray):
        return np.full(len(parts), parts.shape[1] if parts.ndim > 1 else 1, np.int32)
    return np.array([len(part) for part in parts], np.int32)


class Columns(Arrivals):
    """The chosen fields of one topic's messages, including replayed messages. `read_ns` holds the times of the kept
    rows.

    Times of lines and extremes are seconds from `origin_ns`, the receive time of the first message.

    Messages that cannot be decoded are skipped and counted as `undecodable`; `trouble` is the first error.
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
        """Add messages, in the order of time. Each is read once and not kept."""
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
        with np.errstate(over="ignore", invalid="ignore"):  # values near the limits of float64
            for column, (rows, parts) in zip(self.columns, batches, strict=True):
                column.add(rows, parts, times_s, first_row)

    def _values_in(self, samples: Sequence[Sample]) -> tuple[Sequence[Sample], Sequence[Any]]:
        """Return the messages that can be decoded, and for each field its values in them."""
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
        """Called with the messages of the kept rows; subclasses override it to keep more of each row."""

    @property
    def read_ns(self) -> Times:
        """Receive times of the kept rows, Unix time in ns."""
        return np.frombuffer(self._read, np.int64) if self._read else np.zeros(0, np.int64)

    @property
    def all_read(self) -> bool:
        """Whether all decoded rows are kept."""
        return len(self._read) == self.decoded

    def check(self) -> None:
        """Raise `BadData` if there are messages but none could be decoded."""
        if self.trouble and not self.decoded:
            raise self.trouble

    @property
    def skipped(self) -> str:
        """The number of messages that could not be decoded, in words; empty if there are none."""
        return undecodable(self.undecodable, str(self.trouble)) if self.undecodable else ""

    def bounds(self, what: str, began_ns: int | None = None) -> str:
        """Return a sentence that `what` covers only the first messages, if later values were not kept; else empty."""
        if not self.columns or self.all_read:
            return ""
        rows = len(self._read)
        until = f", up to {recorded_time(self._read[-1], began_ns)}" if rows else ""
        return f"{what} only the first {rows} of {self.decoded} messages{until}: later values did not fit in memory."


def value_of(path: FieldPath, message: object) -> Any:
    """Return the value of a field in a message; None if a list has no such element."""
    try:
        return path.value_in(message)
    except BadValue:
        return None


def seconds(times_ns: Times, start_ns: int) -> Numbers:
    """Return times in seconds from the start of a capture; times of latched messages may be negative."""
    result: Any = (times_ns - start_ns) / 1e9
    return result
