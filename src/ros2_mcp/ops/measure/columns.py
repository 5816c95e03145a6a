"""What is kept of messages that pass by: times of receipt, and chosen fields as columns of numbers, never the bytes.

So a recording of any size is measured in bounded memory. Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.codec.cdr import Codec, Message
from ros2_mcp.codec.select import FieldPath
from ros2_mcp.model.errors import BadData, BadValue
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.measure.signals import Numbers, flat
from ros2_mcp.ops.results import iso_time
from ros2_mcp.ops.sources.selection import undecodable

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.flow import Times

MOST_ROWS = 1_000_000
"""Messages of one topic whose values are kept: an IMU at 200 Hz for 80 minutes. Looking for jumps takes ten times the
memory of one column, 80 MB."""


@dataclass
class Room:
    """How many numbers all topics of one measurement may still keep: at eight bytes each, 24 MB and 32 MB."""

    times: int = 3_000_000
    values: int = 4_000_000


class Arrivals:
    """When the messages of one topic came. `times_ns` are those of the first messages, as many as there is room for."""

    def __init__(self, room: Room) -> None:
        self.count = 0
        self.bytes = 0
        self.first_ns = self.last_ns = 0
        self._room = room
        self._times = array("q")

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time."""
        if not samples:
            return
        self.first_ns = self.first_ns if self.count else samples[0].received_ns
        self.last_ns = samples[-1].received_ns
        self.count += len(samples)
        self.bytes += sum(len(sample.data) for sample in samples)
        kept = min(len(samples), self._room.times)
        self._room.times -= kept
        self._times.extend(sample.received_ns for sample in samples[:kept])

    @property
    def times_ns(self) -> Times:
        """Times of receipt."""
        return np.frombuffer(self._times, np.int64) if self._times else np.zeros(0, np.int64)

    @property
    def all_kept(self) -> bool:
        """Whether the times are those of all messages."""
        return len(self._times) == self.count

    @property
    def rate_hz(self) -> float | None:
        """Messages per second between the first and the last, whether kept or not."""
        span_s = (self.last_ns - self.first_ns) / 1e9
        return (self.count - 1) / span_s if self.count > 1 and span_s > 0 else None


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
class Column:
    """One field of all messages: `totals` of all its values, `line` and ends of its series, and what is kept of them.

    The series has one value for each message: the value itself, of a list the mean of its finite elements. What is
    kept is the series, or with `whole_lists` all elements.
    """

    path: FieldPath
    whole_lists: bool = False
    totals: Totals = field(default_factory=Totals)
    line: Line = field(default_factory=Line)
    first: float = np.nan
    last: float = np.nan
    messages: int = 0
    is_constant: bool = True
    _first_part: Numbers = field(default_factory=lambda: flat([]))
    _rows: list[NDArray[np.int32]] = field(default_factory=list[NDArray[np.int32]])
    _lengths: list[NDArray[np.int32]] = field(default_factory=list[NDArray[np.int32]])
    _values: list[Numbers] = field(default_factory=list[Numbers])

    def read(self, messages: Sequence[Message]) -> tuple[list[int], list[Numbers]]:
        """Which of the messages have the field, and its values in each: one, or those of a list that is not empty."""
        values = [value_of(self.path, message) for message in messages]
        rows = [row for row, value in enumerate(values) if value is not None and (not self.path.is_list or len(value))]
        if self.path.is_list:
            return rows, [flat(values[row]) for row in rows]
        numbers = flat([values[row] for row in rows])
        return rows, [numbers]

    def add(self, rows: Sequence[int], parts: Sequence[Numbers], times_s: Numbers, first_row: int | None) -> None:
        """Takes in what `read` gave; `first_row` is where to keep it, None: nowhere."""
        if not rows:
            return
        numbers = np.concatenate(parts)
        self.totals.add(numbers)
        self._compare(parts)
        self.messages += len(rows)
        whole = np.array(rows, np.int32)
        if self.path.is_list:
            finite = [part[np.isfinite(part)] for part in parts]
            present = [bool(len(part)) for part in finite]
            means = flat([part.mean() for part in finite if len(part)])
            series_rows, series = whole[present], means
        else:
            is_finite = np.isfinite(numbers)
            series_rows, series = whole[is_finite], numbers[is_finite]
        if len(series):
            self.first = float(series[0]) if not self.line.count else self.first
            self.last = float(series[-1])
            self.line.add(times_s[series_rows], series)
        if first_row is None:
            return
        if self.path.is_list and not self.whole_lists:
            whole, numbers = series_rows, series
        elif self.path.is_list:
            self._lengths.append(np.array([len(part) for part in parts], np.int32))
        self._rows.append(whole + np.int32(first_row))
        self._values.append(numbers)

    def kept_of(self, rows: Sequence[int], parts: Sequence[Numbers]) -> int:
        """How many numbers are kept of what `read` gave: of a list one, unless whole lists are."""
        return len(rows) if self.path.is_list and not self.whole_lists else sum(map(len, parts))

    def _compare(self, parts: Sequence[Numbers]) -> None:
        """Whether it is the same in every message; a NaN is never the same, unless it is in a list."""
        if not self.messages:
            self._first_part = parts[0] if self.path.is_list else parts[0][:1]
        if self.is_constant and self.path.is_list:
            self.is_constant = all(np.array_equal(part, self._first_part, equal_nan=True) for part in parts)
        elif self.is_constant:
            self.is_constant = bool((parts[0] == self._first_part).all())

    @property
    def rows(self) -> NDArray[np.int32]:
        """The rows (numbers of decoded messages) of what is kept."""
        return np.concatenate([np.zeros(0, np.int32), *self._rows])

    @property
    def values(self) -> Numbers:
        """What is kept: a value for each row, or all elements of all lists one after the other."""
        return np.concatenate([flat([]), *self._values])

    @property
    def lengths(self) -> NDArray[np.int32]:
        """Of whole lists how many elements each row has."""
        return np.concatenate([np.zeros(0, np.int32), *self._lengths])

    def by_row(self, rows: int) -> list[Numbers]:
        """The values of each of the first rows: none where a message does not have the field."""
        found = [flat([])] * rows
        if self.path.is_list:
            parts = np.split(self.values, np.cumsum(self.lengths)[:-1]) if len(self.rows) else []
        else:
            parts = np.split(self.values, len(self.rows)) if len(self.rows) else []
        for row, part in zip(self.rows.tolist(), parts, strict=True):
            found[row] = part
        return found


