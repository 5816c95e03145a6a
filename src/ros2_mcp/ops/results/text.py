"""The text of a result, which an agent reads and acts on (decision 58).

The summary comes first, then the other fields of the result: short values share a line, lists of objects are tables,
values that can be sent back are exact JSON on one line. What did not fit is counted at the end.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, fields, is_dataclass
from functools import cache
from typing import Any, TypeAlias, cast

from ros2_mcp.model.alike import differences, written
from ros2_mcp.model.cells import Exact, cell, is_empty, line, pairs, table, told_apart
from ros2_mcp.model.text import exact_json, visible, visible_json, with_json_escapes
from ros2_mcp.model.values import DIAGONAL, DIAGONAL_EXPLAINED
from ros2_mcp.ops.results.results import PictureFacts, as_json, lines_of

MOST_CHARACTERS = 12_000
"""The most characters of one text: a leading client cuts longer texts in the middle (measured, decision 58)."""
_MOST_COLUMNS = 12
"""If messages differ in more places than these, a reader loses count: then each value has its path beside it."""
_ACCOUNT = 300
"""Characters that are kept free for the sentence on what was left out."""
_LEAST_ROOM = 1000
"""Characters that are kept for the lines below the summary, however long that is."""
_OURS = frozenset(
    {
        *("note", "notes", "error", "problem", "problems", "recommendation", "reasons", "mismatches", "limitations"),
        *("footprint", "place", "command_inputs", "sensors", "joints", "controllers", "stacks", "frames", "unhealthy"),
        *("other_actions", "topics_without_publisher", "command_services", "state_topics"),
        *("not_read", "not_checked", "allowed", "limits", "forbidden", "held", "cause", "helps", "hint", "health"),
        "log",
    }
)
"""Fields whose texts this server has written, with the robot's texts quoted already: shown unchanged."""
_LAST = ("note", "notes")
_NOTHING_FOUND = "Nothing was found."
"""The text of a result without a line of its own, such as an empty list."""

Beside: TypeAlias = "tuple[str, Sequence[Any]] | None"
"""The name and the values of a list that has one value for each element of another list."""


@dataclass(eq=False)
class _Part:
    """Lines that belong together. The last `rows` of them may be omitted; `name` says what they contain."""

    lines: list[str]
    name: str = ""
    rows: int = 0
    left_out: int = 0

    @property
    def size(self) -> int:
        return sum(len(text) + 1 for text in self.lines)

    def drop(self, excess: int) -> int:
        """Leave out last rows until `excess` characters are saved, but keep one row. Return
        the number of characters saved.
        """
        dropped = 0
        while dropped < excess and self.rows > 1:
            dropped += len(self.lines.pop()) + 1
            self.rows, self.left_out = self.rows - 1, self.left_out + 1
        return dropped


def as_text(
    result: Any, lines: Sequence[str] = (), *, most: int = MOST_CHARACTERS, narrowing: Sequence[str] = ()
) -> str:
    """Return a result as text, with invisible characters escaped.

    Args:
        result: a dataclass with a `summary`, which begins the text.
        lines: further lines of the summary: how the arguments were read, what of a recording is damaged.
        most: the most characters; what does not fit is left out from the end of the longest tables.
        narrowing: the arguments by which a caller gets a shorter result, or another part.
    """
    summary = [visible(one) for one in lines_of(result.summary())]
    for one in map(visible, lines):
        if not any(one in said for said in summary):
            summary.append(one)
    summary = summary or [_NOTHING_FOUND]
    body = _Body("\n".join(summary))
    body.add(result)
    head = _Part(summary, "the summary", len(summary) - 1)
    parts, ends = body.parts, body.ends
    if any(f'"{DIAGONAL}"' in text for part in parts for text in part.lines):
        ends.append(DIAGONAL_EXPLAINED)
    room = most - sum(len(text) + 1 for text in ends)
    if head.size + sum(part.size for part in parts) > room:
        ends.append(_shorten(head, parts, room, narrowing))
    return "\n".join([*head.lines, *(text for part in parts for text in part.lines), *ends])


