"""Format values on one line, and rows as a table, such that text from the robot cannot forge a line or a column.

Text from the robot is written without quotes only if it can only be a name; otherwise it is a JSON string.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from ros2_mcp.model.text import exact_json, is_name

NOTHING = "-"
"""Placeholder for an empty value."""
_BETWEEN = " | "


class Exact(str):
    """The text of a cell, written unchanged, such as JSON that is escaped already."""

    __slots__ = ()


def is_empty(value: Any) -> bool:
    """Return whether a value is null or an empty string, list or object. 0 and false are values."""
    return value is None or (isinstance(value, (str, Sequence, Mapping)) and not value)


def cell(value: Any) -> str:
    """Format a value on one line.

    A float is formatted by `short_number`, a list of strings with commas, an object as JSON.
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
    """Return a text of the robot as a JSON string, with hidden characters escaped."""
    return exact_json(text)


def short_number(value: float) -> str:
    """Format a measured number: below 1 with four digits, else with three decimals."""
    return f"{value:.4g}" if abs(value) < 1 else f"{round(value, 3):.15g}"


def heading(name: str) -> str:
    """Return the name of a column, quoted if necessary; paths come from the robot."""
    return name if is_name(name) else quoted_json(name)


def table(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[str]:
    """Return a header, and a line for each row; empty without columns. Empty cells at the end of a line are omitted."""
    if not names:
        return []
    return [_BETWEEN.join(map(heading, names)), *(line([row[name] for name in names]) for row in rows)]


def line(cells: Sequence[Any]) -> str:
    """Format one row."""
    texts = [in_column(value) for value in cells]
    while len(texts) > 1 and texts[-1] == NOTHING:
        texts.pop()
    return _BETWEEN.join(texts)


def in_column(value: Any) -> str:
    """Return the text of a cell, without a column separator."""
    return cell(value).replace("|", "\\u007c")  # equivalent in a JSON string, where alone `|` can occur


def told_apart(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[str]]:
    """Return the columns in which rows differ, and the columns equal in all rows.

    Columns that are empty in all are omitted.
    """
    texts = [{name: in_column(value) for name, value in row.items()} for row in rows]
    names = [name for name in (texts[0] if texts else ()) if any(row[name] != NOTHING for row in texts)]
    if len(rows) < 2:
        return names, []
    shared = [name for name in names if all(row[name] == texts[0][name] for row in texts)]
    return [name for name in names if name not in shared], shared


def pairs(row: Mapping[str, Any], names: Sequence[str]) -> str:
    """Return `name: value` of each column, separated by commas."""
    return ", ".join(f"{name}: {cell(row[name])}" for name in names)
