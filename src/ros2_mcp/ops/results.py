"""What the results of all operations have in common: progress, notes, pictures, JSON and readable words."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from time import monotonic
from typing import Any, Protocol, TypeVar, cast

from ros2_mcp.model.errors import AllFailed, RobotError
from ros2_mcp.model.pictures import Picture
from ros2_mcp.model.text import in_quotes, named
from ros2_mcp.model.times import iso_time

R = TypeVar("R")
OneOfSeveral = TypeVar("OneOfSeveral", bound="Outcome")

# Values of an object in one line: it is there to be read; all of them stand in the JSON beside it.
_MAX_IN_WORDS = 12

Report = Callable[[float, float, str], Awaitable[None]]
"""Is called with progress: done so far, the whole, and a readable line."""

HIDDEN = {"hidden": True}
"""Metadata of a result's field that is not part of its JSON, such as a picture."""


def at_most_every(seconds: float, report: Report) -> Report:
    """A `Report` that passes on no more than one line in that time; clients show each of them."""
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
    """The result of the work, or `failed(error=...)` if it fails: the error of one topic must not end the others."""
    try:
        return await work
    except RobotError as error:
        return failed(error=str(error))


class Outcome(Protocol):
    """One of several results; `error` is empty if it did not fail."""

    @property
    def error(self) -> str:
        """What went wrong, in words."""
        ...

    def summary(self) -> str | list[str]:
        """The result in readable words."""
        ...


def unless_all_failed(results: Sequence[OneOfSeveral]) -> Sequence[OneOfSeveral]:
    """The results of `or_error`, as long as one of them is none.

    Raises:
        AllFailed: with every error.
    """
    if all(result.error for result in results):
        raise AllFailed(" ".join(line for result in results for line in lines_of(result.summary())))
    return results


def lines_of(summary: str | list[str]) -> list[str]:
    """The lines of a summary, which is one line or a list of lines."""
    return [summary] if isinstance(summary, str) else summary


def list_note(matching: int, limit: int, settled: bool = True) -> str:
    """What a shortened or early list says of itself; empty if it is complete."""
    notes: list[str] = []
    if matching > limit:
        notes.append(f"{matching} match, the first {limit} are shown: narrow the pattern or raise the limit.")
    if not settled:
        notes.append("Discovery had not settled yet: the list may be incomplete, ask again.")
    return " ".join(notes)


@asynccontextmanager
async def reporting(report: Report, whole_s: float, line: str | Callable[[], str]) -> AsyncGenerator[None, None]:
    """Reports once a second, while the block runs, how long it has run; `line` may change meanwhile."""
    started = monotonic()

    async def tick() -> None:
        while True:
            await asyncio.sleep(1.0)  # as often as a person reads a new line
            elapsed = monotonic() - started
            await report(elapsed, max(whole_s, elapsed), line if isinstance(line, str) else line())

    ticking = asyncio.create_task(tick())
    try:
        yield
    finally:
        ticking.cancel()


@dataclass(frozen=True, slots=True)
class PictureFacts:
    """What a picture shows; the picture itself travels beside the result."""

    width: int
    height: int
    mime: str
    note: str


@dataclass(frozen=True, slots=True, kw_only=True)
class WithPictures:
    """Base of results that carry pictures."""

    pictures: Sequence[PictureFacts] = ()
    images: Sequence[Picture] = field(default=(), metadata=HIDDEN)


def facts(pictures: Sequence[Picture]) -> list[PictureFacts]:
    """What the pictures show."""
    return [PictureFacts(p.width, p.height, p.mime, p.note) for p in pictures]


def as_json(value: Any) -> Any:
    """A result as JSON values, field by field, without what is hidden."""
    if isinstance(value, (list, tuple)):
        return [as_json(item) for item in cast("Sequence[Any]", value)]
    if is_dataclass(value):
        return {name: as_json(getattr(value, name)) for name in _shown_fields(type(value))}
    return value


@cache
def _shown_fields(kind: type[Any]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind) if not field.metadata.get("hidden"))


def exact_time(unix_ns: int) -> str:
    """As `iso_time`, with nanoseconds: a time argument that separates a message from the one before it."""
    return f"{iso_time(unix_ns)[:-1]}{unix_ns % 1000:03d}Z"


def in_words(values: Mapping[str, Any]) -> str:
    """The values of an object of the robot as one readable line; texts are quoted, and long ones cut."""
    first = list(values.items())[:_MAX_IN_WORDS]
    more = f" and {len(values) - len(first)} more" if len(values) > len(first) else ""
    return ", ".join(f"{named(name)} {_brief(value)}" for name, value in first) + more


def _brief(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else in_quotes(value)
