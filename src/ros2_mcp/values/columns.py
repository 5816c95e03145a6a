"""Read the numbers of many messages at once from their bytes, without an object for each message and field.

The offset of a field depends only on the lengths of the strings and sequences before it. So one message is parsed to
find the offsets of its fields (its layout), which hold for all other messages of the same size with the same lengths.
Import this module inside functions only: it needs NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.interfaces import OCTETS, FieldType
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import FieldPath
from ros2_mcp.values.store import MessageStore
from ros2_mcp_common.language.paths import attribute

Values: TypeAlias = "NDArray[Any] | list[NDArray[Any]]"
"""Values of one field: a number per message, a row per message, or, if the rows differ in length, an array per
message."""
_BODY = 4
"""Offset of the body, from which alignment counts: after the header with the byte order."""
_PADDING = 3
"""Bytes that DDS appends. A message with more is decoded instead, which decides whether it is valid."""
_MOST_PARTS = 1000
"""Strings and nested messages of one message that are parsed."""
_MOST_LAYOUTS = 8
"""Most sizes in one batch, and most layouts of one size. Layouts are tried one after the other; beyond this many,
decoding is faster."""
_MOST_KNOWN = 64
_DTYPES = {
    "bool": "?",
    "float32": "f4",
    "float64": "f8",
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
    **dict.fromkeys(OCTETS, "u1"),
}


class _Unsuited(Exception):
    """Raised for a message or a type that has to be decoded."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Offsets of fields in messages that have the `expected` bytes at these `places`."""

    places: NDArray[np.intp]
    expected: NDArray[np.uint8]
    fields: Sequence[tuple[int, int, np.dtype[Any]]]
    """For each field its offset, its number of elements (-1: a single value), and the type of an element."""


class ColumnReader:
    """Reads chosen fields of messages of one type."""

    def __init__(self, definitions: Definitions, type_name: str, paths: Sequence[FieldPath]) -> None:
        self._definitions = definitions
        self._type = type_name
        self._paths = paths
        self._names = [".".join(step.field.name for step in path.steps) for path in paths]
        self._suits = definitions.is_cdr(type_name) and all(_suits(path) for path in paths)
        self._known: dict[tuple[bytes, int], list[_Layout]] = {}
        self._store: MessageStore | None = None

    def read(self, messages: Sequence[bytes]) -> list[Values] | None:
        """Return the values of each field in all messages; None if any message has to be decoded."""
        if not self._suits:
            return None
        store = self._definitions.compiled(self._type)
        if store is not self._store or len(self._known) > _MOST_KNOWN:  # a definition has changed, or sizes vary
            self._store, self._known = store, {}
        groups: dict[tuple[bytes, int], list[int]] = {}
        for row, data in enumerate(messages):
            groups.setdefault((data[:2], len(data)), []).append(row)
        if len(groups) > _MOST_LAYOUTS:
            return None
        found: list[tuple[NDArray[np.intp], list[NDArray[Any]]]] = []
        try:
            for (_, size), rows in groups.items():
                whole = np.frombuffer(b"".join([messages[row] for row in rows]), np.uint8).reshape(len(rows), size)  # pyright: ignore[reportUnknownMemberType]
                found += self._read_group(np.array(rows, np.intp), whole)
        except _Unsuited:
            return None
        return [_joined([(rows, values[number]) for rows, values in found]) for number in range(len(self._paths))]

    def _read_group(
        self, rows: NDArray[np.intp], whole: NDArray[np.uint8]
    ) -> list[tuple[NDArray[np.intp], list[NDArray[Any]]]]:
        """Return values of messages of equal size, and their row numbers, for each layout; raises `_Unsuited`."""
        known = self._known.setdefault((whole[0, :2].tobytes(), whole.shape[1]), [])
        found: list[tuple[NDArray[np.intp], list[NDArray[Any]]]] = []
        for number in range(_MOST_LAYOUTS):
            if number == len(known):
                known.append(self._walk(whole[0].tobytes()))
            layout = known[number]
            fits = (whole[:, layout.places] == layout.expected).all(1)
            if fits.any():
                of_these = whole if fits.all() else whole[fits]
                values = [self._values(path, of_these, *place) for path, place in self._placed(layout)]
                found.append((rows[fits], values))
                rows, whole = rows[~fits], whole[~fits]
            if not len(rows):
                return found
        raise _Unsuited

    def _placed(self, layout: _Layout) -> zip[tuple[FieldPath, tuple[int, int, np.dtype[Any]]]]:
        return zip(self._paths, layout.fields, strict=True)

    def _values(
        self, path: FieldPath, whole: NDArray[np.uint8], offset: int, count: int, kind: np.dtype[Any]
    ) -> NDArray[Any]:
        end = offset + abs(count) * kind.itemsize
        values = np.ascontiguousarray(whole[:, offset:end]).view(kind) if count else np.zeros((len(whole), 0), kind)  # pyright: ignore[reportUnknownMemberType]
        pick = path.steps[-1].pick
        if count < 0:
            return values[:, 0] != 0 if path.type.base == "bool" else values[:, 0]
        if isinstance(pick, int):
            if not -count <= pick < count:
                raise _Unsuited
            return values[:, pick]
        return values[:, pick] if isinstance(pick, slice) else values

    def _walk(self, data: bytes) -> _Layout:
        """Return the layout of a message; raises `_Unsuited`."""
        if len(data) < _BODY or data[0] or data[1] > 1:
            raise _Unsuited
        walk = _Walk(data, self._definitions)
        walk.message(self._type, "")
        if walk.place > len(data) or len(data) - walk.place > _PADDING:
            raise _Unsuited
        places = np.array(walk.fixed, np.intp)
        return _Layout(places, np.frombuffer(data, np.uint8)[places], [walk.found[name] for name in self._names])


