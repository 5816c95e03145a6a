"""Our codec against rclpy's own serialization, for every interface that is installed."""

import json
import math
import os
import random
import string
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser import definition as idl

from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions, DefinitionText
from ros2_mcp.values.render import RenderOptions, example_of, render

EXACT = RenderOptions(exact=True)
LIMITS = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
}
LETTERS = string.ascii_letters + "äß€漢字\n\t\"'\\"
SPECIAL_FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, 0.1)
ACTION_PARTS = {
    "_Goal": lambda action: action.Goal,
    "_Result": lambda action: action.Result,
    "_Feedback": lambda action: action.Feedback,
    "_FeedbackMessage": lambda action: action.Impl.FeedbackMessage,
    "_SendGoal_Request": lambda action: action.Impl.SendGoalService.Request,
    "_SendGoal_Response": lambda action: action.Impl.SendGoalService.Response,
    "_GetResult_Request": lambda action: action.Impl.GetResultService.Request,
    "_GetResult_Response": lambda action: action.Impl.GetResultService.Response,
}


def _prefixes() -> list[Path]:
    return [
        Path(prefix) for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix) if prefix
    ]


def _texts() -> dict[str, DefinitionText]:
    return {
        f"{path.parts[-3]}/{kind}/{path.stem}": DefinitionText(kind, path.read_text())
        for prefix in _prefixes()
        for kind in ("msg", "srv", "action")
        for path in prefix.glob(f"share/*/{kind}/*.{kind}")
    }


TEXTS = _texts()


def _classes_of(name: str) -> dict[str, type]:
    package, kind, short = name.split("/")
    whole = getattr(import_module(f"{package}.{kind}"), short)
    if kind == "msg":
        return {name: whole}
    if kind == "srv":
        return {f"{name}_Request": whole.Request, f"{name}_Response": whole.Response, f"{name}_Event": whole.Event}
    return {name + ending: part(whole) for ending, part in ACTION_PARTS.items()}


@pytest.fixture(scope="module")
def codec() -> Codec:
    definitions = Definitions()
    definitions.add(TEXTS)
    return Codec(definitions)


def _filled(cls: type, dice: random.Random) -> object:
    message = cls()
    for slot, kind in zip(cls.__slots__, cls.SLOT_TYPES, strict=False):
        if slot != "_check_fields" and not slot.endswith("structure_needs_at_least_one_member"):
            setattr(message, slot.removeprefix("_"), _value(kind, dice))
    return message


def _value(kind: object, dice: random.Random) -> object:
    if isinstance(kind, idl.Array):
        return _several(kind.value_type, kind.size, dice)
    if isinstance(kind, idl.BoundedSequence):
        return _several(kind.value_type, dice.randint(0, kind.maximum_size), dice)
    if isinstance(kind, idl.UnboundedSequence):
        return _several(kind.value_type, dice.choice((0, 1, 3, 70)) if _is_plain(kind) else dice.randint(0, 3), dice)
    if isinstance(kind, idl.NamespacedType):
        return _filled(_class(kind), dice)
    if isinstance(kind, idl.AbstractGenericString):
        most = kind.maximum_size // 3 if kind.has_maximum_size() else 12
        return "".join(dice.choices(LETTERS, k=dice.randint(0, most)))
    return _number(kind.typename, dice)


def _is_plain(kind: object) -> bool:
    return isinstance(kind.value_type, idl.BasicType)


def _several(kind: object, length: int, dice: random.Random) -> list[object]:
    return [_value(kind, dice) for _ in range(length)]


def _class(kind: object) -> type:
    package, group = kind.namespaces
    owner = kind.name if group == "msg" else kind.name.partition("_")[0]
    return _classes_of(f"{package}/{group}/{owner}")[f"{package}/{group}/{kind.name}"]


