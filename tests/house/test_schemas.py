"""Schemas that every client accepts: what real MCP clients are known to refuse, as a lint over all tools."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from generate import served_tools
from mcp.types import Tool

from ros2_mcp.compose.server import assemble
from ros2_mcp.settings import Settings

TOOLS = served_tools()
MOST_TOOLS = 40
"""How many tools a model can choose among well."""
MOST_BYTES = 36_000
"""Of names, descriptions and input schemas of the default tools: every conversation begins with them."""

MOST_BYTES_OF_THE_LIST = 45_000
"""Of the answer to `tools/list`, with titles, annotations and hints for a client's search."""

MOST_CHARACTERS = 2_000
"""Of a description, and of the instructions: a leading client cuts them after 2,048."""

MOST_WORDS = 15
"""Of a hint for a client's search."""

Node = Mapping[str, Any]

every_tool = pytest.mark.parametrize("tool", TOOLS, ids=[tool.name for tool in TOOLS])


def nodes(schema: Node, path: str = "") -> Iterator[tuple[str, Node]]:
    """Every node of a schema with its path."""
    yield path, schema
    for name, part in schema.get("properties", {}).items():
        yield from nodes(part, f"{path}.{name}")
    for key in ("items", "additionalProperties"):
        if isinstance(schema.get(key), Mapping):
            yield from nodes(schema[key], f"{path}[]")
    for branch in schema.get("anyOf", ()):
        yield from nodes(branch, path)


def all_nodes(tool: Tool) -> list[tuple[str, Node]]:
    return [*nodes(tool.input_schema, "input"), *nodes(tool.output_schema or {}, "output")]


def types(node: Node) -> list[str]:
    """The types that a node may have: its own, or one of each branch of a union."""
    branches = [name for branch in node.get("anyOf", ()) for name in types(branch)]
    return [node["type"]] if isinstance(node.get("type"), str) else branches


@every_tool
def test_every_array_says_what_its_items_are(tool: Tool) -> None:
    untyped = [
        path for path, node in all_nodes(tool) if node.get("type") == "array" and not types(node.get("items", {}))
    ]
    assert untyped == []


@every_tool
def test_every_node_has_a_type(tool: Tool) -> None:
    known = {"string", "number", "integer", "boolean", "array", "object", "null"}
    assert [path for path, node in all_nodes(tool) if not types(node) or not known.issuperset(types(node))] == []


@every_tool
def test_every_object_says_what_is_in_it(tool: Tool) -> None:
    objects = [(path, node) for path, node in all_nodes(tool) if node.get("type") == "object"]
    assert [path for path, node in objects if "properties" not in node and not node.get("additionalProperties")] == []


@every_tool
def test_arguments_are_closed(tool: Tool) -> None:
    assert tool.input_schema["additionalProperties"] is False
    objects = [(path, node) for path, node in nodes(tool.input_schema, "input") if "properties" in node]
    assert [path for path, node in objects if node.get("additionalProperties") is not False] == []


@every_tool
def test_nothing_refers_to_elsewhere_and_no_argument_is_a_union(tool: Tool) -> None:
    forbidden = {"$ref", "$defs", "oneOf", "allOf", "not", "prefixItems", "patternProperties"}
    assert [path for path, node in all_nodes(tool) if forbidden & node.keys()] == []
    assert [path for path, node in nodes(tool.input_schema) if "anyOf" in node] == []


@every_tool
def test_no_argument_is_nullable(tool: Tool) -> None:
    """An optional argument is left out; clients that fill forms cannot send null."""
    assert [path for path, node in nodes(tool.input_schema, "input") if "null" in types(node)] == []


@every_tool
def test_property_names_are_plain(tool: Tool) -> None:
    names = [name for _, node in all_nodes(tool) for name in node.get("properties", {})]
    assert [name for name in names if not re.fullmatch(r"[a-zA-Z0-9_.-]{1,64}", name)] == []


