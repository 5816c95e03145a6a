import pytest

from ros2_mcp.model.errors import UnknownInterface
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions, DefinitionText

POINT_IDL = """
#include "odd_msgs/msg/Numbers.idl"
module geo {
  module msg {
    typedef double double__2[2];
    module Point_Constants { const long LIMIT = 7; };
    struct Point {
      double__2 xy;
      sequence<octet, 4> raw;
      wstring<3> label;
      odd_msgs::msg::Numbers numbers;
    };
  };
};
"""


def fields(definitions: Definitions, name: str) -> dict[str, str]:
    return {field.name: str(field.type) for field in definitions.structure(name).fields}


def test_an_interface_tells_fields_defaults_constants_and_comments(definitions: Definitions) -> None:
    numbers = definitions.interface("odd_msgs/msg/Numbers").sides["message"]
    assert numbers.comment == "Numbers of every kind."
    assert [(f.default, f.comment) for f in numbers.fields if f.name == "i64"] == [(-5, "with a default")]
    constants = definitions.interface("odd_msgs/msg/Words").sides["message"].constants
    assert [(c.name, c.type, c.value) for c in constants] == [
        ("RED", "uint8", 1), ("BLUE", "uint8", 16), ("NAME", "string", "x y"),
    ]  # fmt: skip
    assert constants[1].comment == "like the sea"


def test_types_are_shown_as_written_with_full_names(definitions: Definitions) -> None:
    assert fields(definitions, "odd_msgs/msg/Lists")["three"] == "float64[3]"
    assert fields(definitions, "odd_msgs/msg/Lists")["few"] == "int32[<=2]"
    assert fields(definitions, "odd_msgs/msg/Lists")["pair"] == "odd_msgs/msg/Numbers[2]"
    assert fields(definitions, "odd_msgs/msg/Texts")["narrow"] == "wstring<=3"


def test_defaults_of_lists_and_quoted_texts_are_read(definitions: Definitions) -> None:
    defaults = {field.name: field.default for field in definitions.structure("odd_msgs/msg/Lists").fields}
    assert defaults["three"] == (1.0, 2.5, -3.0)
    assert defaults["words"] == ("a, b", "c")
    assert definitions.structure("odd_msgs/msg/Texts").fields[0].default == "it's"


def test_the_listing_has_every_nested_type_once(definitions: Definitions) -> None:
    interface = definitions.interface("odd_msgs/msg/Outer")
    assert list(interface.nested) == ["odd_msgs/msg/Inner", "odd_msgs/msg/Deep", "odd_msgs/msg/Empty"]
    assert interface.text().splitlines() == [
        "odd_msgs/msg/Outer", "  odd_msgs/msg/Inner[] inner", "  odd_msgs/msg/Inner one",
        "odd_msgs/msg/Inner", "  odd_msgs/msg/Deep[] deep", "  string name",
        "odd_msgs/msg/Deep", "  float32[] values", "  odd_msgs/msg/Empty nothing",
        "odd_msgs/msg/Empty", "  (no fields)",
    ]  # fmt: skip


def test_services_and_actions_imply_their_types(definitions: Definitions) -> None:
    assert list(definitions.interface("odd_msgs/srv/Add").sides) == ["request", "response"]
    assert list(definitions.interface("odd_msgs/action/Drive").sides) == ["goal", "result", "feedback"]
    drive = "odd_msgs/action/Drive"
    assert fields(definitions, f"{drive}_SendGoal_Request") == {
        "goal_id": "unique_identifier_msgs/msg/UUID", "goal": f"{drive}_Goal",
    }  # fmt: skip
    assert fields(definitions, f"{drive}_SendGoal_Response") == {
        "accepted": "bool", "stamp": "builtin_interfaces/msg/Time",
    }  # fmt: skip
    assert fields(definitions, f"{drive}_GetResult_Response") == {"status": "int8", "result": f"{drive}_Result"}
    assert definitions.knows(f"{drive}_FeedbackMessage") and not definitions.knows(f"{drive}_Nonsense")