def _number(name: str, dice: random.Random) -> object:
    if name == "boolean":
        return dice.random() < 0.5
    if name == "octet":
        return bytes([dice.randrange(256)])
    if name in LIMITS:
        low, high = LIMITS[name]
        return dice.choice((low, high, 0, dice.randint(low, high)))
    value = dice.choice((*SPECIAL_FLOATS, dice.gauss(0, 1e6), dice.random()))
    return float(np.float32(value)) if name == "float" else value


def _same(one: object, other: object) -> bool:
    if hasattr(one, "get_fields_and_field_types"):
        return all(_same(getattr(one, name), getattr(other, name)) for name in one.get_fields_and_field_types())
    if isinstance(one, (str, bytes)) or not hasattr(one, "__len__"):
        return one == other or (isinstance(one, (float, np.floating)) and math.isnan(one) and math.isnan(other))
    return len(one) == len(other) and all(map(_same, one, other))


def _there_and_back(codec: Codec, name: str, data: bytes) -> bytes:
    """Their bytes → our message → JSON text → our message → our bytes."""
    shown = render(codec.definitions, name, codec.decode(name, data), options=EXACT)
    assert not shown.truncated
    text = json.dumps(shown.value, allow_nan=False)
    return codec.encode(name, check(codec.definitions, name, json.loads(text), partial=False))


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_every_installed_type_makes_the_round_trip(codec: Codec, name: str) -> None:
    dice = random.Random(name)
    for part, cls in _classes_of(name).items():
        for _ in range(4):
            sent = _filled(cls, dice)
            data = serialize_message(sent)
            ours = _there_and_back(codec, part, data)
            assert _same(sent, deserialize_message(ours, cls)), part
            assert codec.encode(part, codec.decode(part, data)) == ours
            assert len(ours) <= len(data)


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_every_installed_type_has_the_same_defaults(codec: Codec, name: str) -> None:
    for part, cls in _classes_of(name).items():
        example = example_of(codec.definitions, part)
        ours = codec.encode(part, check(codec.definitions, part, {}))
        assert _same(cls(), deserialize_message(ours, cls)), part
        assert codec.encode(part, check(codec.definitions, part, example)) == ours


@pytest.mark.parametrize("name", sorted(name for name in TEXTS if "/msg/" in name and not name.endswith("/WStrings")))
def test_every_installed_message_has_the_same_hash(codec: Codec, name: str) -> None:
    package, _, short = name.split("/")
    described = next(path for prefix in _prefixes() if (path := prefix / f"share/{package}/msg/{short}.json").exists())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(described.read_text())["type_hashes"]}
    assert codec.definitions.hash(name) == hashes[name]


@pytest.mark.parametrize("name", sorted(name for name in TEXTS if name.startswith("test_msgs/msg/")))
def test_the_idl_text_of_a_type_gives_the_same_codec(codec: Codec, name: str) -> None:
    package, _, short = name.split("/")
    definitions = Definitions()
    definitions.add({**TEXTS, name: DefinitionText("idl", _idl(package, short))})
    cls = _classes_of(name)[name]
    sent = _filled(cls, random.Random(name))
    ours = _there_and_back(Codec(definitions), name, serialize_message(sent))
    assert _same(sent, deserialize_message(ours, cls))


def _idl(package: str, short: str) -> str:
    paths = (prefix / f"share/{package}/msg/{short}.idl" for prefix in _prefixes())
    return next(path for path in paths if path.exists()).read_text()


@pytest.mark.parametrize("kind", ["uint8", "float32", "float64", "int64", "bool"])
def test_an_array_of_a_megabyte_makes_the_round_trip(codec: Codec, kind: str) -> None:
    name = "test_msgs/msg/UnboundedSequences"
    cls = _classes_of(name)[name]
    dtype = np.dtype(kind)
    values = np.random.default_rng(1).integers(0, 2**31, 2**20 // dtype.itemsize).astype(dtype)
    sent = cls(**{f"{kind}_values": values.tolist()})
    received = deserialize_message(_there_and_back(codec, name, serialize_message(sent)), cls)
    assert np.array_equal(np.array(getattr(received, f"{kind}_values")), values)
