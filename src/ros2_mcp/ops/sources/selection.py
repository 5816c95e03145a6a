"""Choose what of a source is read and shown: the selection, the collector of samples, and fitting them into bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadData, BadValue
from ros2_mcp.model.samples import STAMP_END, Sample
from ros2_mcp.model.text import counted, named
from ros2_mcp.model.times import iso_time

if TYPE_CHECKING:
    from ros2_mcp.ops.sources.source import Source
    from ros2_mcp.values.cdr import Codec, Message
    from ros2_mcp.values.definitions import Definitions

FIRST_MESSAGE_S = 5.0
"""How long to wait for the next message if no limit is given: longer than the periods of
the slowest usual topics (1 s)."""
LIMITED_S = 20.0
"""How long to wait for a number of messages without a duration: some clients give up a call after 30 s."""
MAX_MESSAGES = 100_000
MAX_BYTES = 64_000_000
"""The most bytes of messages to be shown: sixty raw camera pictures. The result finally shows 10 kB of them."""
MAX_BYTES_IN_TOTAL = 192_000_000
"""The most bytes that all collectors have together, for all clients: as much as one measurement may have."""
_LITTLE_BYTES = 1_000_000
"""A collector with less than this takes no share of the total: a hundred of them are less than two cameras."""
_BESIDE_BYTES = 60
"""Bytes of a message in the result besides its value: its time in ISO 8601, quotes and commas."""
_LEAST_BYTES = 500
"""The least bytes of a message that are shown: fewer would say nothing about it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The messages of a source that are read, and how much of them is shown.

    `fields` are paths (none: all); if they are `shared` by several topics, a type need not have all of them. Arrays are
    shown up to `max_array` elements, only every `every_n`-th message is kept. Reading ends after `duration_s` or
    `message_limit` kept messages; with neither, after the first message. The result's text has at most `max_bytes`.
    """

    fields: Sequence[str] = ()
    max_array: int = 64
    every_n: int = 1
    duration_s: float | None = None
    message_limit: int | None = None
    max_bytes: int = 10_000
    shared: bool = False

    @property
    def live_s(self) -> float:
        """The longest time in s that a live read takes."""
        if self.duration_s is not None:
            return self.duration_s
        return FIRST_MESSAGE_S if self.message_limit is None else LIMITED_S

    @property
    def enough(self) -> int | None:
        """The number of kept messages after which reading ends; None: never."""
        if self.duration_s is None and self.message_limit is None:
            return 1
        return self.message_limit

    def check(self) -> None:
        """Raise `BadValue` if a number is out of range."""
        bounded("every_n", self.every_n, 1, 1_000_000, "messages")
        if self.message_limit is not None:
            bounded("message_limit", self.message_limit, 1, MAX_MESSAGES, "messages")

    def check_fields(self, definitions: Definitions, type_name: str) -> None:
        """Raise `BadValue` if the type has no such field; the error names the nearest field."""
        if self.fields:
            from ros2_mcp.values.select import parse_fields

            parse_fields(definitions, type_name, self.fields)

    def fitting(self, definitions: Definitions, type_name: str) -> tuple[Selection, str]:
        """Return the selection with only the shared fields that the type has, and a sentence on the fields that it
        lacks.

        Raises:
            BadValue: for a field that the type does not have; for shared fields only if it has none of them.
        """
        if not self.shared:
            self.check_fields(definitions, type_name)
            return self, ""
        from ros2_mcp.values.select import parse_field

        lacking: list[BadValue] = []
        kept: list[str] = []
        for path in self.fields:
            try:
                parse_field(definitions, type_name, path)
                kept.append(path)
            except BadValue as error:
                lacking.append(error)
        if lacking and not kept:
            raise lacking[0]
        absent = ", ".join(named(path) for path in self.fields if path not in kept)
        return replace(
            self, fields=kept
        ), f"Not shown, because {type_name} has no such field: {absent}." if absent else ""

    @property
    def has_filter(self) -> bool:
        """Return whether its fields select elements by a value: messages without such elements are skipped."""
        return any("==" in path for path in self.fields)

    def wanted(self, codec: Codec, type_name: str, samples: Sequence[Sample]) -> Sequence[Sample]:
        """Return the samples that pass its filters. Samples that cannot be decoded pass, and
        are counted when they are shown.
        """
        from ros2_mcp.values.select import parse_fields

        paths = [path for path in parse_fields(codec.definitions, type_name, self.fields) if "==" in path.path]

        def passes(sample: Sample) -> bool:
            try:
                message = codec.decode(type_name, sample.data)
                return not all(path.finds_none_in(message) for path in paths)
            except (BadData, BadValue):
                return True

        return [sample for sample in samples if passes(sample)]


@dataclass(kw_only=True, eq=False)
class Collector:
    """Samples within bounds on their number and bytes: the oldest are discarded and counted
    as `dropped`; `seen` counts all.

    All collectors share `MAX_BYTES_IN_TOTAL`: one that exceeds its share discards samples.

    With `times_only` only the bytes up to a header's stamp are kept. A collector is full once it has kept `enough`
    samples.
    """

    max_samples: int = MAX_MESSAGES
    max_bytes: int = MAX_BYTES
    every_n: int = 1
    enough: int | None = None
    times_only: bool = False
    samples: deque[Sample] = field(default_factory=deque[Sample], init=False)
    seen: int = field(default=0, init=False)
    dropped: int = field(default=0, init=False)
    _bytes: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        _collecting.add(self)

    def add(self, samples: Iterable[Sample]) -> bool:
        """Add samples. Return True as soon as there are enough."""
        most_bytes = min(self.max_bytes, MAX_BYTES_IN_TOTAL // max(1, sum(one.is_large for one in _collecting)))
        for sample in samples:
            self.seen += 1
            if (self.seen - 1) % self.every_n == 0:
                self.samples.append(_head_of(sample) if self.times_only else sample)
                self._bytes += 0 if self.times_only else len(sample.data)
            while len(self.samples) > self.max_samples or (self._bytes > most_bytes and len(self.samples) > 1):
                gone = self.samples.popleft()
                self._bytes -= 0 if self.times_only else len(gone.data)
                self.dropped += 1
            if self.enough is not None and len(self.samples) >= self.enough:
                return True
        return False

    @property
    def is_large(self) -> bool:
        """Return whether the collector is so large that it takes a share of the total."""
        return self._bytes > _LITTLE_BYTES


def _head_of(sample: Sample) -> Sample:
    """Return a sample with only its bytes up to a header's stamp."""
    return replace(sample, data=sample.data[:STAMP_END], whole_bytes=sample.size)


