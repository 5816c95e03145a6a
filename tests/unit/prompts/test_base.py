"""The base prompts: what the contract promises, and calls that the tools accept as they are written."""

from __future__ import annotations

import re
from typing import Any

import jsonschema
import pytest
from generate import served_tools

from ros2_mcp.compose.server import Assembly, assemble
from ros2_mcp.model.errors import BadInput
from ros2_mcp.prompts.base import base_prompts
from ros2_mcp.prompts.prompt import Prompt
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from support.prompt_steps import steps_of

CONTRACT: dict[str, dict[str, Any]] = {
    "base.ros2-topic-echo-and-analyze": {"topic_name": "", "duration_sec": 5.0, "analysis_type": "all"},
    "base.ros2-topic-relay": {
        "source_topic": None,
        "destination_topic": None,
        "message_type": "",
        "transform": "identity",
        "target_rate_hz": 10.0,
        "duration_sec": 60.0,
    },
    "base.ros2-node-health-check": {
        "expected_topics": [],
        "expected_services": [],
        "check_rates": True,
        "rate_check_duration_sec": 3.0,
        "min_expected_rate_hz": 1.0,
    },
    "base.ros2-topic-diff-monitor": {
        "topic1_name": None,
        "topic2_name": None,
        "duration_sec": 5.0,
        "diff_fields": [],
        "tolerance_percent": 0.1,
        "sync_by_timestamp": True,
    },
    "base.ros2-navigation-check": {"to": ""},
}
NEEDED = {
    "base.ros2-topic-echo-and-analyze": {"topic_name": "/imu"},
    "base.ros2-topic-relay": {"source_topic": "/imu", "destination_topic": "/imu_slow"},
    "base.ros2-node-health-check": {},
    "base.ros2-topic-diff-monitor": {"topic1_name": "/imu", "topic2_name": "/imu_slow"},
    "base.ros2-navigation-check": {},
}
LEAST_AND_MOST = [
    ("base.ros2-topic-echo-and-analyze", {"duration_sec": "0.1", "analysis_type": "statistics"}),
    ("base.ros2-topic-echo-and-analyze", {"duration_sec": "600", "analysis_type": "rate"}),
    ("base.ros2-topic-echo-and-analyze", {"analysis_type": "message_count"}),
    ("base.ros2-topic-relay", {"transform": "rate_limit", "target_rate_hz": "0.01", "duration_sec": "0"}),
    ("base.ros2-topic-relay", {"transform": "rate_limit", "target_rate_hz": "1000", "duration_sec": "86400"}),
    ("base.ros2-topic-relay", {"transform": "filter", "message_type": "sensor_msgs/Imu", "duration_sec": "0.1"}),
    ("base.ros2-topic-relay", {"transform": "on_change"}),
    (
        "base.ros2-node-health-check",
        {
            "expected_topics": "/imu, /scan",
            "expected_services": "['/reset']",
            "check_rates": "False",
            "rate_check_duration_sec": "0.5",
            "min_expected_rate_hz": "0",
        },
    ),
    ("base.ros2-node-health-check", {"rate_check_duration_sec": "60", "min_expected_rate_hz": "1000"}),
    (
        "base.ros2-topic-diff-monitor",
        {"duration_sec": "0.1", "diff_fields": "a.b, c", "tolerance_percent": "0", "sync_by_timestamp": "false"},
    ),
    ("base.ros2-topic-diff-monitor", {"duration_sec": "600", "tolerance_percent": "100"}),
    ("base.ros2-navigation-check", {"to": "door"}),
    ("base.ros2-navigation-check", {"to": "2.0, -1.2"}),
]
EVERY_FORM = [
    *((name, {}) for name in NEEDED),
    *(
        ("base.ros2-topic-echo-and-analyze", {"analysis_type": kind})
        for kind in ("statistics", "rate", "message_count")
    ),
]
SCHEMAS = {tool.name: tool.input_schema for tool in served_tools()}


def prompt_named(robot: Robot, name: str) -> Prompt:
    return next(prompt for prompt in base_prompts(robot) if prompt.name == name)


async def text_of(robot: Robot, name: str, given: dict[str, str]) -> str:
    messages = await prompt_named(robot, name).messages({**NEEDED[name], **given})
    return "\n".join(message.text for message in messages)


def test_the_prompts_have_the_arguments_and_defaults_of_the_contract(robot: Robot) -> None:
    assert {
        prompt.name: {argument.name: argument.default for argument in prompt.arguments}
        for prompt in base_prompts(robot)
    } == CONTRACT


async def test_the_prompt_on_navigation_leads_from_the_cause_to_its_remedy_with_what_is_offered(robot: Robot) -> None:
    text = await text_of(robot, "base.ros2-navigation-check", {"to": "2, 1"})
    assert steps_of(text) == [("ros2_nav_check", {"to": {"x": 2.0, "y": 1.0}})]
    for tool in ("ros2_nav_recover", "ros2_nav_localize", "ros2_nav_probe", "ros2_navigate"):
        assert tool in text
    by_default, tools = await tools_named(assemble(Settings()), "base.ros2-navigation-check", {})
    assert tools == {"ros2_health_check", "ros2_parameter_set", "ros2_navigate"}
    assert "--tools default,navigation" in by_default


