"""Definitions for the codec's tests: the common ones, and a package of awkward ones."""

import pytest
from rosbags.typesys import Stores, get_typestore

from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.definitions import Definitions, DefinitionText

AWKWARD = {
    "odd_msgs/msg/Numbers": """
# Numbers of every kind.

int8 i8
uint8 u8
int64 i64 -5        # with a default
uint64 u64
float32 f32
float64 f64 1.5
bool flag true
byte octet
char letter
""",
    "odd_msgs/msg/Lists": """
float64[3] three [1, 2.5, -3]
int32[<=2] few
uint8[] blob
uint8[16] id
bool[] flags
int64[] longs
string[] words ["a, b", 'c']
Numbers[] numbers
Numbers[2] pair
""",
    "odd_msgs/msg/Texts": """
string free "it's"
string<=5 short
wstring wide
wstring<=3 narrow
wstring[] many
""",
    "odd_msgs/msg/Words": """
string from
int32 class
uint8 RED=1
uint8 BLUE=0x10     # like the sea
string NAME='x y'
int32 lambda 7
""",
    "odd_msgs/msg/Empty": "",
    "odd_msgs/msg/Outer": "Inner[] inner\nInner one\n",
    "odd_msgs/msg/Inner": "odd_msgs/Deep[] deep\nstring name\n",
    "odd_msgs/msg/Deep": "float32[] values\nEmpty nothing\n",
    "odd_msgs/srv/Add": "int64 a\nint64 b\n---\nint64 sum\n",
    "odd_msgs/srv/Ping": "---\n",
    "odd_msgs/action/Drive": "Numbers target\n---\nbool arrived\n---\nfloat32 left\n",
}


def _common() -> dict[str, DefinitionText]:
    store = get_typestore(Stores.ROS2_JAZZY)
    names = [name for name in store.fielddefs if "/msg/" in name]
    return {name: DefinitionText("msg", store.gendefhash(name, {}, ros_version=2)[0]) for name in names}


COMMON = _common()


@pytest.fixture
def definitions() -> Definitions:
    result = Definitions()
    result.add(COMMON)
    result.add({name: DefinitionText(name.split("/")[1], text) for name, text in AWKWARD.items()})
    return result


@pytest.fixture
def codec(definitions: Definitions) -> Codec:
    return Codec(definitions)
