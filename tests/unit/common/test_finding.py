"""Finding ROS on a machine of which nothing is known: folders, processes and Pythons made for the purpose."""

from __future__ import annotations

import os
import pwd
import subprocess
from pathlib import Path

import pytest

from ros2_mcp_common.start.finding import Found, NotFound, Search, find, running
from ros2_mcp_common.start.nodes_here import WHEEL_GUARD, others_with_nodes, processes_in_ros

DISTRO = "jazzy"


@pytest.fixture(autouse=True)
def _only_what_a_test_makes(monkeypatch: pytest.MonkeyPatch) -> None:
    """No node of this machine's is found, nor a Python with rclpy, unless a test is about that."""
    monkeypatch.setattr("ros2_mcp_common.start.finding.running", lambda *_: None)


def machine(tmp_path: Path, **env: str) -> dict[str, str]:
    """An environment with a home folder, and a PATH on which there is nothing."""
    (tmp_path / "home").mkdir(exist_ok=True)
    (tmp_path / "bin").mkdir(exist_ok=True)
    return {"HOME": str(tmp_path / "home"), "PATH": str(tmp_path / "bin"), **env}


def program(path: Path, *lines: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["#!/bin/sh", *lines, ""]))
    path.chmod(0o755)
    return path


def prefix_with_rclpy(prefix: Path, setup: str = "") -> Path:
    (prefix / "lib" / "python3.12" / "site-packages" / "rclpy").mkdir(parents=True)
    (prefix / "setup.bash").write_text(setup)
    program(prefix / "bin" / "python3.12")
    return prefix


def installation(tmp_path: Path, *distros: str) -> Search:
    for distro in distros:
        prefix_with_rclpy(tmp_path / "ros" / distro)
    return Search(ros_root=str(tmp_path / "ros"))


def process(
    processes: Path, pid: int, files: str = "mnt:[1]", cmdline: str = "talker", maps: str = "", **env: str
) -> None:
    """A process as /proc tells of it."""
    folder = processes / str(pid)
    (folder / "ns").mkdir(parents=True)
    (folder / "ns" / "mnt").symlink_to(files)
    (folder / "environ").write_bytes(b"\0".join(f"{name}={value}".encode() for name, value in env.items()))
    (folder / "cmdline").write_text(cmdline)
    (folder / "maps").write_text(maps)


def processes_of(tmp_path: Path) -> Path:
    (tmp_path / "proc").mkdir()
    process(tmp_path / "proc", 1, AMENT_PREFIX_PATH="")
    (tmp_path / "proc" / "self").symlink_to("1")
    return tmp_path / "proc"


def in_ros(prefix: Path, **more: str) -> dict[str, str]:
    return {"AMENT_PREFIX_PATH": str(prefix), "ROS_DISTRO": DISTRO, "SECRET": "not taken", **more}