class ExcerptReader:
    """Turns each message into an object with only some of its fields, single numbers, without decoding the rest.

    `suits` is whether all the fields are single numbers.
    """

    def __init__(self, definitions: Definitions, type_name: str, paths: Sequence[FieldPath]) -> None:
        self.suits = definitions.is_cdr(type_name) and all(
            _suits(path) and path.steps[-1].pick is None and not path.is_list for path in paths
        )
        self._reader = ColumnReader(definitions, type_name, paths)
        self._places: _Tree = {}
        for number, path in enumerate(paths):
            branch = self._places
            *before, last = (attribute(step.field.name) for step in path.steps)
            for name in before:
                inner = branch.setdefault(name, {})
                assert isinstance(inner, dict), "a number has no fields"
                branch = inner
            branch[last] = number

    def read(self, messages: Sequence[bytes]) -> Sequence[object] | None:
        """Return the objects; None if any message has to be decoded."""
        if not self.suits or (columns := self._reader.read(messages)) is None:
            return None
        return self._made(self._places, [np.asarray(column).tolist() for column in columns])

    def _made(self, places: _Tree, columns: Sequence[list[Any]]) -> list[object]:
        below = [columns[place] if isinstance(place, int) else self._made(place, columns) for place in places.values()]
        return [SimpleNamespace(**dict(zip(places, row, strict=True))) for row in zip(*below, strict=True)]


_Tree: TypeAlias = "dict[str, _Tree | int]"
"""For each field the fields below it, or the number of its column."""


@dataclass
class _Walk:
    """A pass through one message: the fields `found`, by path, and the offsets of bytes that determine the layout."""

    data: bytes
    definitions: Definitions
    place: int = _BODY
    parts: int = 0
    fixed: list[int] = field(default_factory=list[int])
    found: dict[str, tuple[int, int, np.dtype[Any]]] = field(
        default_factory=dict[str, "tuple[int, int, np.dtype[Any]]"]
    )

    def message(self, type_name: str, prefix: str) -> None:
        """Parse a nested message; its fields have paths that begin with `prefix`."""
        for part in self.definitions.structure(type_name).fields:
            self._field(part.type, prefix + part.name)

    def _field(self, kind: FieldType, path: str) -> None:
        count = {"single": -1, "array": kind.size, "sequence": 0}[kind.arity]
        if kind.arity == "sequence":
            count = self._length()
        if kind.is_message or kind.base == "string":
            for number in range(abs(count)):
                self.parts += 1
                if self.parts > _MOST_PARTS:
                    raise _Unsuited
                if kind.is_message:
                    self.message(kind.base, f"{path}." if count < 0 else f"{path}.{number}.")
                else:
                    self._text()
        elif kind.base == "wstring":
            raise _Unsuited
        else:
            order = "<" if self.data[1] else ">"
            dtype = np.dtype(order + _DTYPES[kind.base])
            if count:
                self._align(dtype.itemsize)
            self.found[path] = self.place, count, np.dtype("u1") if kind.base == "bool" and count < 0 else dtype
            self.place += abs(count) * dtype.itemsize

    def _align(self, size: int) -> None:
        self.place += -(self.place - _BODY) % size

    def _length(self) -> int:
        """Read the length of a string or sequence."""
        self._align(4)
        end = self.place + 4
        if end > len(self.data):
            raise _Unsuited
        length = int.from_bytes(self.data[self.place : end], "little" if self.data[1] else "big")
        if length > len(self.data):
            raise _Unsuited
        self.fixed += range(self.place, end)
        self.place = end
        return length

    def _text(self) -> None:
        """Skip a string, which ends with a zero byte unless it is empty."""
        length = self._length()
        self.place += length
        if self.place > len(self.data) or (length and self.data[self.place - 1]):
            raise _Unsuited
        self.fixed += [self.place - 1] * bool(length)


def _suits(path: FieldPath) -> bool:
    """Return whether the path leads through single messages to a number, or to an array or a slice of numbers."""
    *before, last = path.steps
    is_direct = all(step.pick is None and step.type.arity == "single" for step in before)
    is_number = last.field.type.is_number or last.field.type.base == "bool"
    return is_direct and is_number and (last.pick is None or isinstance(last.pick, (int, slice)))


def _joined(parts: Sequence[tuple[NDArray[np.intp], NDArray[Any]]]) -> Values:
    """Put the values of groups of messages in the order of the messages."""
    if len(parts) == 1:
        return parts[0][1]
    if len({values.shape[1:] for _, values in parts}) == 1:
        whole = np.concatenate([values for _, values in parts])
        ordered = np.empty_like(whole)
        ordered[np.concatenate([rows for rows, _ in parts])] = whole
        return ordered
    by_row = {int(row): value for rows, values in parts for row, value in zip(rows, values, strict=True)}
    return [by_row[row] for row in range(len(by_row))]
