"""What other tools read of this project says the same everywhere, and starts what is there."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from release.facts import NOBODY, read_facts
from release.manifests import LINES, WHOLE, manifests, out_of_date, write
from ros2_mcp.cli import parser
from ros2_mcp.settings import OPTIONS, Settings
from support.source import ROOT, committed_texts

FACTS = read_facts()
OUT_OF_DATE = "run: python -m release write"


def compose() -> dict[str, dict[str, list[str]]]:
    yaml: Any = YAML(typ="safe")
    return yaml.load((ROOT / "compose.yaml").read_text("utf-8"))["services"]


def unit() -> str:
    return (ROOT / "deploy/systemd/ros2-mcp.service").read_text("utf-8")


def test_all_manifests_have_the_version_and_the_owner_of_the_project() -> None:
    assert out_of_date(FACTS, ROOT) == [], OUT_OF_DATE


def test_the_project_is_installed_under_that_version() -> None:
    assert version(FACTS.name) == FACTS.version


def test_a_new_version_and_owner_reach_every_manifest(tmp_path: Path) -> None:
    for path in (*WHOLE, *LINES):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text((ROOT / path).read_text("utf-8"), encoding="utf-8")
    new = replace(FACTS, version="7.8.9", owner="somebody")
    write(new, tmp_path)
    assert out_of_date(new, tmp_path) == []
    for path in (*WHOLE, *LINES):
        text = (tmp_path / path).read_text("utf-8")
        assert "somebody" in text, path
        assert "7.8.9" in text or path in ("pyproject.toml", "README.md"), path
        assert FACTS.owner != NOBODY or not re.search(rf"(github.com/|io\.github\.){NOBODY}\b", text), path


def test_the_ros_package_finds_its_modules_in_a_checkout_without_links(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")  # it comes with the wheels of ROS 2
    package = tmp_path / "deploy/ros/ros2_mcp_bridge"
    shutil.copytree(ROOT / "deploy/ros/ros2_mcp_bridge", package, ignore=shutil.ignore_patterns("ros2_mcp_bridge"))
    (tmp_path / "src/ros2_mcp_bridge").mkdir(parents=True)
    (tmp_path / "src/ros2_mcp_bridge/__main__.py").touch()
    said = subprocess.run([sys.executable, "setup.py", "--version"], cwd=package, capture_output=True, check=True)
    assert said.stdout.decode().split() == [FACTS.version]
    assert (package / "ros2_mcp_bridge/__main__.py").exists()


def test_a_line_that_has_gone_is_told(tmp_path: Path) -> None:
    for path in LINES:
        (tmp_path / path).write_text("nothing of it\n", encoding="utf-8")
    with pytest.raises(ValueError, match="has 0 lines like"):
        manifests(FACTS, tmp_path)


def test_no_other_file_names_an_owner() -> None:
    of_account = re.compile(rf"(github\.com/|io\.github\.){re.escape(FACTS.owner)}\b")
    ours = {path for path, text in committed_texts().items() if of_account.search(text)}
    assert ours <= {*WHOLE, *LINES}


def test_the_registry_takes_the_description() -> None:
    assert len(json.loads((ROOT / "server.json").read_text("utf-8"))["description"]) <= 100


def test_what_clients_start_from_the_manifests_reaches_the_robot_that_is_asked_for() -> None:
    bundle = json.loads((ROOT / "deploy/mcpb/manifest.json").read_text("utf-8"))
    assert bundle["user_config"]["read_only"]["default"] is True
    command = bundle["server"]["mcp_config"]
    assert command["args"][: command["args"].index(FACTS.name)] == ["run", "--directory", "${__dirname}"]
    for robot in ("ssh://me@robot", "local"):
        values = {"robot": robot, "read_only": "true"}
        assert set(values) == set(bundle["user_config"])
        words = [filled_in(word, values) for word in command["args"]]
        env = {name: filled_in(value, values) for name, value in command["env"].items()}
        assert asked(words[words.index(FACTS.name) + 1 :], env) == (robot, True)
    [package] = json.loads((ROOT / "server.json").read_text("utf-8"))["packages"]
    [argument] = package["packageArguments"]
    assert asked([argument["name"], argument["placeholder"]], {})[0] == argument["placeholder"]
    assert asked([argument["name"], argument["default"]], {})[0] == "local"
    assert {one["name"] for one in package["environmentVariables"]} <= {option.variable for option in OPTIONS.values()}


def filled_in(text: str, values: dict[str, str]) -> str:
    """The text with what a user has given, as the client of a bundle fills it in."""
    return re.sub(r"\$\{user_config\.(\w+)\}", lambda found: values[found[1]], text)


def asked(words: list[str], env: dict[str, str]) -> tuple[str, bool]:
    """The robot that a command line reaches, and whether it only reads."""
    arguments = parser().parse_args(words)
    robots = OPTIONS["robots"].parse(os.pathsep.join(arguments.robots))
    settings = Settings.from_environment(env, robots=robots)
    return settings.robots[0].text, settings.read_only


def test_the_image_is_built_from_what_docker_is_given() -> None:
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", (ROOT / "Dockerfile").read_text("utf-8"), re.MULTILINE)
    sources = {source for line in copied for source in line.split()}
    given = [line[1:] for line in (ROOT / ".dockerignore").read_text("utf-8").splitlines() if line.startswith("!")]
    assert (
        sources
        and {one for one in sources if not any(one == path or one.startswith(f"{path}/") for path in given)} == set()
    )
    assert {one for one in sources if not (ROOT / one).exists()} == set()


@pytest.mark.parametrize("service", compose())
def test_the_compose_file_starts_what_the_command_line_knows(service: str) -> None:
    parser().parse_args(compose()[service]["command"])


def test_the_unit_starts_what_the_command_line_knows() -> None:
    [command] = re.findall(r"^ExecStart=/opt/ros2-mcp/bin/ros2-mcp (.*)$", unit(), re.MULTILINE)
    assert parser().parse_args(command.split()).verb == "serve"


def test_the_unit_kills_bridge_and_stopper_last() -> None:
    """ "mixed" would kill both at once when the server alone has died."""
    assert re.findall(r"^KillMode=(.*)$", unit(), re.MULTILINE) == ["control-group"]
