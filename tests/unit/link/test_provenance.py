"""The commands that the program tells others to run are right for the way by which it was installed itself."""

from __future__ import annotations

import shlex
import sys
import sysconfig
from pathlib import Path

import pytest

from ros2_mcp.link import environment, provenance
from ros2_mcp.link.diagnosis import diagnose
from ros2_mcp.link.environment import find_ros
from ros2_mcp.link.provenance import Provenance, Way, launch_command, own_provenance
from ros2_mcp.model.errors import RosNotFound
from ros2_mcp.settings import Settings

SOURCE = "/src/ros2 mcp"
BY_UV = "home = /usr/bin\nuv = 0.9.1\n"
BY_VENV = "home = /usr/bin\nversion = 3.12.3\n"


def made(root: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, str], source: str, editable: bool) -> Provenance:
    """What is told of an environment with these files."""
    root.mkdir(parents=True)
    for name, text in files.items():
        (root / name).write_text(text)
    monkeypatch.setattr(sys, "prefix", str(root))
    monkeypatch.setattr(sys, "executable", f"{root}/bin/python")
    monkeypatch.setattr(provenance, "_origin", lambda: (source, editable))
    return own_provenance({})


@pytest.mark.promise("README", "pipx install . and uv tool install . do as well")
@pytest.mark.parametrize(
    ("prefix", "files", "editable", "way", "command"),
    [
        ("{checkout}/.venv", {"pyvenv.cfg": BY_UV}, True, "uv run", "uv run --project {checkout} --extra jazzy"),
        (
            "venv",
            {"pyvenv.cfg": BY_UV},
            False,
            "uv pip",
            "uv pip install --python {prefix}/bin/python {checkout}[jazzy]",
        ),
        ("venv", {"pyvenv.cfg": BY_VENV}, False, "pip", "{prefix}/bin/python -m pip install {checkout}[jazzy]"),
        (
            "venv",
            {"pyvenv.cfg": BY_VENV},
            True,
            "pip",
            "{prefix}/bin/python -m pip install --editable {checkout}[jazzy]",
        ),
        (
            "uv/tools/ros2-mcp",
            {"pyvenv.cfg": BY_UV, "uv-receipt.toml": ""},
            False,
            "uv tool",
            "uv tool install --force",
        ),
        ("cache/uv/archive-v0/x1", {"pyvenv.cfg": BY_UV}, False, "uvx", "uvx --from {checkout}[jazzy] ros2-mcp doctor"),
        (
            "pipx/venvs/ros2-mcp",
            {"pyvenv.cfg": BY_VENV, "pipx_metadata.json": ""},
            False,
            "pipx",
            "pipx install --force",
        ),
        ("pipx/.cache/0f", {"pyvenv.cfg": BY_VENV, "pipx_metadata.json": ""}, False, "pipx run", "pipx run --spec"),
    ],
)
def test_each_way_of_installing_has_its_own_command(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    prefix: str,
    files: dict[str, str],
    editable: bool,
    way: Way,
    command: str,
) -> None:
    checkout = tmp_path / "my checkout"
    root = Path(prefix.format(checkout=checkout)) if prefix.startswith("{") else tmp_path / prefix
    told = made(root, monkeypatch, files, str(checkout), editable)
    assert told.way == way
    words = shlex.split(told.installing("jazzy"))
    expected = [word.format(checkout=checkout, prefix=root) for word in command.split()]
    assert words[: len(expected)] == expected
    assert any(word in (f"{checkout}[jazzy]", str(checkout)) for word in words)


def test_where_the_system_manages_python_the_command_makes_an_environment_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(sys, "base_prefix", str(tmp_path / "usr"))
    monkeypatch.setattr(sysconfig, "get_path", lambda _: str(tmp_path))
    told = made(tmp_path / "usr", monkeypatch, {}, SOURCE, editable=False)
    assert told.installing("jazzy").startswith("python3 -m venv ~/.ros2-mcp && ~/.ros2-mcp/bin/pip install ")
    assert "break-system-packages" not in told.installing("jazzy")


@pytest.mark.parametrize(
    ("source", "requirement"),
    [
        ("", "ros2-mcp[jazzy]"),
        (SOURCE, f"{SOURCE}[jazzy]"),
        ("git+https://host/ros2-mcp", "ros2-mcp[jazzy] @ git+https://host/ros2-mcp"),
    ],
)
def test_what_is_asked_for_is_what_it_came_from(source: str, requirement: str) -> None:
    told = Provenance(way="pip", prefix=Path("/venv"), python="/venv/bin/python", source=source)
    assert told.requirement("jazzy") == requirement


def test_a_client_is_never_given_a_path_in_a_cache() -> None:
    python = "/var/me/.cache/uv/archive-v0/x1/bin/python"
    told = Provenance(way="uvx", prefix=Path(python).parents[1], python=python, source=SOURCE)
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert launch_command(told, "jazzy", {"UV": "/opt/uv"}) == [
        *("/opt/uv", "tool", "run", "--python", version),
        *("--from", f"{SOURCE}[jazzy]", "ros2-mcp"),
    ]
    assert not told.lasts


def test_a_client_is_given_the_command_beside_the_python_that_runs_it(tmp_path: Path) -> None:
    told = Provenance(way="pip", prefix=tmp_path, python=str(tmp_path / "python"))
    assert launch_command(told, "") == [str(tmp_path / "python"), "-m", "ros2_mcp"]
    (tmp_path / "ros2-mcp").touch()
    assert launch_command(told, "") == [str(tmp_path / "ros2-mcp")]


def test_wheels_whose_rclpy_uv_sync_removed_are_recognised_and_the_way_back_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(environment, "wheel_distro", lambda: "jazzy")
    monkeypatch.setattr(environment.importlib.util, "find_spec", lambda _: None)
    checkout = tmp_path / "checkout"
    made(checkout / ".venv", monkeypatch, {"pyvenv.cfg": BY_UV}, str(checkout), editable=True)
    settings = Settings(ros_root=tmp_path)
    with pytest.raises(RosNotFound, match=r"rclpy is gone.*'uv sync' twice") as missing:
        find_ros(settings, {})
    mend = f"uv sync --project {checkout} --extra jazzy --inexact --reinstall"
    assert mend in missing.value.hint
    told = [finding for finding in diagnose(settings, {}) if mend in finding.fix]
    assert [finding.title for finding in told] == ["ROS 2", "Wheels"]