_collecting: WeakSet[Collector] = WeakSet()
"""All collectors of this process: its memory is bounded as a whole."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """The messages that fit into a result: `values` as JSON, `messages` decoded, for pictures.

    Of the messages chosen to be shown, `undecodable` cannot be decoded as their type, the first of them for the reason
    `trouble`; `left_out` did not fit. `truncated` has the paths whose values are summaries, each with the field that
    shows more of it.
    """

    samples: Sequence[Sample] = ()
    values: Sequence[dict[str, Any]] = ()
    messages: Sequence[Message] = ()
    truncated: Mapping[str, str] = field(default_factory=dict[str, str])
    left_out: int = 0
    undecodable: int = 0
    trouble: str = ""

    @property
    def note(self) -> str:
        """A sentence on the messages that were read but are not shown."""
        notes: list[str] = []
        if self.left_out:
            notes.append(
                f"{counted(self.left_out, 'more message')} omitted evenly, to fit: choose fields, or give every_n."
            )
        if self.undecodable:
            notes.append(undecodable(self.undecodable, self.trouble))
        return " ".join(notes)


def fit(codec: Codec, type_name: str, samples: Sequence[Sample], selection: Selection) -> Fitted:
    """Return as many of the samples as fit, evenly spread, with the first and the last. Each is decoded once.

    Their number follows from the size of the newest one that can be decoded. Only the shown ones are decoded.

    Raises:
        BadValue: for a field that the type does not have.
    """
    from ros2_mcp.values.render import Rendered, RenderOptions, render

    selection.check_fields(codec.definitions, type_name)
    troubles: list[str] = []

    def decoded(sample: Sample) -> Message | None:
        try:
            return codec.decode(type_name, sample.data)
        except BadData as error:
            troubles.append(str(error))
            return None

    def rendered(message: Message, max_bytes: int) -> Rendered:
        fields = tuple(selection.fields) or None
        options = RenderOptions(max_array=selection.max_array, max_bytes=max_bytes, fields=fields)
        return render(codec.definitions, type_name, message, options=options)

    # The size of the newest decodable message gives the number that fit. Those after it cannot be decoded.
    last, newest = len(samples), None
    while last and newest is None:
        last -= 1
        newest = decoded(samples[last])
    if newest is None:
        return Fitted(undecodable=len(troubles), trouble=troubles[0] if troubles else "")
    whole = rendered(newest, selection.max_bytes)
    room = max(selection.max_bytes // (whole.bytes + _BESIDE_BYTES), 1)
    chosen = [samples[index] for index in spread_indices(last + 1, room)]
    share = max(selection.max_bytes // len(chosen), _LEAST_BYTES)
    shown = [(sample, message) for sample in chosen[:-1] if (message := decoded(sample)) is not None]
    results = [rendered(message, share) for _, message in shown]
    results.append(whole if whole.bytes <= share else rendered(newest, share))
    shown.append((chosen[-1], newest))
    return Fitted(
        samples=[sample for sample, _ in shown],
        values=[result.value for result in results],
        messages=[message for _, message in shown],
        truncated=dict(sorted({path: by for result in results for path, by in result.truncated.items()}.items())),
        left_out=last + 1 - len(chosen),
        undecodable=len(troubles),
        trouble=troubles[0] if troubles else "",
    )


def message_times(source: Source, samples: Sequence[Sample]) -> tuple[str, list[float]]:
    """Return a time in ISO 8601, and how many seconds after it each sample was received, to the microsecond.

    The time is the beginning of the recording; for a live source, or if the beginning is unknown, the time of the first
    sample.
    """
    if not samples:
        return "", []
    start_ns = samples[0].received_ns if source.began_ns is None else source.began_ns
    return iso_time(start_ns), [(sample.received_ns // 1000 - start_ns // 1000) / 1e6 for sample in samples]


def undecodable(count: int, trouble: str = "") -> str:
    """Return the sentence on messages that are skipped because their bytes do not fit their type."""
    return (
        f"Not shown: {counted(count, 'message')} that cannot be decoded as this type{': ' if trouble else '.'}{trouble}"
    )


def spread_indices(count: int, most: int) -> list[int]:
    """Return at most `most` of `count` indices, evenly spread, with the first and the last; for `most` 1, the last."""
    if count <= most:
        return list(range(count))
    if most == 1:
        return [count - 1]
    step = (count - 1) / (most - 1)
    return [round(index * step) for index in range(most)]
