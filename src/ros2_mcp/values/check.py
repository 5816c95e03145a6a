"""Convert JSON to message objects strictly: a value that does not fit its definition is rejected, with its path."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Mapping, Sequence
from struct import Struct
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import FLOATS, INTEGERS, OCTETS, TEXTS, Field, FieldType, Structure
from ros2_mcp.model.names import nearest, type_in_words
from ros2_mcp.model.text import excerpt, is_unicode
from ros2_mcp.model.values import DIAGONAL, EXACT_INTEGER, SUMMARY, is_covariance, not_finite_number
from ros2_mcp.values.definitions import Definitions

_FLOAT32 = Struct("<f")
_DECIMAL = re.compile(r"-?\d{1,20}", re.ASCII)
_BYTES_HINT = "Give bytes as a list of 0 to 255 or as base64."
_DTYPES: Mapping[str, type[np.generic]] = {
    "bool": np.bool_,
    "byte": np.uint8,
    "char": np.uint8,
    **{name: getattr(np, name) for name in (*FLOATS, *INTEGERS) if name not in ("byte", "char")},
}


def check(definitions: Definitions, type_name: str, value: object, *, partial: bool = True) -> object:
    """Convert a JSON value to a message of a type.

    Missing fields take the default of the definition, else zero; with `partial=False` they are an error. Also accepted:
    `"nan"`, `"inf"`, `"-inf"` (in any case, and `"-Infinity"`) for floating-point numbers; decimal strings for 64-bit
    integers; base64 or a list for bytes; `{"$diagonal": [...]}` for a square matrix; integers for floats, and integral
    floats for integers, where exact.

    Raises:
        BadValue: for any other value.
        UnknownInterface: if there is no definition of the type.
    """
    return _Check(definitions, partial).message(type_name, value, "")


def missing_fields(definitions: Definitions, type_name: str, value: object) -> list[str]:
    """Return the top-level fields that the value omits; fields whose type has no fields itself (Empty) do not count."""
    fields = _object(definitions.structure(type_name), value, "")

    def has_something(kind: FieldType) -> bool:
        return kind.arity != "single" or not kind.is_message or bool(definitions.structure(kind.base).fields)

    given = definitions.structure(type_name).fields
    return [field.name for field in given if field.name not in fields and has_something(field.type)]


class _Check:
    def __init__(self, definitions: Definitions, partial: bool) -> None:
        self._definitions = definitions
        self._partial = partial

    def message(self, type_name: str, value: object, path: str) -> object:
        structure = self._definitions.structure(type_name)
        fields = _object(structure, value, path)
        values = [
            self._value(field.type, fields[field.name], _below(path, field.name))
            if field.name in fields
            else self._missing(field, path)
            for field in structure.fields
        ]
        return self._definitions.message_class(type_name)(*values)

    def _missing(self, field: Field, path: str) -> Any:
        if not self._partial:
            raise BadValue(_below(path, field.name), f"is missing; {field.type} is expected.")
        if field.default is not None:
            return self._value(field.type, field.default, _below(path, field.name))
        return self._zero(field.type)

    def _zero(self, field_type: FieldType) -> Any:
        if field_type.arity == "single":
            return self._zero_element(field_type)
        length = field_type.size if field_type.arity == "array" else 0
        if field_type.is_message or field_type.base in TEXTS:
            return [self._zero_element(field_type) for _ in range(length)]
        return _zeros(field_type.base, length)

    def _zero_element(self, field_type: FieldType) -> Any:
        if field_type.is_message:
            return self.message(field_type.base, {}, "")
        return "" if field_type.base in TEXTS else _zeros(field_type.base, 1)[0].item()

    def _value(self, field_type: FieldType, value: object, path: str) -> Any:
        if field_type.arity != "single":
            return self._several(field_type, value, path)
        if field_type.is_message:
            return self.message(field_type.base, value, path)
        return _scalar(field_type, value, path)

    def _several(self, field_type: FieldType, value: object, path: str) -> list[Any] | NDArray[Any]:
        if field_type.base in OCTETS and isinstance(value, str):
            try:
                data = np.frombuffer(base64.b64decode(value, validate=True), np.uint8)
            except ValueError as error:
                raise BadValue(path, f"{excerpt(value)} is not base64.", _BYTES_HINT) from error
            _check_length(field_type, len(data), path)
            return data
        if (diagonal := _diagonal_in(value)) is not None:
            return _matrix(field_type, diagonal, path)
        values = _list(field_type, value, path)
        _check_length(field_type, len(values), path)
        if field_type.is_message or field_type.base in TEXTS:
            return [self._value(field_type.element, item, f"{path}[{index}]") for index, item in enumerate(values)]
        return _numbers(field_type, values, path)


def _object(structure: Structure, value: object, path: str) -> Mapping[str, object]:
    _refuse_summary(value, path)
    if not isinstance(value, Mapping):
        raise _wrong(path, value, f"an object with the fields of {type_in_words(structure.type)}")
    fields = cast("Mapping[str, object]", value)
    names = [field.name for field in structure.fields]
    for name in fields:
        if name not in names:
            near = nearest(str(name), names)
            hint = f"Did you mean {near}? " if near else ""
            hint += f"Its fields are {', '.join(names)}." if names else "It has no fields."
            raise BadValue(_below(path, str(name)[:80]), f"{type_in_words(structure.type)} has no such field.", hint)
    return fields


def _list(field_type: FieldType, value: object, path: str) -> Sequence[object]:
    _refuse_summary(value, path)
    if isinstance(value, np.ndarray):
        return cast("Sequence[object]", value.tolist())
    if isinstance(value, (list, tuple)):
        return cast("Sequence[object]", value)
    raise _wrong(path, value, str(field_type), _BYTES_HINT if field_type.base in OCTETS else "Give a list.")


def _check_length(field_type: FieldType, length: int, path: str) -> None:
    if field_type.arity == "array" and length != field_type.size:
        raise BadValue(path, f"{length} elements given; {field_type} takes exactly {field_type.size}.")
    if field_type.size and length > field_type.size:
        raise BadValue(path, f"{length} elements given; {field_type} takes at most {field_type.size}.")


def _below(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


# ── one primitive value, and lists of numbers ────────────────────────────────────────────────────────────────────


def _zeros(base: str, length: int) -> NDArray[Any]:
    """Return an array of zeros of a numeric type."""
    return np.zeros(length, _DTYPES[base])


def _scalar(field_type: FieldType, value: object, path: str) -> bool | int | float | str:
    """Return the value as the primitive type stores it.

    Raises:
        BadValue: naming `path`, if the value cannot be stored without loss.
    """
    _refuse_summary(value, path)
    if field_type.base == "bool":
        if not isinstance(value, bool):
            raise _wrong(path, value, "bool", "Write true or false, without quotes.")
        return value
    if field_type.base in INTEGERS:
        return _integer(field_type.base, value, path)
    if field_type.base in FLOATS:
        return _float(field_type.base, value, path)
    return _text(field_type, value, path)


def _numbers(field_type: FieldType, values: Sequence[Any], path: str) -> NDArray[Any]:
    """Convert a list to an array of the numeric type, or of booleans; raises `BadValue` as `_scalar` does.

    A list whose values have the same Python type is converted at once: images and clouds have millions of values.
    """
    kinds, base = set(map(type, values)), field_type.base
    if base in FLOATS and kinds <= {float, int} and (int not in kinds or _are_exact(values)):
        exact = np.array(values, np.float64)
        with np.errstate(over="ignore"):
            rounded = exact.astype(_DTYPES[base])
        if np.array_equal(np.isinf(rounded), np.isinf(exact)):
            return rounded
    if base in INTEGERS and kinds == {int} and INTEGERS[base][0] <= min(values) and max(values) <= INTEGERS[base][1]:
        return np.array(values, _DTYPES[base])
    scalars = [_scalar(field_type.element, value, f"{path}[{index}]") for index, value in enumerate(values)]
    return np.array(scalars, _DTYPES[base])


def _are_exact(values: Sequence[int | float]) -> bool:
    """Return whether all numbers are within the integers that a float64 stores exactly."""
    return max(map(abs, values)) <= EXACT_INTEGER


def _diagonal_in(value: object) -> object:
    """Return the diagonal from an object with only the key `$diagonal`; None for any other value."""
    if not isinstance(value, Mapping):
        return None
    fields = cast("Mapping[str, object]", value)
    return fields[DIAGONAL] if list(fields) == [DIAGONAL] else None


def _matrix(field_type: FieldType, diagonal: object, path: str) -> NDArray[Any]:
    """Return the square matrix, row by row, with this diagonal and 0 elsewhere.

    Raises `BadValue` as `_numbers` does.
    """
    is_matrix = is_covariance(path) and field_type.arity == "array" and field_type.is_number
    rows = math.isqrt(field_type.size) if is_matrix else 0
    if rows < 2 or rows * rows != field_type.size:
        raise BadValue(
            path, f"{DIAGONAL} stands for a square covariance matrix; {field_type} is expected.", "Give a list."
        )
    values = _list(FieldType(field_type.base, "array", rows), diagonal, path)
    if len(values) != rows:
        raise BadValue(path, f"{len(values)} elements given in {DIAGONAL}; {field_type} has {rows}.")
    matrix = _zeros(field_type.base, field_type.size)
    matrix[:: rows + 1] = _numbers(field_type, values, path)
    return matrix


def _refuse_summary(value: object, path: str) -> None:
    """Raise `BadValue` for a summary by which `render` replaced a value."""
    if isinstance(value, Mapping) and SUMMARY in value:
        raise BadValue(
            path,
            "this is a summary of a value that was too long to show, not the value itself.",
            "Read it in full (fields, max_array), or leave the field out to send its default.",
        )


def _wrong(path: str, value: object, expected: str, hint: str = "") -> BadValue:
    return BadValue(path, f"{excerpt(value)} given, {expected} expected.", hint)


def _integer(base: str, value: object, path: str) -> int:
    hint = "Write the number without quotes." if isinstance(value, str) else ""
    number: int | None = None
    if isinstance(value, int) and not isinstance(value, bool):
        number = value
    elif isinstance(value, float):
        if not value.is_integer():
            hint = "Round it to an integer."
        elif abs(value) > EXACT_INTEGER:
            hint = "Write integers beyond 2^53 in quotes; as numbers they are not exact."
        else:
            number = int(value)
    elif isinstance(value, str) and base.endswith("64") and _DECIMAL.fullmatch(value):
        number = int(value)
    if number is None:
        raise _wrong(path, value, base, hint)
    low, high = INTEGERS[base]
    if not low <= number <= high:
        raise _wrong(path, value, f"{base}, {low} to {high},")
    return number


def _float(base: str, value: object, path: str) -> float:
    named = not_finite_number(value) if isinstance(value, str) else None
    if isinstance(value, str) and named is None:
        raise _wrong(path, value, base, 'Write the number without quotes; only "nan", "inf" and "-inf" are strings.')
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise _wrong(path, value, base)
    try:
        number = float(value) if named is None else named
    except OverflowError:
        number = math.inf
    if isinstance(value, int) and number != value:
        hint = "Write it as a floating-point number, such as 1e17; this integer has no exact one."
        raise _wrong(path, value, base, hint)
    if base == "float32":
        try:
            _FLOAT32.pack(number)
        except OverflowError as error:
            raise _wrong(path, value, "float32, -3.4e38 to 3.4e38,") from error
    return number


def _text(field_type: FieldType, value: object, path: str) -> str:
    if not isinstance(value, str):
        raise _wrong(path, value, str(field_type), "Write it in quotes." if isinstance(value, (int, float)) else "")
    if not is_unicode(value):
        raise BadValue(path, f"{excerpt(value)} has half a character (a lone surrogate), which cannot be encoded.")
    if field_type.base == "string" and "\0" in value:  # a wstring may contain NUL: its length is stored
        raise BadValue(
            path, f"{excerpt(value)} contains a NUL character, where ROS would cut the text.", "Leave it out."
        )
    length = len(value.encode()) if field_type.base == "string" else len(value.encode("utf-16-le")) // 2
    if field_type.text_bound and length > field_type.text_bound:
        unit = "bytes" if field_type.base == "string" else "characters"
        raise BadValue(path, f"the text has {length} {unit}; {field_type} is expected.", "Shorten it.")
    return value
