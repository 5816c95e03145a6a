"""What environment and command line make of the settings."""

from pathlib import Path

import pytest

from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import Settings


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
        ("ROS2_MCP_TRANSPORT", "carrier-pigeon", "stdio, sse or streamable-http"),
        ("ROS2_MCP_PORT", "70000", "1 to 65535"),
        ("ROS2_MCP_LOG_LEVEL", "loud", "debug, info, warning or error"),
    ],
)
def test_a_bad_value_names_its_variable_and_what_would_be_right(variable: str, value: str, right: str) -> None:
    with pytest.raises(BadInput, match=f"{variable}.*{value}.*{right}"):
        Settings.from_environment({variable: value})
