"""Find the differences in a list of objects that are mostly equal, such as the messages of a topic."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from typing import Any, cast


def differences(elements: Sequence[Any]) -> list[tuple[str, Sequence[Any]]] | None:
    """Return path → values in each element, for values that differ; None unless the elements are similar objects.

    Paths look like `pose.position.x` and `transforms[0].child_frame_id`.
    """
    if not elements or not all(isinstance(element, dict) for element in elements):
        return None
    found = list(_differing("", elements))
    return None if found and found[0][0] == "" else found  # the objects have different keys


def written(value: Any) -> str:
    """Return compact JSON text, which distinguishes 0 from -0.0 and from false."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _differing(path: str, values: Sequence[Any]) -> Iterator[tuple[str, Sequence[Any]]]:
    """Yield the paths at which the values differ, with the values there; lists of numbers are compared as a whole."""
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
    """Return whether no key looks like a path below another path, as `a.b` does beside `a`."""
    return all(keys) and not any(key[:at] in keys for key in keys for at, sign in enumerate(key) if sign in ".[")


def _all_same(values: Sequence[Any]) -> bool:
    """Return whether the values have the same JSON text.

    Strings and integers, the most frequent, are compared directly.
    """
    first, kind = values[0], cast("type[Any]", type(values[0]))
    if kind in (str, int, bool, type(None)) or (kind in (list, dict) and not first):
        return all(type(value) is kind and value == first for value in values)
    return len(set(map(written, values))) == 1


def _objects(value: Any) -> list[Any]:
    """Return the elements of a list of objects; an empty list for any other value."""
    elements = cast("list[Any]", value) if isinstance(value, list) else []
    return elements if all(isinstance(element, dict) for element in elements) else []
