"""What every operation's result has in common."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import datetime, timezone
from functools import cache
from time import monotonic
from typing import Any, cast

from ros2_mcp.model.pictures import Picture

Report = Callable[[float, float, str], Awaitable[None]]
"""Told of progress: done so far, the whole, and a readable line."""

_LINE_PART = 120

HIDDEN = {"hidden": True}
"""Metadata of a result's field that is not part of its JSON, such as a picture."""


def at_most_every(seconds: float, report: Report) -> Report:
    """A `Report` that passes on no more than one line in that time."""
    next_at = 0.0

    async def passed_on(done: float, whole: float, line: str) -> None:
        nonlocal next_at
        if monotonic() >= next_at:
            next_at = monotonic() + seconds
            await report(done, whole, line)

    return passed_on


async def silent(_done: float, _whole: float, _line: str) -> None:
    """A `Report` for callers that do not want to know."""


@asynccontextmanager
async def reporting(report: Report, whole_s: float, line: str | Callable[[], str]) -> AsyncGenerator[None, None]:
    """Reports once a second, while the block runs, for how long it has been waited; `line` may change meanwhile."""
    started = monotonic()

    async def tick() -> None:
        while True:
            await asyncio.sleep(1.0)
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


def iso_time(unix_ns: int) -> str:
    """A Unix time in nanoseconds as ISO 8601 in UTC with microseconds."""
    date = datetime.fromtimestamp(unix_ns // 1000 / 1e6, tz=timezone.utc)
    return date.isoformat(timespec="microseconds").replace("+00:00", "Z")


def exact_time(unix_ns: int) -> str:
    """As `iso_time` with nanoseconds: to ask for what comes before a message, or from it on."""
    return f"{iso_time(unix_ns)[:-1]}{unix_ns % 1000:03d}Z"


def in_words(values: Mapping[str, Any]) -> str:
    """An object's values as one readable line; long ones are cut."""
    return ", ".join(f"{name} {_brief(value)}" for name, value in values.items())


def _brief(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LINE_PART else f"{text[:_LINE_PART]}…"
