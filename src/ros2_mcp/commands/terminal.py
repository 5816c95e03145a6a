"""Formats results for people in a terminal: tables, and messages as in `ros2 topic echo`.

A result is shown in full except for empty values, values that the summary contains, and columns that do not fit, which
are named.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

Row = Mapping[str, Any]

_ISO_TIME = re.compile(r"\d{4}-\d\d-\d\d[T ](\d\d:\d\d:\d\d\.\d{3})\d*Z")
"""A time, of which a table shows hours to milliseconds."""
_UNITS = {"hz": "Hz", "s": "s", "sec": "s", "ms": "ms", "m": "m", "rad": "rad", "px": "px", "bytes": "bytes"}
"""The unit that the last word of a name means."""
_SECONDS = ("duration", "elapsed", "waited")
"""Names of durations in s that lack the unit."""
_SAID = ("note", "notes", "pictures", "source", "total", "settled", "truncated", "hash", "type_hash")
"""Fields that are not shown: the summary contains them, or only programs need them."""
_MESSAGES = ("message", "messages", "result", "feedback", "last_feedback", "request", "response", "examples", "value")
"""Fields with the robot's own fields below: their names are kept, and none is omitted."""
_TITLES = ("topic_name", "node", "name", "service_name", "field", "recording_id", "relay_id", "stamp", "goal_id", "bag")
"""Fields that can be the title of an item that is not shown in a table."""
_FIRST = 6
"""How many values of a long array are shown beside its bounds: they fit into the line."""
_CELL = 60
"""The widest cell, in characters: a longer text would push all other columns off the screen."""
_NARROWEST = 20
"""The narrowest column of text, in characters: the beginning of a type or of a sentence."""
_FEW = 3
"""The most short words of a list that share a line with other values."""
_DIGITS, _DIGITS_OF_FIELDS = 4, 9
"""Significant digits of measurements, and of the robot's own values: a latitude needs 9 for a resolution of 0.1 m."""
_MEGABYTE = 1_000_000
_MATRIX = {9: 3, 36: 6}
"""Length of a covariance, and of its rows."""


def readable(summary: Sequence[str], result: Row, width: int) -> list[str]:
    """Return lines for people: the summary, then the rest of the result. `width` is in characters."""
    said = "\n".join(summary)
    parts: dict[str, Any] = {}
    rest: dict[str, Any] = {}
    for name, value in _paired(result).items():
        if _is_empty(value) or name in _SAID or _is_said(value, said) or (name == "fields" and "text" in result):
            continue
        is_part = (isinstance(value, (list, dict)) or "\n" in str(value)) and not _is_short(value)
        (parts if is_part else rest)[name] = value
    shown = [_part(name, value, width, is_only=len(parts) == 1) for name, value in parts.items()]
    if rest:
        shown.append(_beside(rest, width) if parts else _pairs(rest))
    lines = list(summary)
    for part in shown:
        lines += ["", *part]
    return lines


# ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _part(name: str, value: Any, width: int, *, is_only: bool) -> list[str]:
    """Return the lines of one field of a result, below its name unless it is the only field."""
    if isinstance(value, str):
        return _indented(value.split("\n"))  # indented, to differ from our own lines
    if name in ("message", "messages") and isinstance(value, (list, dict)):
        return _messages(_listed(cast("Any", value)), width)
    if name == "examples":  # to be copied, so JSON
        return [f"{kind}: {json.dumps(one, ensure_ascii=False)}" for kind, one in cast("Row", value).items()]
    if isinstance(value, dict):
        return [f"{_label(name)}:", *_indented(_fields(cast("Row", value), width - 2))]
    items = cast("list[Any]", value)
    if is_only:
        return _several(name, items, width)
    if not any(isinstance(item, dict) for item in items):
        return [f"{_label(name)}:", *_indented(_wrapped([_text(item) for item in items], width - 2, ", "))]
    return [f"{_label(name)}:", *_indented(_several(name, items, width - 2))]


def _several(name: str, items: Sequence[Any], width: int) -> list[str]:
    if not all(isinstance(item, dict) for item in items):
        return [_text(item) for item in items]
    rows = [_paired(cast("Row", item)) for item in items]
    if any(_has_rows(row) for row in rows):
        return [line for row in rows for line in ["", *_block(row, width)]][1:]
    return _table(rows, width, is_raw=name in _MESSAGES)


