"""A result of any class of results, with something in every field: made from its types."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ros2_mcp.model.pictures import Picture

_ELEMENTS = 3
_PLAIN: Mapping[Any, Any] = {str: "some text", int: 3, float: 1 / 3, bool: True, Any: 0.25}


def made(kind: Any, name: str = "", number: int = 0) -> Any:
    """A value of that type; those with other numbers differ."""
    origin, options = get_origin(kind), get_args(kind)
    if kind is Picture:
        return Picture(data=b"data", mime="image/png", width=4, height=4, note="A picture.")
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        parts = {each.name: made(hints[each.name], each.name, number) for each in dataclasses.fields(kind) if each.init}
        return kind(**parts)  # type: ignore[operator]
    if origin is Literal:
        return options[number % len(options)]
    if origin in (Union, UnionType):
        return made(next(option for option in options if option is not NoneType), name, number)
    if origin in (list, tuple, Sequence):
        return [made(options[0], name, each) for each in range(_ELEMENTS)]
    if origin in (dict, Mapping):
        return {f"{name}_{each}": made(options[1], name, each) for each in range(_ELEMENTS)}
    value = _PLAIN[kind]
    if kind is str:
        return f"/{name}_{number}" if name.endswith(("name", "node", "topic")) else f"{name} {number}"
    return value + number if kind in (int, float) else value
