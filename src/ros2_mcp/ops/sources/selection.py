"""What of a source is read and shown: the selection, the collector of samples, and how they are fitted into bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec, Message
    from ros2_mcp.codec.definitions import Definitions

FIRST_MESSAGE_S = 5.0
"""Whoever names no limit wants the next message: longer than the slowest usual topics (map, diagnostics: 1 s) take."""
LIMITED_S = 20.0
"""Whoever wants a number of messages and names no time; below the 30 s after which some clients give a call up."""
MAX_MESSAGES = 100_000
MAX_BYTES = 64_000_000
"""Of messages to be shown: sixty raw camera pictures. What is shown of them in the end are 32 kB."""
_BESIDE_BYTES = 60
"""Of each message in the result: its time, and the signs around both."""
_LEAST_BYTES = 500
"""So much of a message is shown in any case: less than that says nothing of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """What of a source's messages is read, and how much of them is shown.

    `fields` are paths (none: all), arrays are shown up to `max_array` elements, only every `every_n`-th message is
    kept. Reading ends after `duration_s` or `message_limit` kept messages; with neither, after the first message. The
    result's text has at most `max_bytes`.
    """

    fields: Sequence[str] = ()
    max_array: int = 64
    every_n: int = 1
    duration_s: float | None = None
    message_limit: int | None = None
    max_bytes: int = 32_000

    @property
    def live_s(self) -> float:
        """How long reading takes at most where messages have yet to come."""
        if self.duration_s is not None:
            return self.duration_s
        return FIRST_MESSAGE_S if self.message_limit is None else LIMITED_S

    @property
    def enough(self) -> int | None:
        """After how many kept messages reading ends early; None is never."""
        if self.duration_s is None and self.message_limit is None:
            return 1
        return self.message_limit

    def check(self) -> None:
        """Raises `BadValue` if a number is out of range."""
        bounded("every_n", self.every_n, 1, 1_000_000, "messages")
        if self.message_limit is not None:
            bounded("message_limit", self.message_limit, 1, MAX_MESSAGES, "messages")

    def check_fields(self, definitions: Definitions, type_name: str) -> None:
        """Raises `BadValue` if the type has no such field, with the nearest that it has."""
        if self.fields:
            from ros2_mcp.codec.select import parse_fields

            parse_fields(definitions, type_name, self.fields)


class Collector:
    """Samples within bounds on their number and bytes; the oldest give way. `seen` counts all, `dropped` those.

    With `times_only` their bytes are not kept. It is full as soon as it has kept `enough` samples.
    """

    def __init__(
        self,
        *,
        max_samples: int = MAX_MESSAGES,
        max_bytes: int = MAX_BYTES,
        every_n: int = 1,
        enough: int | None = None,
        times_only: bool = False,
    ) -> None:
        self.samples: deque[Sample] = deque()
        self.seen = 0
        self.dropped = 0
        self._bytes = 0
        self._max_samples = max_samples
        self._max_bytes = max_bytes
        self._every_n = every_n
        self._enough = enough
        self._times_only = times_only

    def add(self, samples: Iterable[Sample]) -> bool:
        """Takes samples in; true as soon as there are enough."""
        for sample in samples:
            self.seen += 1
            if (self.seen - 1) % self._every_n == 0:
                self._keep(replace(sample, data=b"") if self._times_only else sample)
            if self._enough is not None and len(self.samples) >= self._enough:
                return True
        return False

    def _keep(self, sample: Sample) -> None:
        self.samples.append(sample)
        self._bytes += len(sample.data)
        while len(self.samples) > self._max_samples or (self._bytes > self._max_bytes and len(self.samples) > 1):
            self._bytes -= len(self.samples.popleft().data)
            self.dropped += 1


@dataclass(frozen=True, slots=True)
class Fitted:
    """The messages that fit into a result: `values` as JSON, `messages` as they were decoded, for pictures.

    Of those that were chosen to be shown, `undecodable` are not what their type says, the first of them for the reason
    `trouble`; `left_out` had no room. `truncated` names paths whose values are summaries, `hint` how to see them.
    """

    samples: Sequence[Sample] = ()
    values: Sequence[dict[str, Any]] = ()
    messages: Sequence[Message] = ()
    truncated: Sequence[str] = ()
    hint: str = ""
    left_out: int = 0
    undecodable: int = 0
    trouble: str = ""

    @property
    def note(self) -> str:
        """In words, what is not shown although it was read."""
        notes: list[str] = []
        if self.left_out:
            notes.append(f"{self.left_out} more do not fit, evenly left out: choose fields, or every_n.")
        if self.undecodable:
            notes.append(undecodable(self.undecodable, self.trouble))
        return " ".join(notes)


def fit(codec: Codec, type_name: str, samples: Sequence[Sample], selection: Selection) -> Fitted:
    """As many of the samples as fit, evenly spread, first and last included. Each is decoded once.

    How many that are is judged by the newest one that can be decoded. Only what is shown is decoded.

    Raises:
        BadValue: for a field that the type does not have.
    """
    from ros2_mcp.codec.render import Rendered, RenderOptions, render

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

    last, newest = len(samples), None
    while last and newest is None:
        last -= 1
        newest = decoded(samples[last])
    if newest is None:
        return Fitted(undecodable=len(troubles), trouble=troubles[0] if troubles else "")
    whole = rendered(newest, selection.max_bytes)
    chosen = spread(samples[: last + 1], max(selection.max_bytes // (whole.bytes + _BESIDE_BYTES), 1))
    share = max(selection.max_bytes // len(chosen), _LEAST_BYTES)
    read = [(sample, message) for sample in chosen[:-1] if (message := decoded(sample)) is not None]
    results = [rendered(message, share) for _, message in read]
    results.append(whole if whole.bytes <= share else rendered(newest, share))
    read.append((chosen[-1], newest))
    return Fitted(
        [sample for sample, _ in read],
        [result.value for result in results],
        [message for _, message in read],
        sorted({path for result in results for path in result.truncated}),
        results[-1].hint,
        last + 1 - len(chosen),
        len(troubles),
        troubles[0] if troubles else "",
    )


def undecodable(count: int, trouble: str = "") -> str:
    """What is said of messages that are skipped because their bytes do not fit their type."""
    return f"{count} message(s) are not what their type says and are left out{': ' if trouble else '.'}{trouble}"


def spread(samples: Sequence[Sample], most: int) -> list[Sample]:
    """At most `most` of the samples, evenly spread, the first and the last among them."""
    return [samples[index] for index in spread_indices(len(samples), most)]


def spread_indices(count: int, most: int) -> list[int]:
    """At most `most` of so many indices, evenly spread; of several the first and the last are among them."""
    if count <= most:
        return list(range(count))
    if most == 1:
        return [count - 1]
    step = (count - 1) / (most - 1)
    return [round(index * step) for index in range(most)]