def _block(row: Row, width: int) -> list[str]:
    """Return the lines of an item that contains tables or messages: its title, and its content indented."""
    title = next((name for name in _TITLES if row.get(name)), "")
    inner = {name: value for name, value in row.items() if name != title}
    lines = readable([], inner, width - 2)
    return [_text(row[title]) if title else "-", *_indented([line for line in lines if line])]


def _messages(messages: Sequence[Any], width: int) -> list[str]:
    """Return several small messages as a table, one line each; others one after another, as in `ros2 topic echo`."""
    flat = [_flat(cast("Row", message)) for message in messages if isinstance(message, dict)]
    if len(flat) == len(messages) > 1 and all(_is_scalar(value) for row in flat for value in row.values()):
        table = _table(flat, width, is_raw=True, may_leave_out=False)
        if table:
            return table
    lines: list[str] = []
    for message in messages:
        shown = _fields(cast("Row", message), width) if isinstance(message, dict) else [_text(message)]
        lines += [*shown, "---"]
    return lines[:-1]


def _fields(value: Row, width: int) -> list[str]:
    """Return a message or another object in YAML style, with short values on one line."""
    lines: list[str] = []
    for key, below in value.items():
        name = _on_one_line(key)
        line = f"{name}: {_text(below)}"
        if len(line) <= width or _is_scalar(below) or _is_summarised(below):
            lines.append(line)
        elif isinstance(below, dict):
            lines += [f"{name}:", *_indented(_fields(cast("Row", below), width - 2))]
        else:
            lines += [f"{name}:", *_indented(_items(cast("list[Any]", below), width - 2))]
    return lines


def _items(items: Sequence[Any], width: int) -> list[str]:
    if all(_is_scalar(item) for item in items):
        return _matrix(items, width) or _wrapped([_text(item) for item in items], width, ", ")
    lines: list[str] = []
    for item in items:
        line = f"- {_text(item)}"
        if len(line) <= width or not isinstance(item, dict):
            lines.append(line)
        else:
            below = _indented(_fields(cast("Row", item), width - 2))
            lines += [f"- {below[0].lstrip()}", *below[1:]]
    return lines


def _matrix(items: Sequence[Any], width: int) -> list[str]:
    """Return numbers that are a covariance as a matrix; an empty list for others."""
    columns = _MATRIX.get(len(items), 0)
    cells = [_text(item) for item in items]
    widest = max(map(len, cells), default=0)
    if not columns or columns * (widest + 2) > width or not all(isinstance(item, (int, float)) for item in items):
        return []
    rows = [cells[start : start + columns] for start in range(0, len(cells), columns)]
    return ["  ".join(cell.rjust(widest) for cell in row) for row in rows]


# ── tables ───────────────────────────────────────────────────────────────────────────────────────────────────────


