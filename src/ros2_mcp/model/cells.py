"""Values on one line of a text, and rows of them as a table: nothing of the robot forges a line, or a column.

A text of the robot is bare only where it can be nothing but a name, else a JSON string.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from ros2_mcp.model.text import exact_json, is_name

NOTHING = "-"
"""What stands in the place of an empty value."""
_BETWEEN = " | "


class Exact(str):
    """The text of a cell as it is, such as JSON that is made visible already."""

    __slots__ = ()


def is_empty(value: Any) -> bool:
    """Whether it is nothing: null, an empty text, list or object. 0 and false are values."""
    return value is None or (isinstance(value, (str, Sequence, Mapping)) and not value)


def cell(value: Any) -> str:
    """A value on one line: a measured number as `short_number`, a list of texts with commas between them, an object
    as JSON.
    """
    if isinstance(value, Exact):
        return str(value)
    if is_empty(value):
        return NOTHING
    if isinstance(value, str):
        return value if is_name(value) and value != NOTHING else quoted_json(value)
    if isinstance(value, float):
        return short_number(value)
    if isinstance(value, (list, tuple)):
        items = cast("Sequence[Any]", value)
        if all(isinstance(item, str) for item in items):
            return ", ".join(map(cell, items))
    return exact_json(value)


def quoted_json(text: str) -> str:
    """A text of the robot as a JSON string, visible."""
    return exact_json(text)


def short_number(value: float) -> str:
    """A measured number as summaries have it: below 1 four digits, else thousandths."""
    return f"{value:.4g}" if abs(value) < 1 else f"{round(value, 3):.15g}"


def heading(name: str) -> str:
    """The name of a column; paths come from the robot."""
    return name if is_name(name) else quoted_json(name)


def table(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[str]:
    """A header, and a line for each row; nothing where there are no columns. Empty cells at the end are left out."""
    if not names:
        return []
    return [_BETWEEN.join(map(heading, names)), *(line([row[name] for name in names]) for row in rows)]


def line(cells: Sequence[Any]) -> str:
    """One row."""
    texts = [in_column(value) for value in cells]
    while len(texts) > 1 and texts[-1] == NOTHING:
        texts.pop()
    return _BETWEEN.join(texts)


def in_column(value: Any) -> str:
    """The text of a cell: no column begins within it."""
    return cell(value).replace("|", "\\u007c")  # within a JSON string, where alone it can be, this is the same


def told_apart(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[str]]:
    """The columns in which rows differ, and those that are equal in all; without those that are empty in all."""
    texts = [{name: in_column(value) for name, value in row.items()} for row in rows]
    names = [name for name in (texts[0] if texts else ()) if any(row[name] != NOTHING for row in texts)]
    if len(rows) < 2:
        return names, []
    shared = [name for name in names if all(row[name] == texts[0][name] for row in texts)]
    return [name for name in names if name not in shared], shared


def pairs(row: Mapping[str, Any], names: Sequence[str]) -> str:
    """`name: value` of each, with commas between them."""
    return ", ".join(f"{name}: {cell(row[name])}" for name in names)
