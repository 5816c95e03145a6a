"""The types of messages as rclpy's classes describe them: fields and constants, as in a definition."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp_bridge.ros import interfaces
from ros2_mcp_common.language.field_types import FieldType, Single

# The syntax of types in `get_fields_and_field_types`: `sequence<double, 5>`, `float[36]`, `string<10>`.
_SEQUENCE = re.compile(r"sequence<(?P<base>.+?)(, (?P<size>\d+))?>")
_ARRAY = re.compile(r"(?P<base>.+)\[(?P<size>\d+)\]")
_TEXT = re.compile(r"(?P<base>w?string)(<(?P<bound>\d+)>)?")
_NAMES = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
"""The names of types that differ between generator and definitions; the generator writes `uint8` for a `char`."""
_CONSTANT = re.compile(r"[A-Z][A-Z0-9_]*")
# The generator adds one field to each empty message, which is in no definition.
_PLACEHOLDER = "structure_needs_at_least_one_member"


@dataclass(frozen=True)
class MessageField:
    """A field, as its class describes it."""

    name: str
    type: FieldType


class MessageTypes:
    """The types of one message class, such as `sensor_msgs.msg.LaserScan`, and of the messages
    in it; `name` is its type.
    """

    def __init__(self, message_class: Any) -> None:
        self.name = _type_of(message_class)
        self._classes: dict[str, Any] = {self.name: message_class}

    def fields(self, type_name: str) -> Mapping[str, MessageField]:
        """Return the fields of a message by name, in their order.

        Raises:
            OperationError: of kind `unknown_type`, for a type that cannot be imported.
        """
        message_class = self._class(type_name)
        found: dict[str, MessageField] = {}
        empty: Any = None
        for name, text in message_class.get_fields_and_field_types().items():
            if name == _PLACEHOLDER:
                continue
            field_type = _field_type(text)
            if field_type.is_message and field_type.arity == "single":
                empty = empty or message_class()
                inner = getattr(empty, name).__class__  # the parts of actions cannot be found by their names
                field_type = FieldType(_type_of(inner))
                self._classes[field_type.base] = inner
            found[name] = MessageField(name, field_type)
        return found

    def constants(self, type_name: str) -> Mapping[str, Single]:
        """Return the constants of a message; a `byte` is an integer."""
        named = cast("Mapping[str, Any]", self._class(type_name).__dict__)
        return {
            name: value[0] if isinstance(value, bytes) else value
            for name, value in named.items()
            if _CONSTANT.fullmatch(name) and isinstance(value, (bool, int, float, str, bytes))
        }

    def _class(self, type_name: str) -> Any:
        if type_name not in self._classes:
            self._classes[type_name] = interfaces.load(type_name)
        return self._classes[type_name]


def _type_of(message_class: Any) -> str:
    """Return the type of a class: `geometry_msgs/msg/Point` for `geometry_msgs.msg._point.Point`."""
    package, kind, *_ = message_class.__module__.split(".")
    return f"{package}/{kind}/{message_class.__name__}"


def _field_type(text: str) -> FieldType:
    if found := _SEQUENCE.fullmatch(text):
        element = _field_type(found["base"])
        return FieldType(element.base, "sequence", int(found["size"] or 0), element.text_bound)
    if found := _ARRAY.fullmatch(text):
        element = _field_type(found["base"])
        return FieldType(element.base, "array", int(found["size"]), element.text_bound)
    if found := _TEXT.fullmatch(text):
        return FieldType(found["base"], text_bound=int(found["bound"] or 0))
    package, slash, name = text.partition("/")
    return FieldType(f"{package}/msg/{name}" if slash else _NAMES.get(text, text))