def _table(rows: Sequence[Row], width: int, *, is_raw: bool = False, may_leave_out: bool = True) -> list[str]:
    """Return a line for each row; transposed if that fits better; otherwise without the columns that do not fit.

    Without `may_leave_out`: an empty list if not all columns fit.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    if not is_raw:
        names = [name for name in names if any(not _is_empty(row.get(name)) for row in rows)]
    digits = _DIGITS_OF_FIELDS if is_raw else _DIGITS
    heads = {name: _on_one_line(name) if is_raw else _label(name) for name in names}
    columns = {name: [heads[name], *(_cell(row.get(name), digits) for row in rows)] for name in names}
    numbers = {name for name in names if all(_is_number(row.get(name)) for row in rows)}
    if _width(columns.values()) > width and 1 < len(rows) < len(names) and may_leave_out:
        turned = [[columns[name][at] for name in names] for at in range(len(rows) + 1)]
        if _width(turned) <= width:
            return _drawn(turned, set(range(1, len(turned))))
    if may_leave_out:
        _narrow(columns, [name for name in names[1:] if name not in numbers], width)
    left_out: list[str] = []
    while _width(columns.values()) > width and len(columns) > 1:
        if not may_leave_out:
            return []
        left_out.append(heads[(last := list(columns)[-1])])
        del columns[last]
    lines = _drawn(list(columns.values()), {at for at, name in enumerate(columns) if name in numbers})
    if left_out:
        lines.append(f"(and {', '.join(reversed(left_out))}: --json has all)")
    return lines


def _narrow(columns: dict[str, list[str]], names: Sequence[str], width: int) -> None:
    """Make columns of text narrower until the table fits, if possible: sentences and lists before names."""
    for name in names:
        if _width(columns.values()) > width:
            columns[name] = [re.sub(r"/(?:msg|srv|action)/", "/", cell) for cell in columns[name]]
    for name in sorted(names, key=lambda name: not any(" " in cell for cell in columns[name][1:])):
        too_wide = _width(columns.values()) - width
        if too_wide > 0:
            most = max(_NARROWEST, max(map(len, columns[name])) - too_wide)
            columns[name] = [_cut(cell, most) for cell in columns[name]]


def _width(columns: Any) -> int:
    return sum(max(map(len, column)) + 2 for column in columns) - 2


def _drawn(columns: Sequence[Sequence[str]], to_the_right: set[int]) -> list[str]:
    widths = [max(map(len, column)) for column in columns]
    lines: list[str] = []
    for cells in zip(*columns, strict=True):
        aligned = [
            cell.rjust(widths[at]) if at in to_the_right else cell.ljust(widths[at]) for at, cell in enumerate(cells)
        ]
        lines.append("  ".join(aligned).rstrip())
    return lines


def _pairs(values: Row) -> list[str]:
    """Return one value per line, in two columns."""
    named = [_with_unit(name, value) for name, value in values.items()]
    return _drawn([[name for name, _ in named], [text for _, text in named]], set())


def _beside(values: Row, width: int) -> list[str]:
    """Return values that need no line of their own, joined into lines."""
    return _wrapped([" ".join(_with_unit(name, value)) for name, value in values.items()], width, " · ")


def _with_unit(name: str, value: Any) -> tuple[str, str]:
    """Split the unit off the name: `elapsed_s`, 1.5 → "elapsed", "1.5 s"."""
    label, _, unit = _label(name).partition(" [")
    unit = ("s" if name in _SECONDS else unit.removesuffix("]")) if _is_number(value) else ""
    if unit == "bytes" and value >= _MEGABYTE:
        return label, f"{value / _MEGABYTE:.1f} MB"
    return label, f"{_text(value, _DIGITS)} {unit}".rstrip()


def _wrapped(words: Sequence[str], width: int, between: str) -> list[str]:
    lines = [""]
    for word in words:
        if lines[-1] and len(lines[-1]) + len(between) + len(word) > width:
            lines.append("")
        lines[-1] += (between if lines[-1] else "") + word
    return lines


# ── values ───────────────────────────────────────────────────────────────────────────────────────────────────────


def _paired(result: Row) -> dict[str, Any]:
    """Return a result with lists that are parallel to its messages, such as times of receipt, moved into
    the messages.
    """
    paired = dict(result)
    messages = result.get("messages")
    if not isinstance(messages, list) or not messages:
        return paired
    many = cast("list[Any]", messages)
    beside = {
        name: cast("list[Any]", value)
        for name, value in result.items()
        if name != "messages" and isinstance(value, list) and _runs_beside(cast("list[Any]", value), many)
    }
    if len(many) > 1 and all(isinstance(message, dict) for message in many):
        paired["messages"] = [
            {**{name: values[at] for name, values in beside.items()}, **message} for at, message in enumerate(many)
        ]
        for name in beside:
            del paired[name]
    return paired


def _runs_beside(values: list[Any], messages: list[Any]) -> bool:
    is_time = all(isinstance(value, (int, float)) or re.match(r"\d{4}-\d\d-\d\dT", str(value)) for value in values)
    return len(values) == len(messages) and is_time


def _flat(message: Row, prefix: str = "") -> dict[str, Any]:
    """Return the fields of a message by their paths."""
    flat: dict[str, Any] = {}
    for name, value in message.items():
        if isinstance(value, dict) and value and not _is_summarised(value):
            flat |= _flat(cast("Row", value), f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def _label(name: str) -> str:
    """Return the label of a field: `period_mean_s` → `period mean [s]`."""
    words = _on_one_line(name).split("_")
    unit = _UNITS.get(words[-1], "") if len(words) > 1 else ""
    return f"{' '.join(words[:-1])} [{unit}]" if unit else " ".join(words)


def _cell(value: Any, digits: int) -> str:
    return "" if _is_empty(value) else _cut(_text(value, digits), _CELL)


def _on_one_line(text: str) -> str:
    return text.replace("\n", "\\n")


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def _text(value: Any, cell_digits: int = 0) -> str:
    """Return a value on one line. With `cell_digits`, it is for a table: with so many digits, and without brackets."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return ("yes" if value else "no") if cell_digits else str(value).lower()
    if isinstance(value, float):
        is_short = cell_digits and abs(value) < 10**cell_digits
        return f"{value:.{cell_digits if is_short else _DIGITS_OF_FIELDS}g}"
    if isinstance(value, str):
        if cell_digits and (time := _ISO_TIME.fullmatch(value)):
            return time[1]
        return _on_one_line(value) or ("" if cell_digits else "''")
    if isinstance(value, list):
        inner = ", ".join(_text(item) for item in cast("list[Any]", value))
        return inner if cell_digits else f"[{inner}]"
    if isinstance(value, dict):
        row = cast("Row", value)
        if "$summary" in row:
            return _summarised(row)
        if set(row) == {"$diagonal"}:
            return f"diagonal {_text(row['$diagonal'])}"
        if _is_time(row):
            return f"{row['sec']}.{row['nanosec']:09d}"
        inner = ", ".join(f"{_on_one_line(name)}: {_text(below)}" for name, below in row.items())
        return inner if cell_digits else f"{{{inner}}}"
    return str(value)