def test_the_nodes_that_run_tell_overlays_domain_and_middleware(tmp_path: Path) -> None:
    processes, prefix = processes_of(tmp_path), prefix_with_rclpy(tmp_path / "jazzy")
    overlays = f"/ws/install/a:{prefix}"
    own = {"ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "CYCLONEDDS_URI": "file:///etc/c.xml"}
    for pid in (10, 11):
        process(processes, pid, **{**in_ros(prefix, **own), "AMENT_PREFIX_PATH": overlays})
    process(processes, 12, **in_ros(prefix, ROS_DOMAIN_ID="9"))
    found = running(Search(), machine(tmp_path), processes)
    assert found
    assert (found.kind, found.distro, found.prefix) == ("running", DISTRO, prefix)
    assert own.items() <= found.environment.items()
    assert found.environment["AMENT_PREFIX_PATH"] == overlays
    assert "SECRET" not in found.environment
    assert found.scripts == ()
    assert found.why.startswith("2 running processes have it (1 another one): CYCLONEDDS_URI=file:///etc/c.xml, ")
    assert found.why.endswith("RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, ROS_DOMAIN_ID=7.")


def test_what_was_asked_for_stands_above_what_the_nodes_have(tmp_path: Path) -> None:
    processes, prefix = processes_of(tmp_path), prefix_with_rclpy(tmp_path / "jazzy")
    process(processes, 10, **in_ros(prefix, ROS_DOMAIN_ID="7", RMW_IMPLEMENTATION="rmw_zenoh_cpp"))
    search = Search(domain_id=3, rmw="rmw_fastrtps_cpp", env={"ROS_STATIC_PEERS": "10.0.0.7"})
    found = running(search, machine(tmp_path), processes)
    assert found
    asked_for = {"ROS_DOMAIN_ID": "3", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "ROS_STATIC_PEERS": "10.0.0.7"}
    assert asked_for.items() <= found.environment.items()
    assert running(Search(distro="humble"), machine(tmp_path), processes) is None


@pytest.mark.parametrize("library", ["/opt/ros/jazzy/lib/librcl.so", "/venv/ros_jazzy_rcl.libs/librcl-4e09.so"])
def test_nodes_are_asked_before_shells_that_were_sourced_however_many(tmp_path: Path, library: str) -> None:
    processes, prefix = processes_of(tmp_path), prefix_with_rclpy(tmp_path / "jazzy")
    for pid in (7, 8, 9):
        process(processes, pid, cmdline="bash", maps="… /usr/lib/librclone.so\n", **in_ros(prefix, ROS_DOMAIN_ID="0"))
    process(processes, 10, maps=f"7f00-7f01 r-xp 00000000 08:01 1234 {library}\n", **in_ros(prefix, ROS_DOMAIN_ID="7"))
    found = running(Search(), machine(tmp_path), processes)
    assert found and found.environment["ROS_DOMAIN_ID"] == "7"
    assert found.why == "1 running node has it: ROS_DOMAIN_ID=7."


def wheels(prefix: Path, packages: Path) -> Path:
    """Where wheels are, in folders as they make them; returns the Python, which tells of them."""
    for name in ("rclpy", "ros_kilted_rclpy-9.1.2.dist-info", "ros_kilted_rcl.libs"):
        (packages / name).mkdir(parents=True)
    told = f'{{"prefix": "{prefix}", "rclpy": "{packages}/rclpy/__init__.py"}}'
    return program(prefix / "bin" / "python3", f"echo '{told}'")


def test_a_simulated_robot_of_ours_whose_ros_is_wheels_is_a_robot_with_its_domain(tmp_path: Path) -> None:
    processes, prefix = processes_of(tmp_path), tmp_path / "demo"
    packages = prefix / "lib" / "python3.12" / "site-packages"
    wheels(prefix, packages)
    python = program(prefix / "bin" / "python3.12")
    of_wheels = {"AMENT_PREFIX_PATH": str(prefix), "LD_LIBRARY_PATH": str(packages / "ros_kilted_rcl.libs")}
    cmdline = f"{prefix}/bin/python\0-c\0…\0{packages}/ros2_mcp_demo\0ros2_mcp_demo"
    process(processes, 7, cmdline=cmdline, ROS_DOMAIN_ID="7", **of_wheels)
    found = running(Search(), machine(tmp_path), processes)
    assert found
    assert (found.kind, found.distro, found.python) == ("running", "kilted", str(python))
    assert (found.environment["ROS_DOMAIN_ID"], found.why[-16:]) == ("7", "ROS_DOMAIN_ID=7.")
    assert found.environment["LD_LIBRARY_PATH"] == of_wheels["LD_LIBRARY_PATH"]


@pytest.mark.parametrize("is_called_by_its_path", [True, False])
def test_a_node_whose_wheels_are_not_below_its_prefix_has_them_by_its_python(
    tmp_path: Path, is_called_by_its_path: bool
) -> None:
    processes, prefix = processes_of(tmp_path), tmp_path / "usr"
    python = wheels(prefix, tmp_path / "home" / ".local" / "lib" / "python3.12" / "site-packages")
    called = str(python) if is_called_by_its_path else "python3"
    process(processes, 7, cmdline=f"{called}\0talker.py", AMENT_PREFIX_PATH=str(prefix), ROS_DOMAIN_ID="7")
    (processes / "7" / "exe").symlink_to(python)
    found = running(Search(), machine(tmp_path), processes)
    assert found
    assert (found.kind, found.distro, found.python) == ("running", "kilted", str(python))
    assert found.environment["ROS_DOMAIN_ID"] == "7"


def test_bridges_of_ours_and_what_runs_in_a_container_do_not_count(tmp_path: Path) -> None:
    processes, prefix = processes_of(tmp_path), prefix_with_rclpy(tmp_path / "jazzy")
    process(processes, 10, cmdline="python3\0-c\0…ros2_mcp_bridge…", **in_ros(prefix))
    process(processes, 11, files="mnt:[2]", **in_ros(prefix))
    process(processes, 12, cmdline=f"python\0{prefix}/bin/ros2-mcp\0serve", **in_ros(prefix))
    assert running(Search(), machine(tmp_path), processes) is None


def test_a_node_that_was_started_by_hand_in_wheels_tells_its_domain(tmp_path: Path) -> None:
    """Its shell was not sourced: the start-up hook of the wheels leaves nothing but the libraries and its own mark."""
    processes, prefix = processes_of(tmp_path), tmp_path / "venv"
    python = wheels(prefix, prefix / "lib" / "python3.12" / "site-packages")
    cmdline = f"{python}\0talker.py"
    process(processes, 7, cmdline=cmdline, ROS_DOMAIN_ID="7", LD_LIBRARY_PATH="/x", **{WHEEL_GUARD: "1"})
    found = running(Search(), machine(tmp_path), processes)
    assert found
    assert (found.kind, found.distro, found.python) == ("running", "kilted", str(python))
    assert (found.environment["ROS_DOMAIN_ID"], found.why[-16:]) == ("7", "ROS_DOMAIN_ID=7.")


def test_root_executes_nothing_that_another_users_process_names(tmp_path: Path) -> None:
    processes, prefix = processes_of(tmp_path), prefix_with_rclpy(tmp_path / "jazzy")
    process(processes, 10, **in_ros(prefix))
    assert len(list(processes_in_ros(processes))) == 1
    assert list(processes_in_ros(processes, own=os.getuid() + 1)) == []


def test_users_whose_shared_memory_cannot_be_read_are_named_but_not_to_root(tmp_path: Path) -> None:
    processes = processes_of(tmp_path)
    process(processes, 10, cmdline="talker\0--ros-args\0-r\0x:=y")
    process(processes, 11, cmdline="grep\0ros-args")
    nobody = 65534 if os.getuid() != 65534 else 1

    assert others_with_nodes(processes, own=nobody) == [pwd.getpwuid(os.getuid()).pw_name]
    assert others_with_nodes(processes, own=0) == []


def test_the_newest_installation_is_sourced_with_the_workspace_that_stands_on_it(tmp_path: Path) -> None:
    search, env = installation(tmp_path, "humble", "jazzy"), machine(tmp_path)
    install = tmp_path / "home" / "ros2_ws" / "install"
    install.mkdir(parents=True)
    (install / "setup.bash").write_text(f'COLCON_CURRENT_PREFIX="{tmp_path}/ros/humble"\n')
    newest = find(search, env)
    assert (newest.kind, newest.distro, len(newest.scripts)) == ("unsourced", "jazzy", 1)
    older = find(Search(ros_root=search.ros_root, distro="humble"), env)
    assert older.scripts == (tmp_path / "ros" / "humble" / "setup.bash", install / "setup.bash")


def test_a_workspace_that_was_given_is_sourced_and_one_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    search, env = installation(tmp_path, "jazzy"), machine(tmp_path)
    (tmp_path / "ws" / "install").mkdir(parents=True)
    (tmp_path / "ws" / "install" / "setup.bash").write_text("")
    found = find(Search(ros_root=search.ros_root, workspaces=(str(tmp_path / "ws"),)), env)
    assert found.scripts[-1] == tmp_path / "ws" / "install" / "setup.bash"
    with pytest.raises(NotFound, match=r"has no install/setup\.bash"):
        find(Search(ros_root=search.ros_root, workspaces=("/nowhere",)), env)


@pytest.mark.parametrize("place", ["miniforge3/envs/ros", "project/.pixi/envs/default", "miniconda3"])
def test_an_environment_of_conda_or_pixi_is_found_and_switched_on(tmp_path: Path, place: str) -> None:
    env = machine(tmp_path)
    prefix = prefix_with_rclpy(Path(env["HOME"]) / place)
    (prefix / "conda-meta").mkdir()
    (prefix / "conda-meta" / "ros-humble-rclpy-3.3.11-np126py311h_0.json").write_text("{}")
    found = find(Search(ros_root="/nowhere"), env)
    assert (found.kind, found.distro, found.python) == ("conda", "humble", f"{prefix}/bin/python3")
    assert found.environment["CONDA_PREFIX"] == str(prefix)
    assert found.environment["PATH"].startswith(f"{prefix}/bin:")
    assert found.scripts == (prefix / "setup.bash",)


def test_a_workspace_in_which_ros_was_built_is_an_installation(tmp_path: Path) -> None:
    env = machine(tmp_path)
    install = prefix_with_rclpy(Path(env["HOME"]) / "ros2_rolling" / "install")
    found = find(Search(ros_root="/nowhere"), env)
    assert (found.kind, found.prefix, found.scripts) == ("built", install, (install / "setup.bash",))


def test_a_python_on_path_that_has_wheels_is_found_behind_others_that_have_none(tmp_path: Path) -> None:
    env, packages = machine(tmp_path), tmp_path / "venv" / "lib" / "python3.12" / "site-packages"
    program(tmp_path / "bin" / "python3", """echo '{"prefix": "/usr", "rclpy": null}'""")
    program(tmp_path / "shims" / "python3", "echo 'pyenv: python3: command not found' >&2; exit 127")
    python = wheels(tmp_path / "venv", packages)
    env["PATH"] = f"{tmp_path}/shims:{tmp_path}/bin:{tmp_path}/empty:{tmp_path}/venv/bin"
    found = find(Search(ros_root="/nowhere"), env)
    assert (found.kind, found.distro, found.python) == ("wheels", "kilted", str(python))
    assert str(packages / "ros_kilted_rcl.libs") in found.environment["LD_LIBRARY_PATH"]


def test_an_environment_that_is_sourced_already_wins(tmp_path: Path) -> None:
    search, prefix = installation(tmp_path, "kilted"), prefix_with_rclpy(tmp_path / "opt" / "jazzy")
    found = find(search, machine(tmp_path, **in_ros(prefix)))
    assert (found.kind, found.distro) == ("sourced", "jazzy")


def test_a_distribution_that_is_too_old_says_so(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="foxy is too old"):
        find(installation(tmp_path, "foxy"), machine(tmp_path))


def test_nothing_at_all_names_the_containers_that_run(tmp_path: Path) -> None:
    env = machine(tmp_path)
    with pytest.raises(NotFound) as nothing:
        find(Search(ros_root="/nowhere"), env)
    assert "No ROS 2 found there" in nothing.value.message
    assert "container" not in nothing.value.hint
    assert all(option in nothing.value.hint for option in ("--bridge-python PATH", "--workspace DIR"))
    program(tmp_path / "bin" / "docker", "echo 'nav (ros:jazzy)'")
    with pytest.raises(NotFound) as contained:
        find(Search(ros_root="/nowhere"), env)
    assert "nav (ros:jazzy). Add ?container=NAME" in contained.value.hint


def test_what_was_asked_for_and_is_not_there_names_what_is(tmp_path: Path) -> None:
    search = installation(tmp_path, "humble", "jazzy")
    with pytest.raises(NotFound, match="iron was asked for and is not there; found: humble, jazzy"):
        find(Search(ros_root=search.ros_root, distro="iron"), machine(tmp_path))
    with pytest.raises(NotFound) as none:
        find(Search(ros_root="/nowhere", distro="iron"), machine(tmp_path))
    assert "--distro iron" in none.value.hint
    with pytest.raises(NotFound, match="The Python /no/python is not there"):
        find(Search(python="/no/python"), machine(tmp_path))


def test_setup_files_are_sourced_whatever_their_paths_contain_and_cannot_reach_the_stream(tmp_path: Path) -> None:
    setup = tmp_path / 'it\'s "$HOME"' / "setup.bash"
    setup.parent.mkdir()
    setup.write_text('echo printed; read -r line; export SOURCED="yes $line"\n')
    found = Found("unsourced", DISTRO, tmp_path, "", "sh", (setup,), {"PATH": "/usr/bin:/bin"})
    argv, env = found.running(["sh", "-c", 'printf "%s|" "$SOURCED" "$1"; cat', "sh", "it's"])
    done = subprocess.run(argv, env=env, input="stream", capture_output=True, text=True, timeout=30, check=True)
    assert (done.stdout, done.stderr) == ("yes |it's|stream", "printed\n")
