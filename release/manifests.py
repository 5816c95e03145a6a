"""Every file that names the version or the owner: written whole, or the one line of it that does."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from release.facts import Facts

REGISTRY_SCHEMA = "https://static.modelcontextprotocol.io/schemas/2025-12-11/server.schema.json"
ROBOT = "Where the robot is: ssh://me@robot, docker://NAME, or local (this machine); ?domain_id=7 names its ROS domain"


def server_json(facts: Facts) -> str:
    """For the MCP registry; which finds in the README on the package index that this is ours (`mcp-name`)."""
    return _json(
        {
            "$schema": REGISTRY_SCHEMA,
            "name": facts.registry_name,
            "title": "ROS 2",
            "description": facts.description,
            "repository": {"url": facts.url, "source": "github"},
            "websiteUrl": facts.url,
            "version": facts.version,
            "packages": [
                {
                    "registryType": "pypi",
                    "identifier": facts.name,
                    "version": facts.version,
                    "runtimeHint": "uvx",
                    "transport": {"type": "stdio"},
                    "packageArguments": [
                        {
                            "type": "named",
                            "name": "--robot",
                            "description": ROBOT,
                            "default": "local",
                            "placeholder": "ssh://me@robot",
                        }
                    ],
                    "environmentVariables": [
                        {
                            "name": "ROS_DOMAIN_ID",
                            "description": "DDS domain of a robot that is local",
                            "format": "number",
                        },
                        {
                            "name": "ROS2_MCP_READONLY",
                            "description": "1: leave out all tools that write or move the robot",
                            "format": "boolean",
                        },
                        {"name": "ROS2_MCP_POLICY", "description": "What the agent may do: a file or a profile"},
                    ],
                }
            ],
        }
    )


def mcpb_manifest(facts: Facts) -> str:
    """For Claude Desktop, which starts what it finds in the bundle with uv."""
    return _json(
        {
            "manifest_version": "0.4",
            "name": facts.name,
            "display_name": "ROS 2",
            "version": facts.version,
            "description": facts.description,
            "author": {"name": facts.author, "url": f"https://github.com/{facts.owner}"},
            "repository": {"type": "git", "url": facts.url},
            "homepage": facts.url,
            "support": f"{facts.url}/issues",
            "license": facts.licence,
            "keywords": list(facts.keywords),
            "server": {
                "type": "uv",
                "entry_point": "src/ros2_mcp/__main__.py",
                "mcp_config": {
                    "command": "uv",
                    "args": ["run", "--directory", "${__dirname}", "ros2-mcp", "--robot", "${user_config.robot}"],
                    "env": {"ROS2_MCP_READONLY": "${user_config.read_only}"},
                },
            },
            "tools_generated": True,
            "prompts_generated": True,
            "user_config": {
                "robot": {
                    "type": "string",
                    "title": "Robot",
                    "description": ROBOT,
                    "required": True,
                },
                "read_only": {
                    "type": "boolean",
                    "title": "Read only",
                    "description": "Leave out all tools that write or move the robot",
                    "default": True,
                    "required": True,
                },
            },
            "compatibility": {
                "platforms": ["darwin", "linux", "win32"],
                "runtimes": {"python": facts.requires_python},
            },
        }
    )


def package_xml(facts: Facts) -> str:
    """For ROS: the bridge alone, whose only dependency has a package there."""
    return f"""\
<?xml version="1.0"?>
<!-- Written by python -m release write. Do not edit. -->
<package format="3">
  <name>ros2_mcp_bridge</name>
  <version>{escape(facts.version)}</version>
  <description>The part of {escape(facts.name)} that runs on the robot: it carries messages between the server and the
    ROS graph, and stops what the server moves when the server is gone.</description>
  <maintainer email={quoteattr(facts.email)}>{escape(facts.author)}</maintainer>
  <license>{escape(facts.licence)}</license>
  <url type="repository">{escape(facts.url)}</url>
  <url type="bugtracker">{escape(facts.url)}/issues</url>
  <exec_depend>rclpy</exec_depend>
  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
"""


WHOLE: Mapping[str, Callable[[Facts], str]] = {
    "server.json": server_json,
    "deploy/mcpb/manifest.json": mcpb_manifest,
    "deploy/ros/ros2_mcp_bridge/package.xml": package_xml,
}
"""Path → what the file is."""

LINES: Mapping[str, Mapping[str, Callable[[Facts], str]]] = {
    "pyproject.toml": {
        r"^authors = .*$": lambda facts: f"authors = [{{ name = {json.dumps(facts.author)} }}]",
        r"^Repository = .*$": lambda facts: f'Repository = "{facts.url}"',
        r"^Documentation = .*$": lambda facts: f'Documentation = "{facts.url}/tree/main/docs"',
        r"^Changelog = .*$": lambda facts: f'Changelog = "{facts.url}/blob/main/CHANGELOG.md"',
        r"^Issues = .*$": lambda facts: f'Issues = "{facts.url}/issues"',
    },
    "README.md": {r"^<!-- mcp-name: .* -->$": lambda facts: f"<!-- mcp-name: {facts.registry_name} -->"},
    "Dockerfile": {
        r'io\.modelcontextprotocol\.server\.name="[^"]*"': lambda facts: (
            f'io.modelcontextprotocol.server.name="{facts.registry_name}"'
        ),
        r'org\.opencontainers\.image\.version="[^"]*"': lambda facts: (
            f'org.opencontainers.image.version="{facts.version}"'
        ),
        r'org\.opencontainers\.image\.source="[^"]*"': lambda facts: f'org.opencontainers.image.source="{facts.url}"',
    },
}
"""Path → a pattern that is there exactly once → what stands in its place."""


def manifests(facts: Facts, root: Path) -> dict[str, str]:
    """Every manifest as it must be, by its path below the root.

    Raises:
        ValueError: if a line that has to name the version or the owner is not there once.
    """
    found = {path: text(facts) for path, text in WHOLE.items()}
    for path, lines in LINES.items():
        text = (root / path).read_text("utf-8")
        for pattern, line in lines.items():
            places = list(re.finditer(pattern, text, re.MULTILINE))
            if len(places) != 1:
                raise ValueError(f"{path} has {len(places)} lines like {pattern!r}; there must be one.")
            text = text[: places[0].start()] + line(facts) + text[places[0].end() :]
        found[path] = text
    return found


def out_of_date(facts: Facts, root: Path) -> list[str]:
    """The paths of the manifests that are not as they must be."""
    wanted = manifests(facts, root).items()
    return [path for path, text in wanted if not (root / path).is_file() or (root / path).read_text("utf-8") != text]


def write(facts: Facts, root: Path) -> list[str]:
    """Writes those that are out of date, and returns their paths."""
    changed = out_of_date(facts, root)
    wanted = manifests(facts, root)
    for path in changed:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(wanted[path], encoding="utf-8")
    return changed


def _json(value: Mapping[str, Any]) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"
