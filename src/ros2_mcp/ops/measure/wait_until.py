"""Wait until a condition on a topic holds; in a recording, find the first time at which it held."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.errors import BadData, BadValue, NotFound
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted, in_quotes
from ros2_mcp.model.times import recorded_time, seconds_from_start
from ros2_mcp.model.values import NOT_FINITE
from ros2_mcp.ops.results.results import HIDDEN, IF_ANY, SAID, Report, iso_time, reporting, silent
from ros2_mcp.ops.sources.from_before import from_before, outcome_in_words
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Source, Stream
from ros2_mcp_common.finite import word_for

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.expression import Condition
    from ros2_mcp.values.cdr import Message
    from ros2_mcp.values.columns import ExcerptReader

# The most samples examined in one call of a thread: some 10 ms, so that a cancelled call ends at once.
_TURN_SAMPLES = 200
# Bytes of one field that the condition names; a long list is cut after eight elements.
_VALUE_BYTES = 2000


@dataclass(frozen=True, slots=True)
class Wait:
    """Whether the condition was met, and the message that met it; if it was not met, the last message received.

    `messages_checked` counts the messages for which the condition was evaluated; for `not_evaluable` of them it had no
    value (a list too short, a division by zero). `values` has the fields that the condition names, and the values of
    its functions. `dropped` messages arrived faster than they could be checked. `at` is when the message was received,
    `seconds_from_start` the same as an offset from the start of the recording. `from_before` is set if the message had
    been published before this call and no newer one was received; it gives the age.
    """

    topic_name: str = field(metadata=SAID)
    topic_type: str
    condition: str = field(metadata=SAID)
    met: bool = field(metadata=SAID)
    at: str
    seconds_from_start: float | None
    waited: float = field(metadata=SAID)
    messages_checked: int
    not_evaluable: int
    dropped: int
    values: Mapping[str, Any] = field(metadata=SAID)
    message: dict[str, Any] | None
    source: str = field(metadata=SAID)
    note: str = field(metadata=IF_ANY)
    from_before: str = field(default="", metadata=SAID)
    is_live: bool = field(default=True, metadata=HIDDEN)
    when: str = field(default="", metadata=HIDDEN)
    # The words for values that are not finite, in the text.
    odd: Mapping[str, str] = field(default_factory=dict[str, str], metadata=HIDDEN)

    def summary(self) -> str:
        """Return one line with the outcome, the time and the values."""
        seen = f", {'at' if self.met else 'last message at'} {self.when}" if self.when else ""
        when = f"after {self.waited:.3f} s" if self.is_live else f"in {self.source}{seen}"
        said = {path: self.odd.get(path) or in_quotes(value) for path, value in self.values.items()}
        values = ", ".join(f"{path} = {value}" for path, value in said.items())
        outcome = outcome_in_words(
            met=self.met, values=values or "no message", waited=when, from_before=self.from_before
        )
        return f"{self.topic_name}: {self.condition} {outcome}. {self.note}".rstrip()


async def wait_until(
    source: Source, topic: str, text: str, report: Report = silent, *, max_bytes: int = 32_000
) -> Wait:
    """Examine messages until one meets the condition or the source's time is over. Live, of the messages that a latched
    topic replays only the newest counts, and only if no newer one is received within a second.

    Raises:
        BadInput: if the text is not a condition.
        BadValue: for a field that does not exist, or a time out of range.
        NotFound: if the topic does not appear in that time.
        TypeConflict: if the topic has several types.
    """
    from ros2_mcp.ops.measure.expression import condition

    started = monotonic()
    with contextlib.suppress(NotFound):  # the topic may still appear
        condition(source.codec.definitions, await source.type_of(topic), text)
    async with source.judging().follow(topic) as stream:
        asked = condition(stream.codec.definitions, stream.type, text)
        search = _Search(stream, asked, None if source.is_live else _excerpts(stream, asked))

        def progress() -> str:
            return f"{stream.topic}: {search.messages_checked} messages, not met"

        async with reporting(report, source.duration_s, progress):
            await search.run()
        return await asyncio.to_thread(search.result, source, monotonic() - started, max_bytes)


def _excerpts(stream: Stream, asked: Condition) -> ExcerptReader | None:
    """Return a reader of only the fields that the condition names, for a recording; None if they are not all single
    numbers.
    """
    from ros2_mcp.values.columns import ExcerptReader  # imports NumPy, as all reading of recordings does
    from ros2_mcp.values.select import parse_fields

    if asked.computed or not asked.fields:  # a function may need more than the fields named
        return None
    definitions = stream.codec.definitions
    reader = ExcerptReader(definitions, stream.type, parse_fields(definitions, stream.type, asked.fields))
    return reader if reader.suits else None


@dataclass(slots=True)
class _Search:
    """The search in one stream, and its state: `last` is the latest message, or the message that met the condition
    (`met`).

    Decoding and evaluating run in threads: 200 messages may block the event loop for too long. With `excerpts`, only
    the message shown in the result is decoded.
    """

    stream: Stream
    condition: Condition
    excerpts: ExcerptReader | None = None
    last: Sample | None = None
    is_old: bool = False
    met: bool = False
    messages_checked: int = 0
    not_evaluable: int = 0
    why_not_evaluable: str = ""
    undecodable: int = 0

    async def run(self) -> None:
        """Examine messages until one meets the condition or the stream ends. A message sent before the request counts
        only if no newer one is received: it does not show the present state.
        """
        async for batch in self.stream.batches:
            if self.met and not batch:  # met by an earlier message, and no newer one was received for a while
                return
            for begin in range(0, len(batch), _TURN_SAMPLES):
                await asyncio.to_thread(self._examine, batch[begin : begin + _TURN_SAMPLES])
                if self.met and not self.is_old:
                    return

    def _examine(self, samples: Sequence[Sample]) -> None:
        excerpts = self.excerpts.read([sample.data for sample in samples]) if self.excerpts else None
        for number, sample in enumerate(samples):
            message = self._decoded(sample) if excerpts is None else excerpts[number]
            if message is None:
                continue
            self.last, self.is_old, self.met = sample, self.stream.is_replayed(sample), False
            self.messages_checked += 1
            holds = self.condition.holds(message)
            if holds is None:
                self.not_evaluable += 1
                self.why_not_evaluable = self.why_not_evaluable or self.condition.why_undecided(message)
            elif holds:
                self.met = True
                if not self.is_old:
                    return

    def _decoded(self, sample: Sample) -> Message | None:
        """Return the decoded message; None, and counted, if it cannot be decoded."""
        try:
            return self.stream.codec.decode(self.stream.type, sample.data)
        except BadData:
            self.undecodable += 1
            return None

    def result(self, source: Source, waited_s: float, max_bytes: int) -> Wait:
        """Return the result; the message has half of its size, the other half is for the text."""
        from ros2_mcp.values.render import RenderOptions, render
        from ros2_mcp.values.select import parse_field

        definitions, type_name = self.stream.codec.definitions, self.stream.type
        message, values, odd = None, dict[str, Any](), dict[str, str]()
        whole = self._decoded(self.last) if self.last else None
        if whole is not None:
            options = RenderOptions(max_bytes=max_bytes // 2)
            message = render(definitions, type_name, whole, options=options).value
            for path in self.condition.fields:
                options = RenderOptions(max_array=8, max_string=200, max_bytes=_VALUE_BYTES, fields=[path])
                try:
                    value = parse_field(definitions, type_name, path).value_in(whole)
                    values |= render(definitions, type_name, whole, options=options).value
                except BadValue:  # the list is too short
                    values[path] = value = None
                if isinstance(value, float) and not math.isfinite(value):
                    odd[path] = word_for(value)
            computed = self.condition.values(whole)
            odd |= {
                name: word_for(NOT_FINITE[str(value)]) for name, value in computed.items() if str(value) in NOT_FINITE
            }
            values |= computed
        dropped, at_ns = self.stream.counts.dropped, self.last.received_ns if self.last else 0
        notes: list[str] = []
        if self.undecodable:
            notes.append(undecodable(self.undecodable))
        elif not self.messages_checked:
            notes.append(
                "No message came." if self.stream.publishers else "No message came: the topic has no publisher."
            )
        if self.not_evaluable:
            why = f"{self.not_evaluable} of {counted(self.messages_checked, 'message')} could not be checked"
            notes.append(f"{why}: {self.why_not_evaluable}")
        if dropped:
            notes.append(f"{counted(dropped, 'message')} came too fast to be checked.")
        return Wait(
            topic_name=self.stream.topic,
            topic_type=type_name,
            condition=self.condition.text,
            met=self.met,
            at=iso_time(at_ns) if self.last else "",
            seconds_from_start=seconds_from_start(at_ns, source.began_ns) if self.last else None,
            waited=round(waited_s, 6),
            messages_checked=self.messages_checked,
            not_evaluable=self.not_evaluable,
            dropped=dropped,
            values=values,
            message=message,
            source=source.words_after(waited_s),
            note=" ".join(notes),
            is_live=source.is_live,
            when=recorded_time(at_ns, source.began_ns) if self.last else "",
            odd=odd,
            from_before=str(from_before(source, self.stream, [self.last])) if self.last and self.is_old else "",
        )
