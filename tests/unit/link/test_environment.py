"""Finding ROS in folders made for the purpose."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ros2_mcp.link import environment
from ros2_mcp.link.diagnosis import diagnose
from ros2_mcp.link.environment import find_ros
from ros2_mcp.link.installation import WHEEL_GUARD, RosInstallation, search_of, with_a_place_for_logs, without_ours
from ros2_mcp.link.provenance import own_provenance
from ros2_mcp.model.errors import BadInput, RosNotFound
from ros2_mcp.settings import Settings
from ros2_mcp_common.start.finding import environment_for

BARE = {"PATH": os.environ["PATH"], "HOME": "/nonexistent"}
"""What is in the home folder of whoever runs the tests is not found."""


@pytest.fixture
def no_wheels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "wheels", lambda *_: None)
    monkeypatch.setattr(environment, "wheel_distro", lambda: None)


def install(root: Path, *distros: str) -> Path:
    for distro in distros:
        (root / distro).mkdir(parents=True)
        (root / distro / "setup.bash").write_text(f'export ROS_DISTRO={distro}\necho "sourcing {distro}"\n')
    return root


def put_rclpy(prefix: Path, python: str) -> Path:
    package = prefix / "lib" / python / "site-packages" / "rclpy"
    package.mkdir(parents=True)
    return package.parent


def workspace(root: Path, line: str) -> Path:
    (root / "install").mkdir(parents=True)
    (root / "install" / "setup.bash").write_text(line + "\n")
    return root


@pytest.mark.promise("README", "the newest, or --distro, is sourced for the bridge")
def test_the_newest_known_release_is_chosen(tmp_path: Path) -> None:
    root = install(tmp_path, "jazzy", "humble", "kilted", "iron")
    assert find_ros(Settings(ros_root=root), BARE).distro == "kilted"


def test_an_unknown_release_is_newer_than_the_known_ones_and_older_than_rolling(tmp_path: Path) -> None:
    assert environment.installed_distros(install(tmp_path, "rolling", "zebra", "jazzy", "mango")) == [
        "jazzy",
        "mango",
        "zebra",
        "rolling",
    ]


@pytest.mark.promise("README", "the newest, or --distro, is sourced for the bridge")
def test_the_asked_for_release_wins_over_newer_ones(tmp_path: Path) -> None:
    found = find_ros(Settings(ros_root=install(tmp_path, "humble", "jazzy"), distro="humble"), BARE)
    assert (found.kind, found.distro) == ("unsourced", "humble")


@pytest.mark.usefixtures("no_wheels")
def test_a_release_that_is_not_there_is_an_error_that_lists_what_is(tmp_path: Path) -> None:
    with pytest.raises(RosNotFound, match=r"iron.*found: humble, jazzy"):
        find_ros(Settings(ros_root=install(tmp_path, "humble", "jazzy"), distro="iron"), BARE)


@pytest.mark.usefixtures("no_wheels")
def test_nothing_at_all_names_the_one_command_that_helps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "wheels_exist_here", lambda: True)
    with pytest.raises(RosNotFound) as missing:
        find_ros(Settings(ros_root=tmp_path), BARE)
    assert f"Run: {own_provenance().installing('jazzy')};" in missing.value.hint
    assert "--robot ssh://me@robot" in missing.value.hint


@pytest.mark.usefixtures("no_wheels")
def test_a_platform_without_wheels_is_not_told_to_install_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "wheels_exist_here", lambda: False)
    with pytest.raises(RosNotFound) as missing:
        find_ros(Settings(ros_root=tmp_path), BARE)
    assert "Run:" not in missing.value.hint
    assert "no ROS 2 wheels for" in missing.value.hint and "--robot ssh://me@robot" in missing.value.hint


@pytest.mark.promise("README", "a sourced shell")
@pytest.mark.promise("README", "runs under the Python of ROS 2")
def test_a_sourced_shell_wins_and_its_own_python_runs_the_bridge(tmp_path: Path) -> None:
    prefix = tmp_path / "opt" / "jazzy"
    packages = put_rclpy(prefix, "python3.99")
    python = prefix / "bin" / "python3.99"
    python.parent.mkdir()
    python.write_text("#!/bin/sh\n")
    python.chmod(0o755)
    env = {**BARE, "ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(prefix), "PYTHONPATH": str(packages)}
    found = find_ros(Settings(ros_root=install(tmp_path / "root", "kilted")), env)
    assert (found.kind, found.distro, found.prefix, found.python) == ("sourced", "jazzy", prefix, str(python))


def test_a_sourced_shell_whose_python_is_missing_is_not_used_and_the_doctor_says_so(tmp_path: Path) -> None:
    packages = put_rclpy(tmp_path / "opt", "python3.99")
    env = {**BARE, "ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(tmp_path / "opt"), "PYTHONPATH": str(packages)}
    settings = Settings(ros_root=install(tmp_path / "root", "kilted"))
    assert find_ros(settings, env).kind == "unsourced"
    shell = next(finding for finding in diagnose(settings, env) if finding.title == "Sourced shell")
    assert shell.ok is False
    assert "ROS2_MCP_BRIDGE_PYTHON" in shell.fix


def test_another_release_than_the_sourced_one_starts_from_a_clean_environment(tmp_path: Path) -> None:
    put_rclpy(tmp_path / "jazzy", "python3")
    env = {**BARE, "ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(tmp_path / "jazzy"), "PYTHONPATH": "/old"}
    found = find_ros(Settings(ros_root=install(tmp_path / "root", "kilted"), distro="kilted"), env)
    assert found.kind == "unsourced"
    assert not {"AMENT_PREFIX_PATH", "PYTHONPATH", "ROS_DISTRO"} & set(found.environment)


@pytest.mark.promise("README", "--workspace DIR sources an overlay on top")
@pytest.mark.parametrize("given", ["", "install", "install/setup.bash"])
def test_a_workspace_is_given_by_its_root_its_install_folder_or_its_file(tmp_path: Path, given: str) -> None:
    overlay = workspace(tmp_path / "my ws", "")
    settings = Settings(ros_root=install(tmp_path / "root", "jazzy"), workspaces=(overlay / given,))
    assert find_ros(settings, BARE).scripts[-1] == overlay / "install" / "setup.bash"


def test_a_workspace_that_was_never_built_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"no install/setup.bash"):
        find_ros(Settings(ros_root=install(tmp_path, "jazzy"), workspaces=(tmp_path / "src",)), BARE)


@pytest.mark.promise("README", "--workspace DIR sources an overlay on top, and may be given more than once")
def test_overlays_are_sourced_in_order_whatever_their_paths_contain(tmp_path: Path) -> None:
    """The real command, with a program that prints its environment in the place of Python."""
    root = install(tmp_path / 'it\'s "the" $root', "jazzy")
    overlay = workspace(tmp_path / "my 'ws' $HOME", 'export OVERLAY="on $ROS_DISTRO"')
    reporter = tmp_path / "python here"
    reporter.write_text('#!/bin/sh\nprintf "%s|" "$OVERLAY" "$AMENT_PREFIX_PATH" "$PYTHONPATH" "$4" "$5"\n')
    reporter.chmod(0o755)
    settings = Settings(
        ros_root=root, workspaces=(overlay,), bridge_python=reporter, interface_prefixes=(tmp_path / "built it",)
    )
    command = find_ros(settings, BARE).command("ros2_mcp_bridge", ["it's"])
    done = subprocess.run(command.argv, env=command.env, capture_output=True, text=True, check=True, timeout=60)
    prefix = tmp_path / "built it"
    assert done.stdout == f"on jazzy|{prefix}|{prefix / 'site-packages'}|ros2_mcp_bridge|it's|"
    assert "sourcing jazzy" in done.stderr


def test_a_package_runs_without_our_other_packages_on_its_path(tmp_path: Path) -> None:
    (tmp_path / "src" / "some_package").mkdir(parents=True)
    (tmp_path / "src" / "some_package" / "__init__.py").write_text("")
    (tmp_path / "src" / "some_package" / "part.py").write_text("word = 'part'\n")
    (tmp_path / "src" / "some_package" / "__main__.py").write_text(
        "import sys\nfrom some_package.part import word\n"
        "def main():\n    print(word, sys.argv[1:], sys.argv[0].rpartition('/some_package')[0] in sys.path)\n"
        "    return 3\n"
    )
    installation = RosInstallation("sourced", "jazzy", tmp_path, "", sys.executable, environment=BARE)
    argv = list(installation.command("some_package", ["a b"]).argv)
    argv[3] = str(tmp_path / "src")
    (tmp_path / "src" / "ros2_mcp_common").mkdir()
    (tmp_path / "src" / "ros2_mcp_common" / "__init__.py").write_text("")
    done = subprocess.run(argv, env={"PATH": ""}, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (3, "part ['a b'] False\n")


def test_the_environment_of_the_bridge_holds_nothing_of_our_own_python() -> None:
    leaked = {
        WHEEL_GUARD: "1",
        "PYTHONHOME": "/x",
        "LD_LIBRARY_PATH": f"{sys.prefix}/lib{os.pathsep}/usr/local/lib",
        "HOME": "/home/robot",
    }
    search = search_of(Settings(domain_id=7, rmw="rmw_cyclonedds_cpp"))
    clean = environment_for(search, without_ours(leaked), keep_sourced=True)
    assert clean == {
        "LD_LIBRARY_PATH": "/usr/local/lib",
        "HOME": "/home/robot",
        "ROS_DOMAIN_ID": "7",
        "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    }


def test_what_was_asked_for_of_the_environment_stands_above_what_was_sourced() -> None:
    settings = Settings(robot_env=("CYCLONEDDS_URI=file:///x=y", "ROS_STATIC_PEERS="))
    clean = environment_for(search_of(settings), {"HOME": "/h", "CYCLONEDDS_URI": "old"}, keep_sourced=True)
    assert clean == {"HOME": "/h", "CYCLONEDDS_URI": "file:///x=y", "ROS_STATIC_PEERS": ""}


def test_without_a_home_the_log_of_ros_has_a_place() -> None:
    assert with_a_place_for_logs({})["ROS_LOG_DIR"]


def test_the_doctor_names_the_fix_for_a_middleware_that_is_not_installed(tmp_path: Path) -> None:
    settings = Settings(ros_root=install(tmp_path, "jazzy"), rmw="rmw_cyclonedds_cpp", distro="jazzy")
    middleware = next(finding for finding in diagnose(settings, BARE) if finding.title == "Middleware")
    assert middleware.ok is False
    assert "apt-get install ros-jazzy-rmw-cyclonedds-cpp" in middleware.fix


def test_a_folder_of_built_interface_packages_stands_for_them(tmp_path: Path) -> None:
    held, alone, later = tmp_path / "all", tmp_path / "alone", tmp_path / "later"
    for prefix in (held / "a", held / "b", alone):
        (prefix / "share" / "ament_index").mkdir(parents=True)
    (held / "notes").mkdir()
    root = install(tmp_path / "ros", "jazzy")
    found = find_ros(Settings(ros_root=root, interface_prefixes=(held, alone, later)), BARE)
    assert found.interface_prefixes == (held / "a", held / "b", alone, later)
