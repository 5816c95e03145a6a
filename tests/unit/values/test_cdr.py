import struct
from concurrent.futures import ThreadPoolExecutor

import pytest

from ros2_mcp.model.errors import BadData
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions, DefinitionText

HEADER = bytes([0, 1, 0, 0])
STRING = "std_msgs/msg/String"


def encoded(codec: Codec, name: str, value: object) -> bytes:
    return codec.encode(name, check(codec.definitions, name, value))


def test_bytes_are_little_endian_cdr_with_zero_padding(codec: Codec) -> None:
    data = encoded(codec, "odd_msgs/msg/Numbers", {"i8": -1, "u8": 2, "octet": 255, "letter": 65})
    assert data == HEADER + struct.pack("<bB6xqQf4xd?BB", -1, 2, -5, 0, 0.0, 1.5, True, 255, 65)


def test_an_octet_is_unsigned(codec: Codec) -> None:
    message = codec.decode("odd_msgs/msg/Numbers", encoded(codec, "odd_msgs/msg/Numbers", {"octet": 255}))
    assert message.octet == 255


def test_big_endian_is_read(codec: Codec) -> None:
    body = struct.pack(">bB6xqQf4xd?BB", -1, 2, -5, 2**63, 0.5, 1.5, True, 255, 65)
    message = codec.decode("odd_msgs/msg/Numbers", bytes(4) + body)
    assert (message.i64, message.u64, message.f32, message.octet) == (-5, 2**63, 0.5, 255)
    message = codec.decode(STRING, bytes(4) + struct.pack(">I3s", 3, b"ab\0"))
    assert message.data == "ab"


def test_wide_strings_are_utf_16_units_of_four_bytes(codec: Codec) -> None:
    value = {"free": "", "wide": "a😀", "many": ["é", ""]}
    data = encoded(codec, "odd_msgs/msg/Texts", value)
    wide = struct.pack("<IIII", 3, ord("a"), 0xD83D, 0xDE00)
    assert data == HEADER + struct.pack("<IB3xIB3x", 1, 0, 1, 0) + wide + struct.pack("<IIIII", 0, 2, 1, ord("é"), 0)
    message = codec.decode("odd_msgs/msg/Texts", data)
    assert (message.wide, message.many) == ("a😀", ["é", ""])


def test_an_empty_message_is_one_byte(codec: Codec) -> None:
    assert encoded(codec, "odd_msgs/msg/Empty", {}) == HEADER + b"\0"
    assert encoded(codec, "odd_msgs/srv/Ping_Request", {}) == HEADER + b"\0"
    codec.decode("odd_msgs/msg/Empty", HEADER + b"\0")


def test_text_that_is_not_utf_8_does_not_cost_the_message(codec: Codec) -> None:
    data = HEADER + struct.pack("<I5s", 5, b"20\xb0C\0")
    message = codec.decode(STRING, data)
    assert codec.encode(STRING, message) == data


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", "starts with nothing"),
        (bytes([0, 7, 0, 0, 1, 0, 0, 0, 0]), "starts with 00 07 00 00"),
        (HEADER, "ends before its last field"),
        (HEADER + struct.pack("<I", 9) + b"abc\0", "beyond the end"),
        (HEADER + struct.pack("<I", 4) + b"abcd", "does not end with a zero"),
        (HEADER + struct.pack("<I", 2) + b"a\0" + b"unexpected", "10 bytes are left over"),
    ],
)
def test_bytes_that_do_not_fit_say_why(codec: Codec, data: bytes, problem: str) -> None:
    with pytest.raises(BadData, match=f"not a std_msgs/msg/String.*{problem}"):
        codec.decode(STRING, data)


def test_a_huge_length_is_refused_without_reserving_memory(codec: Codec) -> None:
    with pytest.raises(BadData, match="ends before its last field"):
        codec.decode("odd_msgs/msg/Deep", HEADER + struct.pack("<I", 2**32 - 1))


def test_what_rclpy_appends_is_ignored(codec: Codec) -> None:
    data = encoded(codec, "sensor_msgs/msg/JointState", {"name": ["a"]})
    codec.decode("sensor_msgs/msg/JointState", data + b"garbage four")
    with pytest.raises(BadData, match="40 bytes are left over"):
        codec.decode("sensor_msgs/msg/JointState", data + b"x" * 40)


def test_field_names_that_are_python_words_keep_their_names(codec: Codec) -> None:
    message = codec.decode("odd_msgs/msg/Words", encoded(codec, "odd_msgs/msg/Words", {"from": "x", "class": 3}))
    assert [getattr(message, name) for name in ("from_", "class_", "lambda_")] == ["x", 3, 7]


def test_packages_with_the_same_short_names_stay_apart() -> None:
    definitions = Definitions()
    definitions.add({
        "a/msg/Pose": DefinitionText("msg", "Part part"), "a/msg/Part": DefinitionText("msg", "int8 x"),
        "b/msg/Pose": DefinitionText("msg", "Part part"), "b/msg/Part": DefinitionText("msg", "int16 y"),
    })  # fmt: skip
    codec = Codec(definitions)
    assert encoded(codec, "a/msg/Pose", {"part": {"x": 1}}) == HEADER + b"\1"
    assert encoded(codec, "b/msg/Pose", {"part": {"y": 1}}) == HEADER + b"\1\0"


def test_many_threads_may_decode_while_definitions_arrive(codec: Codec) -> None:
    names = [
        name for name in ("sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "odd_msgs/msg/Outer") for _ in "12"
    ]
    definitions = codec.definitions

    def work(name: str) -> None:
        for _ in range(20):
            codec.decode(name, codec.encode(name, check(definitions, name, {})))

    with ThreadPoolExecutor(len(names)) as pool:
        working = [pool.submit(work, name) for name in names]
        for number in range(50):
            definitions.add({"a/msg/New": DefinitionText("msg", f"int32 x{number}")})
        for each in working:
            each.result()
