"""Lists of objects that are much alike, such as the messages of a topic, written once and then by what changes."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from typing import Any, cast

MAX_COLUMNS = 12
"""More values in a row than these and a reader loses count of which is which: then each has its path beside it."""
EXPLAINED = (
    'Lists in short, without loss: "first" is whole, "rows" are the further ones at "columns" (or "changes"), '
    'else exactly as the first; "same" is how many further ones equal the first in every field.'
)
"""What is said where one of these forms was chosen."""


def brief(elements: Sequence[Any]) -> dict[str, Any] | None:
    """The first of some objects whole and of each further one what differs; None where that is no shorter.

    What differs in any of them is a column, named by its path (`pose.position.x`, `transforms[0].child_frame_id`), and
    every further element a row. Where there are more columns than `MAX_COLUMNS`, it is an object: path → value.
    """
    if len(elements) < 2 or not all(isinstance(element, dict) for element in elements):
        return None
    columns = list(_differing("", elements))
    if not columns or columns[0][0] == "":  # all the same, or different objects altogether
        found: dict[str, Any] = {} if columns else {"first": elements[0], "same": len(elements) - 1}
    elif len(columns) <= MAX_COLUMNS:
        rows = zip(*(values[1:] for _, values in columns), strict=True)
        found = {"first": elements[0], "columns": [path for path, _ in columns], "rows": [list(row) for row in rows]}
    else:
        written = {path: [_written(value) for value in values] for path, values in columns}
        changes = [
            {path: values[index] for path, values in columns if written[path][index] != written[path][0]}
            for index in range(1, len(elements))
        ]
        found = {"first": elements[0], "changes": changes}
    return found if found and len(_written(found)) < len(_written(elements)) else None


def _differing(path: str, values: Sequence[Any]) -> Iterator[tuple[str, Sequence[Any]]]:
    """The paths below which the values are not all the same, with the values there; lists of numbers stay whole."""
    first, is_list = values[0], isinstance(values[0], list)
    lists = [_objects(value) for value in (values if is_list else ())]
    if all(isinstance(value, dict) and value.keys() == first.keys() for value in values) and _are_clear(first):
        for key in cast("dict[str, Any]", first):
            yield from _differing(f"{path}.{key}" if path else key, [value[key] for value in values])
    elif lists and lists[0] and all(len(objects) == len(lists[0]) for objects in lists):
        for index, elements in enumerate(zip(*lists, strict=True)):
            yield from _differing(f"{path}[{index}]", elements)
    elif not _all_same(values):
        yield path, values


def _are_clear(keys: Collection[str]) -> bool:
    """Whether no key looks like a path below another one, as `a.b` does beside `a`."""
    return all(keys) and not any(key[:at] in keys for key in keys for at, sign in enumerate(key) if sign in ".[")


def _all_same(values: Sequence[Any]) -> bool:
    """Whether values are written alike; texts and whole numbers, which are most, need not be written for that."""
    first, kind = values[0], cast("type[Any]", type(values[0]))
    if kind in (str, int, bool, type(None)) or (kind in (list, dict) and not first):
        return all(type(value) is kind and value == first for value in values)
    return len(set(map(_written, values))) == 1


def _objects(value: Any) -> list[Any]:
    """The elements of a list of objects; of anything else nothing."""
    elements = cast("list[Any]", value) if isinstance(value, list) else []
    return elements if all(isinstance(element, dict) for element in elements) else []


def _written(value: Any) -> str:
    """As JSON text, which tells 0 from -0.0 and from false."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))
