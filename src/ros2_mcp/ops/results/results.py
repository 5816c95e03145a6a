"""Shared by the results of all operations: progress, notes, pictures, JSON and readable words."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import cache
from time import monotonic
from typing import Any, Protocol, TypeVar, cast

from ros2_mcp.model.cells import is_empty
from ros2_mcp.model.errors import AllFailed, RobotError
from ros2_mcp.model.pictures import Picture
from ros2_mcp.model.text import in_quotes, named
from ros2_mcp.model.times import iso_time
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept

R = TypeVar("R")
OneOfSeveral = TypeVar("OneOfSeveral", bound="Outcome")

# The most values of an object in one line, which is for reading; the JSON beside it has all of them.
_MAX_IN_WORDS = 12
_SCALARS = frozenset({str, int, float, bool, type(None)})
_TICK_S = 1.0
"""Seconds between two lines of progress: as often as a person reads a new line."""
_TIME = {"sec", "nanosec"}
"""The fields of a time or a duration."""

Report = Callable[[float, float, str], Awaitable[None]]
"""Called with progress: the part done, the whole, and a readable line."""

HIDDEN = {"hidden": True}
"""Metadata of a result's field that is not part of its JSON, such as a picture."""

ON_REQUEST = {"on_request": True}
"""Metadata of a result's field that is part of its JSON only if it was requested, or has a value; else it is None."""

IF_ANY = {"if_any": True}
"""Metadata of a result's field without a default that structured content omits if it is empty, such as a note."""

ALWAYS = {"always": True}
"""Metadata of a field that is empty by default, but that structured content always has, because it was requested."""

SAID = {"said": True}
"""Metadata of a result's field that its summary contains: the text begins with the summary,
and does not repeat the field."""

EXACT = {"exact": True}
"""Metadata of a field with a value that can be sent back: the text has it as JSON, with its numbers unrounded."""

LINES = {"lines": True}
"""Metadata of a field whose text consists of lines, and is shown line by line."""


def beside(name: str) -> dict[str, str]:
    """Return metadata of a list with one value for each element of the list `name`:
    the text shows both as one table.
    """
    return {"beside": name}


def four_digits(measured: float | None) -> float | None:
    """Return a measured figure, such as a rate, to four significant digits: further
    digits are noise. None stays None.
    """
    return None if measured is None else float(f"{measured:.4g}")


def microseconds(measured: float | None) -> float | None:
    """Return a measured time in seconds, to a microsecond: no time of receipt is more exact. None stays None."""
    return None if measured is None else round(measured, 6)


def at_most_every(seconds: float, report: Report) -> Report:
    """Return a `Report` that passes on at most one line in that time, because clients show each of them."""
    next_at = 0.0

    async def passed_on(done: float, whole: float, line: str) -> None:
        nonlocal next_at
        if monotonic() >= next_at:
            next_at = monotonic() + seconds
            await report(done, whole, line)

    return passed_on


async def silent(_done: float, _whole: float, _line: str) -> None:
    """A `Report` for callers that show no progress."""


async def or_error(work: Awaitable[R], failed: Callable[..., R]) -> R:
    """Return the result of the work, or `failed(error=...)` if it fails: the error of one
    topic must not stop the others.
    """
    try:
        return await work
    except RobotError as error:
        return failed(error=str(error))


class Outcome(Protocol):
    """One of several results; `error` is empty if it succeeded."""

    @property
    def error(self) -> str:
        """The error message."""
        ...

    def summary(self) -> str | list[str]:
        """Return the result in readable words."""
        ...


def unless_all_failed(results: Sequence[OneOfSeveral]) -> Sequence[OneOfSeveral]:
    """Return the results of `or_error`, unless all of them are errors.

    Raises:
        AllFailed: with every error.
    """
    if all(result.error for result in results):
        raise AllFailed(" ".join(line for result in results for line in lines_of(result.summary())))
    return results


def lines_of(summary: str | list[str]) -> list[str]:
    """Return the lines of a summary (a line, or a list of lines)."""
    return [summary] if isinstance(summary, str) else summary


def list_note(matching: int, limit: int, settled: bool = True, absence: str = "") -> str:
    """Return the note of a list that is shortened, or not yet complete, after the `absence` of a
    robot; empty if it is complete.
    """
    notes = [absence] if absence else []
    if matching > limit:
        notes.append(f"{matching} match; the first {limit} are shown. Narrow the pattern, or raise the limit.")
    if not settled:
        notes.append("Discovery had not settled: the list may be incomplete. Ask again.")
    return " ".join(notes)


@asynccontextmanager
async def reporting(report: Report, whole_s: float, line: str | Callable[[], str]) -> AsyncGenerator[None, None]:
    """Report once a second, while the block runs, how long it has run. If `line` is a
    function, it is called for each report.
    """
    started = monotonic()

    async def tick() -> None:
        while True:
            elapsed = monotonic() - started
            await report(elapsed, max(whole_s, elapsed), line if isinstance(line, str) else line())
            await asyncio.sleep(_TICK_S)

    def begin() -> None:  # most blocks end within milliseconds, and need no task
        nonlocal ticking
        ticking = asyncio.ensure_future(tick())

    ticking: asyncio.TimerHandle | asyncio.Task[None] = asyncio.get_running_loop().call_later(_TICK_S, begin)
    try:
        yield
    finally:
        ticking.cancel()