@pytest.mark.parametrize(("name", "given"), [*((name, {}) for name in NEEDED), *LEAST_AND_MOST])
async def test_every_call_that_a_prompt_names_is_one_that_the_tool_accepts(
    robot: Robot, name: str, given: dict[str, str]
) -> None:
    steps = steps_of(await text_of(robot, name, given))
    assert steps
    for tool, arguments in steps:
        jsonschema.validate(arguments, SCHEMAS[tool])


async def test_given_values_stand_in_the_calls(robot: Robot) -> None:
    given = {"diff_fields": "linear.x", "duration_sec": "2", "tolerance_percent": "5", "sync_by_timestamp": "no"}
    assert steps_of(await text_of(robot, "base.ros2-topic-diff-monitor", given)) == [
        (
            "ros2_topic_compare",
            {
                "topic1_name": "/imu",
                "topic2_name": "/imu_slow",
                "duration_sec": 2.0,
                "diff_fields": ["linear.x"],
                "tolerance_percent": 5.0,
                "sync_by_timestamp": False,
            },
        )
    ]


@pytest.mark.parametrize(
    ("name", "given", "complaint"),
    [
        (
            "base.ros2-topic-relay",
            {"transform": "filtre"},
            "transform cannot be 'filtre'. Give one of identity, rate_limit",
        ),
        (
            "base.ros2-topic-relay",
            {"target_rate_hz": "0"},
            "target_rate_hz cannot be '0'. Give a number from 0.01 to 1000",
        ),
        ("base.ros2-topic-diff-monitor", {"topic1_name": ""}, "needs the argument topic1_name"),
        ("base.ros2-node-health-check", {"expected_nodes": "/a"}, "no argument 'expected_nodes'"),
    ],
)
async def test_wrong_values_are_refused(robot: Robot, name: str, given: dict[str, str], complaint: str) -> None:
    with pytest.raises(BadInput) as refused:
        await text_of(robot, name, given)
    assert complaint in str(refused.value)


async def test_a_prompt_takes_what_its_tools_take_and_says_that_it_is_long(robot: Robot) -> None:
    maximum = {tool: SCHEMAS[tool]["properties"] for tool in ("ros2_topic_statistics", "ros2_topic_stats")}
    assert {schema["duration_s"]["maximum"] for schema in maximum.values()} == {600}
    name = "base.ros2-topic-diff-monitor"
    assert "takes 600 s" in await text_of(robot, name, {"duration_sec": "600"})
    assert "times out" not in await text_of(robot, name, {"duration_sec": "45"})


async def test_a_prompt_is_short(robot: Robot) -> None:
    assert max([len(await text_of(robot, name, {})) for name in NEEDED]) < 1000


async def tools_named(made: Assembly, name: str, given: dict[str, str]) -> tuple[str, set[str]]:
    """The text of a prompt as a server gives it, and the tools that it names."""
    text = "\n".join(message.text for message in await made.catalog.messages(name, {**NEEDED[name], **given}))
    return text, set(re.findall(r"\bros2_\w+", text))


async def test_every_tool_that_a_prompt_names_is_offered_by_default() -> None:
    made = assemble(Settings())
    for name, given in EVERY_FORM:
        text, tools = await tools_named(made, name, given)
        assert tools and tools <= made.toolset.by_name.keys()
        assert "not possible here" not in text


@pytest.mark.parametrize(
    "settings",
    [
        Settings(read_only=True),
        Settings(read_only=True, tools=("all",)),
        *(Settings(tools=(group,)) for group in ("core", "measure", "relay", "lifecycle")),
        Settings(tools=("core", "measure")),
    ],
    ids=lambda settings: f"{','.join(settings.tools) or 'default'}{' read-only' if settings.read_only else ''}",
)
async def test_a_prompt_names_no_tool_that_is_not_offered(settings: Settings) -> None:
    made = assemble(settings)
    for name, given in EVERY_FORM:
        text, tools = await tools_named(made, name, given)
        assert tools <= made.toolset.by_name.keys()
        assert tools or "not possible here" in text


async def test_a_prompt_that_is_not_possible_names_the_reason_and_every_group_it_needs() -> None:
    text, _ = await tools_named(assemble(Settings(tools=("relay",))), "base.ros2-topic-echo-and-analyze", {})
    assert text == (
        "Analyze a topic: not possible here, because the option --tools relay,core,measure is needed. Tell the user so."
    )
    text, _ = await tools_named(assemble(Settings(read_only=True)), "base.ros2-topic-relay", {})
    assert "because this server is read-only." in text
