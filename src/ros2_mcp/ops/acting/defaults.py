"""List the fields that a value leaves out, with the defaults that were sent for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, cast

from ros2_mcp.model.text import in_quotes
from ros2_mcp.robot import MOTION_TYPES

if TYPE_CHECKING:
    from ros2_mcp.values.definitions import Definitions

_MOST_NAMED = 6
"""Fields that fill a line. A whole message has hundreds, and a client that leaves so many out knows it."""


def left_at_default(definitions: Definitions, type_name: str, value: Mapping[str, Any]) -> str:
    """Return a sentence on the fields of a known type that a value leaves out, with their
    defaults; empty if it has all.
    """
    from ros2_mcp.values.render import example_of  # with numpy: not before it is needed

    given = value
    example = example_of(definitions, type_name)
    if type_name in MOTION_TYPES and "header" in example:  # the bridge sets its stamp
        given = {**value, "header": {"stamp": None, **value.get("header", {})}}
    missing = list(_missing(example, given, ""))
    more = f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
    words = ", ".join(_in_words(path, default) for path, default in missing[:_MOST_NAMED])
    return f"Left at default: {words}{more}." if missing else ""


def _missing(example: Mapping[str, Any], given: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, default in example.items():
        if name not in given:
            yield prefix + name, default
        elif isinstance(default, dict) and isinstance(given[name], Mapping):
            yield from _missing(cast("dict[str, Any]", default), given[name], f"{prefix}{name}.")


def _in_words(path: str, default: Any) -> str:
    if not isinstance(default, (dict, list)) or not default:
        return f"{path} = {in_quotes(cast('object', default))}"
    set_ones = [f"{below} = {in_quotes(leaf)}" for below, leaf in _leaves(cast("Any", default), "") if leaf]
    return f"{path} ({', '.join([*set_ones[:3], 'the rest' if set_ones else 'all'])} zero)"


def _leaves(value: Any, path: str) -> Iterator[tuple[str, object]]:
    if isinstance(value, dict):
        for name, below in cast("dict[str, Any]", value).items():
            yield from _leaves(below, f"{path}.{name}" if path else name)
    elif isinstance(value, list):
        for index, below in enumerate(cast("list[Any]", value)):
            yield from _leaves(below, f"{path}[{index}]")
    else:
        yield path, value
