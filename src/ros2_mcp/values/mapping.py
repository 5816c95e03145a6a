"""Make a message of one type from a message of another, by a mapping of fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, cast

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check
from ros2_mcp.values.select import parse_fields, value_at


class FieldMapping:
    """Makes messages of one type from messages of another; `mapping` is destination field → source field.

    Fields that are not mapped get their default. Nested messages and arrays can be mapped as a whole.

    Raises:
        BadInput: if the mapping is empty, or one destination lies inside another.
        BadValue: for a path that does not exist, or that goes into an array.
    """

    def __init__(self, codec: Codec, source_type: str, destination_type: str, mapping: Mapping[str, str]) -> None:
        self._codec = codec
        self._source_type = source_type
        self._destination_type = destination_type
        self._mapping = {to.strip(): origin.strip() for to, origin in mapping.items()}
        _check_paths(codec, destination_type, list(self._mapping))
        _check_paths(codec, source_type, list(self._mapping.values()))
        if not self._mapping:
            raise BadInput("The mapping is empty.", 'Give {"field of the destination": "field of the source"}.')
        for path in self._mapping:
            if any(other.startswith(f"{path}.") for other in self._mapping):
                raise BadInput(
                    f"The mapping gives {path} as a whole and a part of it.", "Map either the whole field or its parts."
                )
        self._map(check(codec.definitions, source_type, {}))  # mapping a default message reveals wrong types at once

    def apply(self, data: bytes) -> bytes:
        """Return the destination's message (CDR) for a message of the source.

        Raises:
            BadValue: for a value that does not fit the destination's field.
            BadData: if the bytes are not a message of the source's type.
        """
        return self._map(self._codec.decode(self._source_type, data))

    def _map(self, message: object) -> bytes:
        value: dict[str, Any] = {}
        for to, origin in self._mapping.items():
            *above, last = to.split(".")
            inside = value
            for part in above:
                inside = inside.setdefault(part, {})
            inside[last] = _plain(value_at(message, origin))
        checked = check(self._codec.definitions, self._destination_type, value)
        return self._codec.encode(self._destination_type, checked)


def _check_paths(codec: Codec, type_name: str, paths: list[str]) -> None:
    for selection in parse_fields(codec.definitions, type_name, paths):
        if "[" in selection.path or any(step.field.type.arity != "single" for step in selection.steps[:-1]):
            raise BadValue(selection.path, "elements of arrays cannot be mapped.", "Map the whole field.")


def _plain(value: Any) -> Any:
    """Convert a decoded value for `check`: messages become dicts."""
    if isinstance(value, list):
        return [_plain(item) for item in cast("list[Any]", value)]
    if is_dataclass(value):
        names = [field.name for field in fields(value) if not field.name.startswith("__")]
        return {name.rstrip("_"): _plain(getattr(value, name)) for name in names}
    return value
