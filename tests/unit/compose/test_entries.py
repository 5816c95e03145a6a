"""The robots of one server: what names them, and what is wrong with how they are named."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from ros2_mcp.compose.entries import entries_of, named_in, only_one
from ros2_mcp.model.address import parse_address
from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import Settings
from support.source import ROOT

Write = Callable[[str], Path]
THREE = """\
robots:
  lab:
    at: ssh://ubuntu@lab.local?container=ros
    distro: humble
    workspaces: [~/ws]
    domain_id: 7
    rmw: rmw_cyclonedds_cpp
    ssh_options: [-oProxyJump=gate]
    env: {CYCLONEDDS_URI: "file:///etc/c d.xml"}
    read_only: true
  yard:
    command: [kubectl, exec, -i, pod, --]
    policy: [teleop-slow, yard.yaml]
  here:
    at: local?domain_id=3
"""


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(text: str) -> Path:
        path = tmp_path / "robots.yaml"
        path.write_text(textwrap.dedent(text))
        return path

    return written


def settings_of(path: Path, *robots: str) -> Settings:
    policy = path.with_name("yard.yaml")
    policy.write_text("policy: 1\nname: yard\nmode: observe\n")
    return Settings(robots_file=path, robots=tuple(map(parse_address, robots)), record_dir=path.parent)


def test_each_robot_of_the_file_has_settings_of_its_own(write: Write) -> None:
    path = write(THREE)
    entries = {entry.name: entry.settings for entry in entries_of(settings_of(path, "more=ssh://more"))}
    assert list(entries) == ["lab", "yard", "here", "more"]
    lab = entries["lab"]
    assert (lab.robot.host, lab.robot.container, lab.domain_id, lab.read_only) == ("lab.local", "ros", 7, True)
    assert (lab.distro, lab.rmw, lab.ssh_options) == ("humble", "rmw_cyclonedds_cpp", ("-oProxyJump=gate",))
    assert lab.robot_env == ("CYCLONEDDS_URI=file:///etc/c d.xml",)
    assert lab.workspaces == (Path("~/ws"),), "it is the robot's: nothing of this machine stands for it"
    yard = entries["yard"]
    assert yard.robot.command == ("kubectl", "exec", "-i", "pod", "--")
    assert yard.policy == ("teleop-slow", str(path.with_name("yard.yaml"))), "a file lies beside the file of robots"
    assert (entries["here"].domain_id, entries["here"].read_only, entries["here"].policy) == (3, False, ())
    assert {name: settings.record_dir.name for name, settings in entries.items()} == {name: name for name in entries}


def test_the_only_robot_of_a_file_needs_no_name(write: Write) -> None:
    path = write("robots:\n  lab:\n    at: local\n    domain_id: 5\n")
    (entry,) = entries_of(settings_of(path))
    assert (entry.name, entry.settings.domain_id, entry.settings.record_dir) == ("", 5, path.parent)
    assert entries_of(entry.settings)[0].settings == entry.settings, "the file is read once"


@pytest.mark.parametrize(
    ("text", "line", "problem"),
    [
        ("", 1, "it is empty. Begin with: robots:"),
        ("robot: {}", 1, "the file of robots needs 'robots'"),
        ("robots:\n  lab:\n    at: local\nmore: 1", 4, "'more' means nothing in the file of robots"),
        (
            "robots:\n  lab:\n    at: local\n    distr: humble",
            4,
            "'distr' means nothing in the robot lab. Did you mean",
        ),
        ("robots:\n  lab:\n    at: ftp://lab", 3, "begins with ftp://"),
        ("robots:\n  lab:\n    distro: humble", 3, "needs 'at' or 'command', and one of them alone"),
        ("robots:\n  lab:\n    at: local\n    command: [sh]", 3, "needs 'at' or 'command', and one of them alone"),
        ("robots:\n  lab:\n    at: local\n    domain_id: 300", 4, "domain_id is 300; it must be from 0 to 232"),
        ("robots:\n  lab:\n    at: local\n    domain_id: 1.5", 4, "domain_id must be a whole number"),
        ("robots:\n  lab:\n    at: local?domain_id=1\n    domain_id: 1", 4, "the address names a domain_id, too"),
        ("robots:\n  lab:\n    at: local\n    read_only: yes", 4, "read_only must be true or false"),
        ("robots:\n  lab:\n    at: local\n    env:\n      A-B: c", 5, "«A-B» is not the name of a variable"),
        ("robots:\n  ../up:\n    at: local", 3, "«../up» is not a valid robot name"),
        ("robots:\n  lab:\n    at: local\n  lab:\n    at: local", 4, "'lab' is there twice"),
        ("robots:\n  lab: {at: [", 2, "not valid YAML"),
    ],
)
def test_a_mistake_is_told_with_its_line(write: Write, text: str, line: int, problem: str) -> None:
    with pytest.raises(BadInput) as error:
        entries_of(settings_of(write(text)))
    assert f"robots.yaml, line {line}: " in str(error.value)
    assert problem in str(error.value)


def test_a_file_that_others_can_write_names_no_robots(write: Write) -> None:
    path = write("robots:\n  lab:\n    at: local\n")
    path.chmod(0o666)
    with pytest.raises(BadInput, match="it can be written by users other than its owner"):
        entries_of(settings_of(path))


@pytest.mark.parametrize(
    ("robots", "problem"),
    [
        (("lab=local?domain_id=1", "Lab=local?domain_id=2"), "Two robots are called 'lab'"),
        (("lab=local?domain_id=1", "yard=local?domain_id=1"), "lab and yard are one robot"),
        (("lab=ssh://a@host", "yard=ssh://b@host"), "lab and yard are one robot"),
        (("lab=local", f"{'x' * 33}=local?domain_id=2"), "is not a valid robot name"),
    ],
)
def test_names_and_robots_differ(robots: tuple[str, ...], problem: str) -> None:
    with pytest.raises(BadInput, match=problem):
        entries_of(Settings(robots=tuple(map(parse_address, robots))))


def test_one_policy_that_names_a_robot_holds_for_one(tmp_path: Path) -> None:
    policy = tmp_path / "policy.yaml"
    policy.write_text("policy: 1\nname: mine\nrobot: mine\nmode: observe\n")
    robots = tuple(map(parse_address, ("lab=local?domain_id=1", "yard=local?domain_id=2")))
    with pytest.raises(BadInput, match="a policy that has 'robot' or 'state' is for one robot"):
        entries_of(Settings(robots=robots, policy=(str(policy),)))


def test_a_call_from_the_command_line_names_its_robot() -> None:
    robots = tuple(map(parse_address, ("lab=local?domain_id=1", "yard=local?domain_id=2")))
    settings, words = named_in(Settings(robots=robots), ["robot=yard", "pattern=x"], needed=True)
    assert (settings.domain_id, words) == (2, ["pattern=x"])
    with pytest.raises(BadInput, match=r"none is named\. Give robot=NAME: lab, yard"):
        named_in(Settings(robots=robots), ["pattern=x"], needed=True)
    with pytest.raises(BadInput, match="There is no robot «up»"):
        named_in(Settings(robots=robots), ["robot=up"], needed=True)


def test_a_command_for_one_robot_says_how_to_name_it() -> None:
    robots = tuple(map(parse_address, ("lab=local?domain_id=1", "yard=local?domain_id=2")))
    with pytest.raises(BadInput, match=r"operate is about one robot, and there are 2.*--state: \S+domain-1@\S+ is lab"):
        only_one(Settings(robots=robots), "operate")


def test_the_file_of_the_how_to_is_read_as_it_stands(tmp_path: Path) -> None:
    text = (ROOT / "docs/how-to/several-robots.md").read_text(encoding="utf-8")
    path = tmp_path / "robots.yaml"
    path.write_text(text.partition("```yaml\n")[2].partition("```")[0])
    (tmp_path / "yard-policy.yaml").write_text("policy: 1\nname: yard\nmode: observe\n")
    entries = entries_of(Settings(robots_file=path))
    assert [(entry.name, entry.settings.robot.kind) for entry in entries] == [
        ("lab", "ssh"),
        ("yard", "ssh"),
        ("cell", "command"),
    ]