def _shorten(head: _Part, parts: Sequence[_Part], room: int, narrowing: Sequence[str]) -> str:
    """Leave out what does not fit, rows first, and return a sentence on it. A line is shown whole or not at all."""
    room -= _ACCOUNT
    head.drop(head.size - max(room - _LEAST_ROOM, _LEAST_ROOM))
    by_size = sorted(parts, key=lambda part: part.size, reverse=True)
    excess = head.size + sum(part.size for part in parts) - room
    for part in by_size:
        excess -= part.drop(excess)
    gone: list[str] = []
    for part in by_size:
        if excess > 0:
            excess -= part.size
            gone.append(f"{part.name or part.lines[0].partition(':')[0][:60]} ({part.size} characters)")
            part.lines.clear()
    cut = [
        f"the last {part.left_out} of {part.rows + part.left_out} rows of {part.name}"
        for part in (head, *by_size)
        if part.left_out and part.lines
    ]
    way = f" To see them, ask for less at once: {', '.join(narrowing)}." if narrowing else ""
    return f"Omitted, because this text is full: {', '.join((*cut, *gone))}.{way}"


class _Body:
    """The text below the summary. `said` is the text of the summary, `ends` are the last lines."""

    def __init__(self, said: str) -> None:
        self.said = said
        self.parts: list[_Part] = []
        self.ends: list[str] = []

    def add(self, one: Any, title: str = "", path: str = "", *, is_row: bool = False) -> None:
        """Add all fields of a dataclass; `title` begins their first line, `path` the name of each.

        What the summary says is not repeated, except in the rows of a list, so that each row is complete.
        """
        found = [(declared, getattr(one, declared.name)) for declared in _shown_fields(one)]
        beside: dict[str, tuple[str, Sequence[Any]]] = {
            declared.metadata["beside"]: (declared.name, value) for declared, value in found if _beside(declared)
        }
        scalars: list[str] = []
        others: list[tuple[Field[Any], Any]] = []
        for declared, value in found:
            if is_empty(value) or _beside(declared) or ("said" in declared.metadata and not is_row):
                continue
            if _is_short(value) and "lines" not in declared.metadata and not _has_sentences(declared):
                scalars.append(f"{path}{declared.name}: {cell(_cell_value(declared, value))}")
            else:
                others.append((declared, value))
        if title or scalars:
            self._line(f"{title}{', '.join(scalars)}".rstrip())
        for declared, value in others:
            name = f"{path}{declared.name}"
            if not _has_sentences(declared):
                self._field(name, declared, value, beside.get(declared.name), is_row=is_row)
                continue
            texts = [value] if isinstance(value, str) else value
            texts = [visible(text) for text in texts if is_row or text not in self.said]
            if declared.name in _LAST and not is_row:
                self.ends += [f"{name}: {text}" for text in texts]
            elif len(texts) == 1:
                self._line(f"{name}: {texts[0]}")
            elif texts:
                self.parts.append(_Part([f"{name}:", *(f"- {text}" for text in texts)], name, len(texts)))

    def _line(self, text: str) -> None:
        self.parts.append(_Part([text]))

    def _field(self, name: str, declared: Field[Any], value: Any, beside: Beside, *, is_row: bool) -> None:
        """Add a field that is neither a short value nor sentences."""
        if "lines" in declared.metadata:
            rows = [f"  {visible(text)}" for text in str(value).splitlines()]
            self.parts.append(_Part([f"{name}:", *rows], f"lines of {name}", len(rows)))
        elif isinstance(value, Mapping) or "exact" in declared.metadata:
            self._line(f"{name}: {exact_json(as_json(value))}")
        elif is_dataclass(value):
            self.add(value, path=f"{name}.", is_row=is_row)
        else:
            self._list(name, value, beside)

    def _list(self, name: str, values: Sequence[Any], beside: Beside) -> None:
        if isinstance(values[0], PictureFacts):
            for picture in cast("Sequence[PictureFacts]", values):
                note = "" if picture.note in self.said else f", {visible(picture.note)}"
                self._line(f"picture: {picture.width} x {picture.height} px{note}")
        elif is_dataclass(values[0]):
            self._rows(name, values, beside)
        elif all(isinstance(value, Mapping) for value in values):
            self._messages(name, values, beside)
        elif all(isinstance(value, str) for value in values):
            texts = [cell(value) for value in values]
            if len(texts) > 1 and any(" " in text for text in texts):
                self.parts.append(_Part([f"{name}:", *texts], name, len(texts)))
            else:
                self._line(f"{name}: {', '.join(texts)}")
        else:
            self._line(f"{name}: {exact_json(as_json(values))}")

    # ── lists of objects ───────────────────────────────────────────────────────────────────────────────────────

    def _rows(self, name: str, values: Sequence[Any], beside: Beside) -> None:
        """Add objects of the result: as a table if they are flat, else one after the other."""
        inner = _nested(values)
        if not inner:
            self.parts.append(_flat(name, _with(beside, [_row(value) for value in values])))
        elif len(inner) == 1 and len(values) > 1 and _is_table(values, inner[0]):
            self.parts.append(_grouped(name, values, inner[0], self.said))
        else:
            for number, value in enumerate(values, 1):
                which = f" {number} of {len(values)}" if len(values) > 1 else ""
                self.add(value, title=f"{name}{which}: ", is_row=True)

    def _messages(self, name: str, values: Sequence[Any], beside: Beside) -> None:
        """Add objects of the robot, exact: the first whole, and the differences of the others if that is shorter."""
        shown = [visible_json(value)[0] for value in values]
        whole = [_exact(value) for value in shown]
        times = beside if beside and len(beside[1]) == len(values) else None
        if len(whole) == 1:
            when = f" ({times[0]}: {cell(times[1][0])})" if times and times[1][0] else ""
            self._line(f"{name} (1){when}: {whole[0]}")
            return
        plain = _Part([f"{name} ({len(whole)}):", *_listed(whole, times)], name, len(whole))
        short = _alike(name, whole, times, differences(shown))
        self.parts.append(short if short and short.size < plain.size else plain)


