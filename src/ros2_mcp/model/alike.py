"""What differs in a list of objects that are much alike, such as the messages of a topic."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from typing import Any, cast


def differences(elements: Sequence[Any]) -> list[tuple[str, Sequence[Any]]] | None:
    """Path → values in each element, of what is not the same in all; None where the elements are no such objects.

    Paths are written as `pose.position.x` and `transforms[0].child_frame_id`.
    """
    if not elements or not all(isinstance(element, dict) for element in elements):
        return None
    found = list(_differing("", elements))
    return None if found and found[0][0] == "" else found  # different objects altogether


def written(value: Any) -> str:
    """As compact JSON text, which tells 0 from -0.0 and from false."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


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
    return len(set(map(written, values))) == 1


def _objects(value: Any) -> list[Any]:
    """The elements of a list of objects; of anything else nothing."""
    elements = cast("list[Any]", value) if isinstance(value, list) else []
    return elements if all(isinstance(element, dict) for element in elements) else []
