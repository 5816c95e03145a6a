"""What environment and command line make of the settings."""

import os
import re
from dataclasses import fields
from pathlib import Path

import pytest

from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import OPTIONS, Settings


def test_the_environment_sets_what_it_names() -> None:
    env = {
        "ROS2_MCP_READONLY": "1",
        "ROS2_MCP_WORKSPACE": "/a b:/c",
        "ROS_DOMAIN_ID": "42",
        "ROS2_MCP_TOOLS": "topics, services",
        "XDG_CACHE_HOME": "/cache",
    }
    settings = Settings.from_environment(env)
    assert settings.read_only
    assert settings.workspaces == (Path("/a b"), Path("/c"))
    assert settings.domain_id == 42
    assert settings.tools == ("topics", "services")
    assert settings.cache_dir == Path("/cache/ros2-mcp")


def test_an_option_wins_over_its_variable_even_if_that_is_wrong() -> None:
    assert Settings.from_environment({"ROS_DOMAIN_ID": "many"}, domain_id=3).domain_id == 3
    assert Settings.from_environment({"ROS2_MCP_PORT": "9000"}, port=None).port == 9000


@pytest.mark.parametrize(
    ("variable", "value", "right"),
    [
        ("ROS_DOMAIN_ID", "233", "0 to 232"),
        ("ROS_DOMAIN_ID", "many", "whole number"),
        ("ROS2_MCP_READONLY", "maybe", "1 .on. or 0 .off."),
        ("ROS2_MCP_TRANSPORT", "carrier-pigeon", "stdio or streamable-http"),
        ("ROS2_MCP_PORT", "70000", "1 to 65535"),
        ("ROS2_MCP_LOG_LEVEL", "loud", "debug, info, warning or error"),
    ],
)
def test_a_bad_value_names_its_variable_and_what_would_be_right(variable: str, value: str, right: str) -> None:
    with pytest.raises(BadInput, match=f"{variable}.*{value}.*{right}"):
        Settings.from_environment({variable: value})


@pytest.mark.parametrize("given", ["variable", "option", "keyword"])
def test_the_sse_transport_that_was_removed_is_refused_with_what_to_write_instead(given: str) -> None:
    with pytest.raises(BadInput, match=r"is sse\..*--transport streamable-http.*/mcp"):
        if given == "variable":
            Settings.from_environment({"ROS2_MCP_TRANSPORT": "sse"})
        elif given == "option":
            OPTIONS["transport"].parse("sse")
        else:
            Settings.from_environment({}, transport="sse")


def test_every_setting_has_a_flag_and_a_variable_of_its_own() -> None:
    assert [field.name for field in fields(Settings)] == [*OPTIONS, "origins"]
    assert len({option.flag for option in OPTIONS.values()}) == len(OPTIONS)
    assert len({option.variable for option in OPTIONS.values()}) == len(OPTIONS)
    assert [option.flag for option in OPTIONS.values() if not re.fullmatch(r"--[a-z]+(-[a-z]+)*", option.flag)] == []
    assert [option.variable for option in OPTIONS.values() if not re.fullmatch(r"[A-Z0-9_]+", option.variable)] == []


@pytest.mark.parametrize("name", OPTIONS)
def test_every_default_is_among_the_values_that_are_accepted(name: str) -> None:
    default = getattr(Settings(), name)
    assert default is None or OPTIONS[name].checked(default) == default


def test_settings_know_what_set_them() -> None:
    env = {"ROS_DOMAIN_ID": "7", "ROS2_MCP_PORT": "9000", "ROS2_MCP_BLACK_BOX_HOURS": "0.5"}
    settings = Settings.from_environment(env, port=9001)
    assert settings.origins == {
        "domain_id": "ROS_DOMAIN_ID",
        "port": "--port",
        "black_box_hours": "ROS2_MCP_BLACK_BOX_HOURS",
    }
    assert settings.black_box_hours == 0.5


def test_a_bound_holds_for_an_option_and_for_its_variable(tmp_path: Path) -> None:
    wrong = r"--black-box-hours \(ROS2_MCP_BLACK_BOX_HOURS\) is 'nan'|is nan\. It must be a number from 0.01 to 10000\."
    with pytest.raises(BadInput, match=wrong):
        Settings.from_environment({"ROS2_MCP_BLACK_BOX_HOURS": "nan"})
    with pytest.raises(BadInput, match=wrong):
        Settings.from_environment({}, black_box_hours=float("nan"))
    with pytest.raises(BadInput, match=r"--bag \(ROS2_MCP_BAG\) is .*It must be a file or folder that exists\."):
        Settings.from_environment({"ROS2_MCP_BAG": str(tmp_path / "none")})


def test_a_policy_of_the_variable_holds_besides_that_of_the_option() -> None:
    env = {"ROS2_MCP_POLICY": os.pathsep.join(("hall.yaml", "nav"))}
    assert Settings.from_environment(env).policy == ("hall.yaml", "nav")
    assert Settings.from_environment(env, policy=("lab",)).policy == ("hall.yaml", "nav", "lab")