def _alike(
    name: str, whole: Sequence[str], times: Beside, columns: Sequence[tuple[str, Sequence[Any]]] | None
) -> _Part | None:
    """Return messages as the first of them and the differences of the others; None if they are entirely different."""
    if columns is None:
        return None
    title = f"{name} ({len(whole)}), the first whole, then"
    if len(columns) <= _MOST_COLUMNS:
        rows = [{path: Exact(_exact(values[at])) for path, values in columns} for at in range(len(whole))]
        rows = _with(times, rows)
        title = f"{title} the differences of each:" if columns else f"{name} ({len(whole)}), all equal:"
        return _Part([title, whole[0], *table(rows, list(rows[0]))], name, len(rows) if rows[0] else 0)
    texts = [(json.dumps(path, ensure_ascii=False), [_exact(value) for value in values]) for path, values in columns]
    changes = [
        f"{{{','.join(f'{path}:{values[at]}' for path, values in texts if values[at] != values[0])}}}"
        for at in range(1, len(whole))
    ]
    later = (times[0], times[1][1:]) if times else None
    return _Part([f"{title} the differences from it, by path:", whole[0], *_listed(changes, later)], name, len(changes))


def _exact(shown: Any) -> str:
    """Return JSON of a value that was made visible. Every parser reads it as the original value."""
    return with_json_escapes(written(shown))


def _listed(texts: Sequence[str], times: Beside) -> list[str]:
    """Return JSON texts, a line for each, with the times before them if there are some."""
    if not times:
        return list(texts)
    return [line([times[0], "value"]), *(line([at, Exact(text)]) for at, text in zip(times[1], texts, strict=True))]


