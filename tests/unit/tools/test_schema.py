from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import pytest
from pydantic import BaseModel, ConfigDict, Field

from ros2_mcp.tools.schema import argument_schema, result_schema


class Item(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: Annotated[str, Field(description="Its name.")]
    rate: Annotated[float | None, Field(gt=0, le=10)] = None


class Arguments(BaseModel):
    items: list[Item]
    limit: Annotated[int, Field(ge=1)] = 5
    type: str | None = None
    pattern: Annotated[str, Field(description="Which.")] = ""


class Union(BaseModel):
    value: int | str


@dataclass
class Inner:
    """Words for programmers."""

    value: float | None


@dataclass
class Outer:
    inner: list[Inner]
    free: dict[str, Any]


def inputs() -> dict[str, Any]:
    return argument_schema(Arguments.model_json_schema())


def outputs() -> dict[str, Any]:
    return result_schema(Outer)


def test_references_are_replaced_by_what_they_refer_to() -> None:
    item = inputs()["properties"]["items"]["items"]
    assert item["properties"]["name"] == {"type": "string", "description": "Its name."}
    assert "$defs" not in inputs() and "$defs" not in outputs()


def test_an_optional_argument_is_a_plain_one_that_keeps_its_bounds() -> None:
    rate = inputs()["properties"]["items"]["items"]["properties"]["rate"]
    assert rate == {"type": "number", "exclusiveMinimum": 0, "maximum": 10}


def test_defaults_are_kept_but_for_null_and_empty_text() -> None:
    assert inputs()["properties"]["limit"]["default"] == 5
    assert "default" not in inputs()["properties"]["type"]
    assert inputs()["properties"]["pattern"] == {"type": "string", "description": "Which."}


def test_arguments_are_closed_at_every_depth() -> None:
    assert inputs()["additionalProperties"] is False
    assert inputs()["properties"]["items"]["items"]["additionalProperties"] is False


def test_a_result_that_may_be_null_says_so() -> None:
    assert outputs()["properties"]["inner"]["items"]["properties"]["value"] == {
        "anyOf": [{"type": "number"}, {"type": "null"}]
    }


def test_an_object_of_any_shape_is_open() -> None:
    assert outputs()["properties"]["free"] == {"type": "object", "additionalProperties": True}


def test_docstrings_of_result_classes_stay_out_of_schemas() -> None:
    assert "description" not in outputs()["properties"]["inner"]["items"]


def test_a_property_may_be_called_title() -> None:
    class Titled(BaseModel):
        title: str

    assert argument_schema(Titled.model_json_schema())["properties"] == {"title": {"type": "string"}}


def test_a_union_that_not_every_client_accepts_is_refused_at_once() -> None:
    with pytest.raises(TypeError, match="union"):
        argument_schema(Union.model_json_schema())
