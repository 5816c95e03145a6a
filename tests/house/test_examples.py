"""The reference shows a call of every tool, with arguments that it has; docs/examples.py asks for the answers."""

import json
from pathlib import Path

from generate import served_tools

EXAMPLES = json.loads((Path(__file__).parents[2] / "docs/reference/examples.json").read_text("utf-8"))
WITHOUT = {"ros2_get_pointcloud_as_bev"}
"""No simulated robot publishes point clouds."""


def test_every_tool_has_an_example() -> None:
    assert {example["tool"] for example in EXAMPLES} == {tool.name for tool in served_tools()} - WITHOUT


def test_examples_give_arguments_that_their_tool_has() -> None:
    known = {tool.name: set(tool.input_schema["properties"]) for tool in served_tools()}
    required = {tool.name: set(tool.input_schema.get("required", ())) for tool in served_tools()}
    for example in EXAMPLES:
        assert required[example["tool"]] <= set(example["arguments"]) <= known[example["tool"]], example["tool"]