def _flat(name: str, rows: Sequence[Mapping[str, Any]]) -> _Part:
    """Return rows as a table; values that are equal in all rows are shown once, above."""
    columns, shared = told_apart(rows)
    if len(rows) == 1:
        return _Part([f"{name} (1): {pairs(rows[0], columns)}"])
    title = f"{name} ({len(rows)}{_in_all(rows[0], shared)}):"
    texts = [cell(row[columns[0]]) for row in rows] if len(columns) == 1 else []
    if texts and not any(" " in text for text in texts):
        return _Part([f"{title} {columns[0]} {', '.join(texts)}"])
    return _Part([title, *table(rows, columns)], name, len(rows) if columns else 0)


def _grouped(name: str, values: Sequence[Any], inner: str, said: str) -> _Part:
    """Return objects that each have a list of flat objects as one table: a line for each object, then its rows. Objects
    without rows are omitted if the summary (`said`) already contains all of their values.
    """
    groups = [[_row(one) for one in _items(getattr(value, inner))] for value in values]
    rows = [row for group in groups for row in group]
    columns, shared = told_apart(rows)
    lines = [f"{name} ({len(values)}), {inner} of each{_in_all(rows[0], shared)}:", *table((), columns)]
    for value, group in zip(values, groups, strict=True):
        own = {key: one for key, one in _row(value).items() if key != inner and not is_empty(one)}
        if group or not all(str(one) in said for one in own.values()):
            lines += [pairs(own, list(own)), *(line([row[column] for column in columns]) for row in group)]
    return _Part(lines, f"{name} and their {inner}", len(lines) - 2)


def _in_all(row: Mapping[str, Any], shared: Sequence[str]) -> str:
    return f"; every row has {pairs(row, shared)}" if shared else ""


def _with(beside: Beside, rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the rows with the values of the accompanying list as their first column."""
    if not beside or len(beside[1]) != len(rows):
        return list(rows)
    return [{beside[0]: at, **row} for at, row in zip(beside[1], rows, strict=True)]


def _nested(values: Sequence[Any]) -> list[str]:
    """Return the names of fields whose value in some of these objects does not fit into one table cell."""
    found: dict[str, None] = {}
    for value in values:
        for declared in _shown_fields(value):
            inner: Any = getattr(value, declared.name)
            items = _items(inner)
            first = items[0] if items else inner
            has_objects = bool(items) and isinstance(items[0], Mapping)
            if has_objects or is_dataclass(first) or ("lines" in declared.metadata and inner):
                found[declared.name] = None
    return list(found)


def _is_table(values: Sequence[Any], inner: str) -> bool:
    """Return whether that field of the objects has lists of flat objects."""
    elements = [element for value in values for element in _items(getattr(value, inner))]
    return bool(elements) and all(map(is_dataclass, elements)) and not _nested(elements)


def _is_short(value: Any) -> bool:
    """Return whether a value may share a line with others."""
    items = _items(value)
    return isinstance(items[0] if len(items) == 1 else value, (str, int, float))


def _items(value: Any) -> Sequence[Any]:
    """Return the elements of a list; none for anything else."""
    return cast("Sequence[Any]", value) if isinstance(value, (list, tuple)) else ()


def _row(one: Any) -> dict[str, Any]:
    """Return the cells of an object."""
    return {declared.name: _cell_value(declared, getattr(one, declared.name)) for declared in _shown_fields(one)}


def _cell_value(declared: Field[Any], value: Any) -> Any:
    return Exact(exact_json(as_json(value))) if "exact" in declared.metadata and value is not None else value


def _beside(declared: Field[Any]) -> bool:
    return "beside" in declared.metadata


def _has_sentences(declared: Field[Any]) -> bool:
    return declared.name in _OURS and "str" in str(declared.type)


def _shown_fields(one: Any) -> tuple[Field[Any], ...]:
    return _shown_fields_of(cast("type[Any]", type(one)))


@cache
def _shown_fields_of(kind: type[Any]) -> tuple[Field[Any], ...]:
    return tuple(declared for declared in fields(kind) if not declared.metadata.get("hidden"))