@every_tool
def test_the_name_is_short_and_plain(tool: Tool) -> None:
    assert re.fullmatch(r"[a-zA-Z0-9_-]{1,40}", tool.name)


@every_tool
def test_the_result_is_an_object(tool: Tool) -> None:
    assert (tool.output_schema or {}).get("type") == "object"


@every_tool
def test_no_argument_and_no_field_is_called_robot(tool: Tool) -> None:
    """With several robots each tool takes the name of one by that name, and tells it so (`mcp/fleet/listing.py`)."""
    assert "robot" not in {**tool.input_schema["properties"], **(tool.output_schema or {}).get("properties", {})}


@every_tool
def test_required_names_are_declared(tool: Tool) -> None:
    objects = [(path, node) for path, node in all_nodes(tool) if "required" in node]
    assert [path for path, node in objects if not set(node["required"]) <= node["properties"].keys()] == []


@every_tool
def test_the_tool_and_every_argument_are_described(tool: Tool) -> None:
    assert tool.title and tool.description
    arguments = [(path, node) for path, node in nodes(tool.input_schema, "input") if re.search(r"\.\w+$", path)]
    assert [path for path, node in arguments if not node.get("description")] == []


@pytest.mark.promise("README", "Tools declare whether they read, write or can move the robot")
@every_tool
def test_the_annotations_say_whether_it_only_reads(tool: Tool) -> None:
    assert tool.annotations is not None
    assert tool.annotations.read_only_hint is not None
    assert tool.annotations.destructive_hint is not None
    assert not (tool.annotations.read_only_hint and tool.annotations.destructive_hint)


def test_tool_names_are_unique() -> None:
    names = [tool.name for tool in TOOLS]
    assert sorted(set(names)) == sorted(names)


def test_a_model_can_choose_among_the_tools_that_are_offered_by_default() -> None:
    listed = [tool.listed for tool in assemble(Settings()).toolset.by_name.values()]
    assert len(listed) <= MOST_TOOLS
    read = [{"name": tool.name, "description": tool.description, "inputSchema": tool.input_schema} for tool in listed]
    assert bytes_of(read) <= MOST_BYTES
    sent = [tool.model_copy(update={"output_schema": None}) for tool in listed]
    whole = [tool.model_dump(mode="json", by_alias=True, exclude_none=True) for tool in sent]
    assert bytes_of(whole) <= MOST_BYTES_OF_THE_LIST


def test_no_description_is_so_long_that_a_client_cuts_it() -> None:
    assert {
        tool.name: len(tool.description or "") for tool in TOOLS if len(tool.description or "") > MOST_CHARACTERS
    } == {}


@pytest.mark.parametrize("settings", [Settings(), Settings(read_only=True), Settings(tools=("core",))], ids=repr)
def test_the_instructions_are_not_so_long_that_a_client_cuts_them(settings: Settings) -> None:
    assert len(assemble(settings).server.instructions or "") <= MOST_CHARACTERS


@every_tool
def test_a_search_for_the_tool_goes_by_words_of_a_person(tool: Tool) -> None:
    words = str((tool.meta or {})["anthropic/searchHint"]).split()
    assert 3 <= len(words) <= MOST_WORDS


def test_what_is_always_needed_is_there_without_a_search() -> None:
    assert {tool.name for tool in TOOLS if (tool.meta or {}).get("anthropic/alwaysLoad")} == {"ros2_robot", "ros2_stop"}


@every_tool
def test_a_client_that_may_not_ask_can_read_and_stop(tool: Tool) -> None:
    """One runs nothing that says it deals with an open world, unless its user approves."""
    assert tool.annotations
    acts = not tool.annotations.read_only_hint and tool.name != "ros2_stop"
    assert tool.annotations.open_world_hint is acts


def bytes_of(value: object) -> int:
    return len(json.dumps(value, separators=(",", ":"), ensure_ascii=False).encode())
