"""The definitions in a bag say the same as those they were made from."""

from __future__ import annotations

import pytest

from ros2_mcp.bags.schema import definitions_in, schema_text
from ros2_mcp.values.definitions import Definitions, DefinitionText

TEXTS = {
    "demo/msg/All": DefinitionText(
        "msg",
        'char LETTER=65\nstring NAME="it\'s"\nbool YES=true\nfloat64 PI=3.14\n'
        "std_msgs/Header header\nPoint[<=3] points  # where\nstring<=10[2] names ['a', 'b']\n"
        "char c\nwstring w\nfloat32 x 1.5\n",
    ),
    "demo/msg/Point": DefinitionText("msg", "float64 x\nfloat64 y\n"),
    "std_msgs/msg/Header": DefinitionText("msg", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    "demo/action/Go": DefinitionText("action", "int32 goal\n---\nbool done\n---\ndemo/Point where\n"),
}


def known() -> Definitions:
    definitions = Definitions()
    definitions.add(TEXTS)
    return definitions


def again(type_name: str) -> Definitions:
    """Definitions that know only what the schema's text says."""
    fresh = Definitions()
    fresh.add(definitions_in(type_name, "ros2msg", schema_text(known().interface(type_name))))
    return fresh


def fields(definitions: Definitions, type_name: str) -> list[tuple[str, str]]:
    named = [
        (field.name, str(field.type).replace("char", "uint8")) for field in definitions.structure(type_name).fields
    ]
    constants = [(constant.name, str(constant.value)) for constant in definitions.structure(type_name).constants]
    return named + constants


def test_a_message_keeps_fields_bounds_and_constants() -> None:
    fresh = again("demo/msg/All")
    for name in ("demo/msg/All", "demo/msg/Point", "std_msgs/msg/Header"):
        assert fields(fresh, name) == fields(known(), name)


def test_feedback_of_an_action_can_be_read_from_the_bag_alone() -> None:
    name = "demo/action/Go_FeedbackMessage"
    fresh = again(name)
    assert fields(fresh, name) == fields(known(), name)
    assert fields(fresh, "demo/action/Go_Feedback") == [("where", "demo/msg/Point")]


def test_texts_of_rosbag2_with_idl_parts_are_split() -> None:
    line = "=" * 80
    idl = "module demo { module msg { struct A { double x; }; }; };\n"
    text = f"{line}\nIDL: demo/msg/A\n{idl}{line}\nMSG: demo/B\nfloat64 y\n"
    found = definitions_in("demo/msg/A", "ros2idl", text)
    assert {name: each.format for name, each in found.items()} == {"demo/msg/A": "idl", "demo/msg/B": "msg"}


def test_a_type_without_fields_is_known_to_have_none() -> None:
    whole = Definitions()
    whole.add({"demo/msg/Nothing": DefinitionText("msg", "")})
    fresh = Definitions()
    fresh.add(definitions_in("demo/msg/Nothing", "ros2msg", schema_text(whole.interface("demo/msg/Nothing"))))
    assert not fresh.structure("demo/msg/Nothing").fields


def test_what_is_not_known_gives_nothing() -> None:
    assert definitions_in("demo/msg/A", "protobuf", "message A {}") == {}


SERVICE = "# Counts\ndemo/Point[] points\n---\nint32 count  # of them\nstring<=4 note\n"
POINT = f"{'=' * 80}\nMSG: demo/Point\nfloat64 x\nfloat64 y\n"


@pytest.mark.parametrize(
    "text",
    [
        f"{'=' * 80}\nSRV: demo/srv/Count\n{SERVICE}{POINT}",
        f"{SERVICE}{POINT}",
        "service_msgs/ServiceEventInfo info\n"
        "demo/srv/Count_Request[<=1] request\ndemo/srv/Count_Response[<=1] response\n"
        f"{POINT}{'=' * 80}\nMSG: demo/srv/Count_Request\ndemo/Point[] points\n"
        f"{'=' * 80}\nMSG: demo/srv/Count_Response\nint32 count\nstring<=4 note\n",
    ],
    ids=["rosbag2", "the file of the service", "the message itself"],
)
def test_the_events_of_a_service_are_known_in_each_form_in_which_recordings_have_them(text: str) -> None:
    fresh = Definitions()
    fresh.add(definitions_in("demo/srv/Count_Event", "ros2msg", text))
    assert fields(fresh, "demo/srv/Count_Event") == [
        ("info", "service_msgs/msg/ServiceEventInfo"),
        ("request", "demo/srv/Count_Request[<=1]"),
        ("response", "demo/srv/Count_Response[<=1]"),
    ]
    assert fields(fresh, "demo/srv/Count_Request") == [("points", "demo/msg/Point[]")]
    assert fields(fresh, "demo/srv/Count_Response") == [("count", "int32"), ("note", "string<=4")]
    assert not fresh.unknown_in("demo/srv/Count_Event")


def test_an_event_without_its_sides_defines_no_service() -> None:
    assert definitions_in("demo/srv/Count_Event", "ros2msg", "service_msgs/ServiceEventInfo info\n") == {}