class Columns(Arrivals):
    """The chosen fields of one topic's messages. `read_ns` are the times of those rows that are kept.

    Messages that are not what their type says are left out, and counted as `undecodable`; `trouble` is of the first.
    """

    def __init__(
        self, codec: Codec, type_name: str, fields: Sequence[FieldPath], room: Room, *, whole_lists: bool = False
    ) -> None:
        super().__init__(room)
        self.columns = [Column(path, whole_lists) for path in fields]
        self.decoded = 0
        self.undecodable = 0
        self.trouble: BadData | None = None
        self._codec = codec
        self._type = type_name
        self._read = array("q")

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time; each is decoded once, and let go."""
        super().add(samples)
        if not self.columns or not samples:
            return
        messages: list[Message] = []
        readable: list[Sample] = []
        for sample in samples:
            try:
                messages.append(self._codec.decode(self._type, sample.data))
                readable.append(sample)
            except BadData as error:
                self.undecodable += 1
                self.trouble = self.trouble or error
        times_s = flat([(sample.received_ns - self.first_ns) / 1e9 for sample in readable])
        batches = [column.read(messages) for column in self.columns]
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

    def bounds(self, what: str) -> str:
        """In words, of which part the values were kept, which `what` is of; empty where they all were."""
        if not self.columns or self.all_read:
            return ""
        rows = len(self._read)
        until = f", up to {iso_time(self._read[-1])}" if rows else ""
        return f"{what} of the first {rows} of {self.decoded} messages only{until}: more values were too much to keep."


def value_of(path: FieldPath, message: Message) -> Any:
    """The value of a field in a message; None where a list has no such element."""
    try:
        return path.value_in(message)
    except BadValue:
        return None


def seconds(times_ns: Times, start_ns: int) -> Numbers:
    """Times in seconds from the beginning of a capture; latched messages may be from before it."""
    result: Any = (times_ns - start_ns) / 1e9
    return result
