"""Numbers straight from the bytes are those that decoding gives, or it is left to decoding."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from ros2_mcp.model.interfaces import INTEGERS, FieldType
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check
from ros2_mcp.values.columns import ColumnReader
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import measurable, parse_field
from support.awkward import AWKWARD, COMMON

WORDS = ("", "a", "map", "base_link", "ä漢")


def made(definitions: Definitions, name: str, dice: random.Random, lengths: Sequence[int]) -> dict[str, Any]:
    """A message with random numbers; its lists and texts have some of these lengths."""

    def single(kind: FieldType) -> Any:
        if kind.is_message:
            return made(definitions, kind.base, dice, lengths)
        if kind.base in INTEGERS:
            least, most = INTEGERS[kind.base]
            return dice.choice((least, most, dice.randint(least, most)))
        if kind.base in ("string", "wstring"):
            return WORDS[dice.choice(lengths)][: kind.text_bound or None]
        if kind.base == "bool":
            return dice.random() < 0.5
        value = dice.choice((0.0, -0.0, 1.5, dice.gauss(0, 1e6)))
        return struct.unpack("f", struct.pack("f", value))[0] if kind.base == "float32" else value

    def value(kind: FieldType) -> Any:
        if kind.arity == "single":
            return single(kind)
        count = kind.size if kind.arity == "array" else min(dice.choice(lengths), kind.size or 9)
        return [single(kind.element) for _ in range(count)]

    fields = definitions.structure(name).fields
    return {field.name: value(field.type) for field in fields if "structure_needs" not in field.name}


def decoded(codec: Codec, name: str, path: Any, data: bytes) -> np.ndarray:
    return np.asarray(path.value_in(codec.decode(name, data)))


def assert_same(codec: Codec, name: str, paths: Sequence[Any], messages: Sequence[bytes], found: Any) -> None:
    for path, values in zip(paths, found, strict=True):
        assert len(values) == len(messages)
        for value, data in zip(values, messages, strict=True):
            expected = decoded(codec, name, path, data)
            assert np.array_equal(value, expected, equal_nan=expected.dtype.kind == "f"), (name, path.path)


def types_with_numbers(definitions: Definitions) -> Iterator[tuple[str, Sequence[Any]]]:
    for name in (*COMMON, *(name for name in AWKWARD if "/msg/" in name)):
        if paths := measurable(definitions, name):
            yield name, paths


def test_of_random_messages_of_all_types_the_values_are_those_of_decoding(codec: Codec) -> None:
    dice, read = random.Random(17), 0
    types = list(types_with_numbers(codec.definitions))
    for name, paths in types:
        reader = ColumnReader(codec.definitions, name, paths)
        for lengths in ((1,), (2,), (0, 3)):  # the third ones differ in length, too
            values = [made(codec.definitions, name, dice, lengths) for _ in range(4)]
            messages = [codec.encode(name, check(codec.definitions, name, value)) for value in values]
            found = reader.read(messages)
            if found is not None:
                read += 1
                assert_same(codec, name, paths, messages, found)
    assert read > 2 * len(types), "most have to be read without decoding"


def test_big_endian_messages_are_read(codec: Codec) -> None:
    store, dice = get_typestore(Stores.ROS2_JAZZY), random.Random(4)
    for name in ("sensor_msgs/msg/Imu", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/JointState"):
        paths = measurable(codec.definitions, name)
        value = check(codec.definitions, name, made(codec.definitions, name, dice, (3,)))
        little = codec.encode(name, value)
        big = bytes(store.serialize_cdr(store.deserialize_cdr(little, name), name, little_endian=False))
        found = ColumnReader(codec.definitions, name, paths).read([big, little, big])
        assert found is not None
        assert_same(codec, name, paths, [big, little, big], found)


@pytest.mark.parametrize("name", ["sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry", "odd_msgs/msg/Lists"])
def test_what_is_damaged_is_left_to_decoding_or_gives_the_same(codec: Codec, name: str) -> None:
    dice, paths = random.Random(name), measurable(codec.definitions, name)
    whole = codec.encode(name, check(codec.definitions, name, made(codec.definitions, name, dice, (3,))))
    read = 0
    for _ in range(400):
        damaged = bytearray(whole)
        damaged[dice.randrange(len(whole))] ^= 1 << dice.randrange(8)
        cut = bytes(damaged[: dice.choice((len(whole), dice.randrange(len(whole))))]) + bytes(dice.choice((0, 0, 2, 9)))
        found = ColumnReader(codec.definitions, name, paths).read([whole, cut])
        if found is not None:
            assert_same(codec, name, paths, [whole, cut], found)
            read += 1
    assert read, "what is damaged in a number is still read"


def test_of_messages_of_one_size_only_few_layouts_are_remembered(codec: Codec) -> None:
    name = "sensor_msgs/msg/JointState"
    paths = measurable(codec.definitions, name)
    values = [{"name": ["a" * length, "b" * (60 - length)], "position": [1.0]} for length in range(0, 60, 4)]
    messages = [codec.encode(name, check(codec.definitions, name, value)) for value in values]
    assert len({len(data) for data in messages}) == 1
    reader = ColumnReader(codec.definitions, name, paths)
    assert reader.read(messages) is None
    found = reader.read(messages[:3])
    assert found is not None
    assert_same(codec, name, paths, messages[:3], found)


@pytest.mark.parametrize("path", ["position[1]", "position[-1]", "position[0:2]", "position[::2]", "position[*]"])
def test_elements_are_picked_as_in_decoded_messages(codec: Codec, path: str) -> None:
    name = "sensor_msgs/msg/JointState"
    paths = [parse_field(codec.definitions, name, path)]
    values = [{"name": ["a", "bc", "d"], "position": [1.0, 2.0, at]} for at in (3.0, 4.0)]
    messages = [codec.encode(name, check(codec.definitions, name, value)) for value in values]
    found = ColumnReader(codec.definitions, name, paths).read(messages)
    assert found is not None
    assert_same(codec, name, paths, messages, found)


def test_an_element_that_is_not_there_and_fields_within_lists_are_left_to_decoding(codec: Codec) -> None:
    for name, path in (
        ("sensor_msgs/msg/JointState", "position[5]"),
        ("tf2_msgs/msg/TFMessage", "transforms[*].transform.translation.x"),
    ):
        paths = [parse_field(codec.definitions, name, path)]
        data = codec.encode(name, check(codec.definitions, name, {}))
        assert ColumnReader(codec.definitions, name, paths).read([data]) is None