@dataclass(frozen=True, slots=True)
class PictureFacts:
    """Size, format and note of a picture; the picture itself is sent next to the text."""

    width: int
    height: int
    mime: str
    note: str = field(metadata=IF_ANY)


@dataclass(frozen=True, slots=True, kw_only=True)
class WithPictures:
    """Base of results that carry pictures."""

    pictures: Sequence[PictureFacts] = ()
    images: Sequence[Picture] = field(default=(), metadata=HIDDEN)


def facts(pictures: Sequence[Picture]) -> list[PictureFacts]:
    """Return a description of each picture."""
    return [PictureFacts(p.width, p.height, p.mime, p.note) for p in pictures]


def may_be_absent(declared: Field[Any]) -> bool:
    """Return whether structured content omits a field of a result if it is empty: a field that is empty by default,
    `IF_ANY` or `ON_REQUEST`.
    """
    if "on_request" in declared.metadata or "if_any" in declared.metadata:
        return True
    if "always" in declared.metadata:
        return False
    made = declared.default_factory
    return is_empty(declared.default if made is MISSING else made())


def structured(value: Any) -> Any:
    """Return a result as JSON values for a program: as `as_json`, without empty fields that may be absent."""
    if type(value) in _SCALARS:
        return value
    if isinstance(value, (list, tuple)):
        return [structured(item) for item in cast("Sequence[Any]", value)]
    if not is_dataclass(value):
        return value
    shown = ((name, getattr(value, name), may_lack) for name, _, may_lack in _shown_fields(type(value)))
    return {name: structured(inner) for name, inner, may_lack in shown if not (may_lack and is_empty(inner))}


def as_json(value: Any) -> Any:
    """Return a result as JSON values, field by field, without hidden fields."""
    if type(value) in _SCALARS:  # as nearly all are
        return value
    if isinstance(value, (list, tuple)):
        return [as_json(item) for item in cast("Sequence[Any]", value)]
    if not is_dataclass(value):
        return value
    shown = ((name, getattr(value, name), on_request) for name, on_request, _ in _shown_fields(type(value)))
    return {name: as_json(inner) for name, inner, on_request in shown if not (on_request and inner is None)}


@cache
def _shown_fields(kind: type[Any]) -> tuple[tuple[str, bool, bool], ...]:
    """Return for each field that is not hidden: its name, whether it is there only on request, and whether structured
    content omits it if it is empty.
    """
    shown = (field for field in fields(kind) if not field.metadata.get("hidden"))
    return tuple((field.name, "on_request" in field.metadata, may_be_absent(field)) for field in shown)


def exact_time(unix_ns: int) -> str:
    """Return a time as `iso_time` does, with nanoseconds: as an argument it separates a message from the message before
    it.
    """
    return f"{iso_time(unix_ns)[:-1]}{unix_ns % 1000:03d}Z"


def in_words(values: Mapping[str, Any]) -> str:
    """Return the values of a message as one readable line: nested values by their paths, stamps and durations in
    seconds; texts are quoted, and long texts cut.
    """
    shallow = {name: value for name, value in values.items() if not isinstance(value, (dict, list))}
    nested = {name: value for name, value in values.items() if name not in shallow}
    leaves = [f"{named(path)} {text}" for path, text in _leaves({**shallow, **nested})]  # stamps matter least
    more = f" and {len(leaves) - _MAX_IN_WORDS} more" if len(leaves) > _MAX_IN_WORDS else ""
    return ", ".join(leaves[:_MAX_IN_WORDS]) + more


def told_values(values: Mapping[str, Any]) -> str:
    """Return the values that a condition used as a readable line: `nearest(-20, 20) =
    0.5853`; numbers to four digits.
    """
    shown = (
        f"{path} = {value:.4g}" if isinstance(value, float) else f"{path} = {in_quotes(value)}"
        for path, value in values.items()
    )
    return ", ".join(shown) or "no message"


def _leaves(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield path and text of each value. A shortened value (`$summary`) counts as one."""
    for name, value in values.items():
        path = f"{above}{name}"
        if not isinstance(value, dict) or not value or any(key.startswith("$") for key in cast("Iterable[str]", value)):
            yield path, f"{value:.3g}" if isinstance(value, float) else in_quotes(cast("object", value))
        elif value.keys() == _TIME:
            yield path, f"{value['sec'] + value['nanosec'] / 1e9:.3f} s"
        else:
            yield from _leaves(cast("dict[str, Any]", value), f"{path}.")


@dataclass(frozen=True, slots=True)
class AnswerBytes(Kept):
    """The most bytes that the text of one answer about a robot may have."""

    most: int = 12_000
    """Some 3,000 tokens, the default of `--result-bytes`."""


def answer_bytes(robot: Robot) -> int:
    """Return the most bytes that the text of one answer about that robot may have."""
    return robot.kept.get(AnswerBytes, AnswerBytes).most