def _summarised(row: Row) -> str:
    """Return a long array, of which the result has only bounds and the first values, on one line."""
    facts = [f"{name} {_text(below)}" for name, below in row.items() if _is_scalar(below) and name[0] not in "$l"]
    first = cast("list[Any]", row.get("first") or [])
    begins = [f"begins {', '.join(_text(item) for item in first[:_FIRST])}, …"] if first else []
    kind = str(row["$summary"]).removesuffix("[]")
    return ", ".join([f"{kind}[{row.get('length', '')}]", *facts, *begins])


def _is_summarised(value: Any) -> bool:
    return isinstance(value, dict) and "$summary" in value


def _is_scalar(value: Any) -> bool:
    return not isinstance(value, (list, dict))


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _is_empty(value: Any) -> bool:
    return value is None or (not value and isinstance(value, (str, list, dict)))


def _is_said(value: Any, said: str) -> bool:
    """Return whether all texts of a value are in the summary."""
    if isinstance(value, list) and value:
        return all(_is_said(item, said) for item in cast("list[Any]", value))
    if isinstance(value, dict) and value:
        return all(_is_empty(below) or _is_said(below, said) for below in cast("Row", value).values())
    return isinstance(value, str) and re.search(rf"(?<![\w/]){re.escape(value)}(?![\w/])", said) is not None


def _is_short(value: Any) -> bool:
    """Return whether a value is a few words that can share a line with others."""
    if isinstance(value, list):
        return len(cast("list[Any]", value)) <= _FEW and len(_text(value)) <= _CELL and "{" not in _text(value)
    return isinstance(value, dict) and _is_time(cast("Row", value))


def _has_rows(row: Row) -> bool:
    """Return whether a row contains tables or messages itself."""
    return any(
        (name in ("message", "messages") and isinstance(value, (list, dict)))
        or (isinstance(value, list) and any(isinstance(item, dict) for item in cast("list[Any]", value)))
        for name, value in row.items()
    )


def _is_time(row: Row) -> bool:
    return set(row) == {"sec", "nanosec"}


def _listed(value: Any) -> list[Any]:
    return cast("list[Any]", value) if isinstance(value, list) else [value]


def _indented(lines: Sequence[str]) -> list[str]:
    return [f"  {line}" if line else "" for line in lines]