def test_an_action_alone_can_be_encoded() -> None:
    definitions = Definitions()
    definitions.add({"a_msgs/action/Go": DefinitionText("action", "int32 n\n---\n---\n")})
    name = "a_msgs/action/Go_SendGoal_Request"
    value = {"goal_id": {"uuid": list(range(16))}, "goal": {"n": 9}}
    assert Codec(definitions).encode(name, check(definitions, name, value))[4:] == bytes([*range(16), 9, 0, 0, 0])


def test_the_hash_is_the_one_on_the_wire(definitions: Definitions) -> None:
    assert definitions.hash("std_msgs/msg/String") == (
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )
    assert definitions.hash("odd_msgs/msg/Texts") == ""


def test_idl_texts_are_read(definitions: Definitions) -> None:
    definitions.add({"geo/msg/Point": DefinitionText("idl", POINT_IDL)})
    assert fields(definitions, "geo/msg/Point") == {
        "xy": "float64[2]", "raw": "byte[<=4]", "label": "wstring<=3", "numbers": "odd_msgs/msg/Numbers",
    }  # fmt: skip
    assert [(c.name, c.value) for c in definitions.structure("geo/msg/Point").constants] == [("LIMIT", 7)]
    with pytest.raises(UnknownInterface, match="the field x is a float128"):
        text = "module geo { module msg { struct Big { long double x; }; }; };"
        definitions.add({"geo/msg/Big": DefinitionText("idl", text)})
        definitions.structure("geo/msg/Big")


def test_a_changed_definition_replaces_the_old_one_everywhere(codec: Codec) -> None:
    definitions = codec.definitions
    before = codec.encode("odd_msgs/msg/Deep", check(definitions, "odd_msgs/msg/Deep", {"values": [1]}))
    definitions.add({"odd_msgs/msg/Empty": DefinitionText("msg", "int32 something 5")})
    after = codec.encode("odd_msgs/msg/Deep", check(definitions, "odd_msgs/msg/Deep", {"values": [1]}))
    assert after == before[:-1] + bytes([5, 0, 0, 0])


def test_nothing_is_parsed_before_it_is_asked_for() -> None:
    definitions = Definitions()
    definitions.add({"a/msg/Broken": DefinitionText("msg", "this is = no definition at all")})
    assert definitions.knows("a/msg/Broken")
    with pytest.raises(UnknownInterface, match="this is = no definition"):
        definitions.structure("a/msg/Broken")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("int32", "neither a field nor a constant"),
        ("int32 2x", "neither a field"),
        ("int32[ x", "not a type"),
        ("uint8 x 300", "out of range"),
        ("bool x maybe", "not a boolean"),
        ("int32[] x 5", "in brackets"),
        ("Missing x", "No definition of a/msg/Missing"),
        ("Thing x", "contains itself"),
        ("int32 x\nint32 x", "is not valid"),
        ("int32 __class__", "neither a field"),
    ],
)
def test_a_definition_that_cannot_be_used_says_why(text: str, problem: str) -> None:
    definitions = Definitions()
    definitions.add({"a/msg/Thing": DefinitionText("msg", text)})
    with pytest.raises(UnknownInterface, match=problem):
        definitions.compiled("a/msg/Thing")


@pytest.mark.parametrize("name", ["a/msg/X: pass\nimport os", "a/b/X", "X", "a/msg/X-Y", "a/msg/"])
def test_names_that_are_no_type_names_are_refused(name: str) -> None:
    with pytest.raises(UnknownInterface, match="not the full name"):
        Definitions().add({name: DefinitionText("msg", "int32 x")})


def test_an_unknown_type_suggests_the_nearest(definitions: Definitions) -> None:
    with pytest.raises(UnknownInterface) as caught:
        definitions.structure("geometry_msgs/msg/Twits")
    assert caught.value.hint == "Did you mean geometry_msgs/msg/Twist?"


def test_only_messages_that_begin_with_a_header_start_with_one(definitions: Definitions) -> None:
    assert definitions.starts_with_header("sensor_msgs/msg/LaserScan")
    assert not definitions.starts_with_header("geometry_msgs/msg/Twist")
    assert not definitions.starts_with_header("odd_msgs/msg/Empty")
