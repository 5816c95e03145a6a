"""Definitions are made of what a node describes, also where it was built without their texts."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from ros2_mcp.robot.described import definitions_of

HEADER = "std_msgs/msg/Header"


def individual(name: str, **fields: Mapping[str, object]) -> dict[str, object]:
    """An IndividualTypeDescription, with 0 or empty for what is not given of a field's type."""
    rest = {"capacity": 0, "string_capacity": 0, "nested_type_name": ""}
    return {"type_name": name, "fields": [{"name": field, "type": {**rest, **told}} for field, told in fields.items()]}


@pytest.mark.parametrize(
    ("told", "written"),
    [
        ({"type_id": 11}, "float64"),
        ({"type_id": 3 + 48, "capacity": 16}, "uint8[16]"),
        ({"type_id": 17 + 96, "capacity": 3}, "string[<=3]"),
        ({"type_id": 21 + 144, "string_capacity": 10}, "string<=10[]"),
        ({"type_id": 1, "nested_type_name": HEADER}, HEADER),
        ({"type_id": 1 + 144, "nested_type_name": HEADER}, f"{HEADER}[]"),
    ],
)
def test_each_kind_of_field_is_written_as_in_a_definition(told: Mapping[str, object], written: str) -> None:
    found = definitions_of([individual("odd_msgs/msg/One", value=told)])
    assert found["odd_msgs/msg/One"].text == f"{written} value\n"


def test_a_message_without_fields_has_none_and_one_with_a_field_of_idl_is_left_out() -> None:
    empty = individual("odd_msgs/msg/Empty", structure_needs_at_least_one_member={"type_id": 3})
    strange = individual("odd_msgs/msg/Strange", wide={"type_id": 12}, small={"type_id": 2})
    found = definitions_of([empty, strange])
    assert {name: each.text for name, each in found.items()} == {"odd_msgs/msg/Empty": ""}


def test_the_event_of_a_service_tells_the_service() -> None:
    parts = [
        individual(
            "odd_msgs/srv/Ask_Event", info={"type_id": 1, "nested_type_name": "service_msgs/msg/ServiceEventInfo"}
        ),
        individual("odd_msgs/srv/Ask_Request", question={"type_id": 17}),
        individual("odd_msgs/srv/Ask_Response", answer={"type_id": 6}),
    ]
    found = definitions_of(parts)
    assert {name: (each.format, each.text) for name, each in found.items()} == {
        "odd_msgs/srv/Ask": ("srv", "string question\n---\nint32 answer\n")
    }
