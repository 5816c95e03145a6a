"""The bootstrap goes through every login shell, as sshd starts it, whatever its start-up files print."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from ros2_mcp.link.bootstrap import Arrival, bootstrap
from ros2_mcp_common.start.finding import Search
from ros2_mcp_common.start.stage1 import MARKER
from support.rounds import QUICK

SHELLS = ("bash", "dash", "busybox", "zsh", "fish", "tcsh", "ksh", "mksh")
ON_EVERY_MACHINE = ("bash", "dash")
READS_A_FILE = ("bash", "zsh", "fish", "tcsh")
"""Those that read a start-up file when sshd runs a command in them."""
START_UP_FILES = (".bashrc", ".zshenv", ".config/fish/config.fish", ".tcshrc", ".kshrc", ".mkshrc", ".profile")
PRINTS = "printf 'Welcome\\000\\377 to the robot\\n'\n"
PATIENCE_S = 60.0
SILENT_S = 3.0
"""Stage 1 answers within 0.1 s; a start-up file that swallows it never will."""


def log_in(
    shell: str, home: Path, start_up: str = PRINTS, timeout_s: float = PATIENCE_S, path: str = os.environ["PATH"]
) -> tuple[int | None, Arrival]:
    """Runs the bootstrap as sshd would in this login shell, without any ROS; None for a login that does not end."""
    program = shutil.which(shell)
    if not program or (QUICK and shell not in ON_EVERY_MACHINE):
        pytest.skip(f"needs {shell}")
    for name in START_UP_FILES:
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text(start_up)
    start = bootstrap((), Search(ros_root=str(home), distro="none"))
    env = {"PATH": path, "HOME": str(home), "SSH_CLIENT": "10.0.0.1 1 22", "ENV": str(home / ".kshrc")}
    argv = [program, *(["sh"] if shell == "busybox" else []), "-c", " ".join(start.argv)]
    with subprocess.Popen(
        argv,
        env=env,
        cwd=home,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        try:
            output, _ = process.communicate(start.pack(), timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return None, start.arrival
    start.arrival.feed(output)
    return process.returncode, start.arrival


@pytest.mark.parametrize("shell", SHELLS)
def test_every_login_shell_takes_it_and_what_it_prints_is_noise(shell: str, tmp_path: Path) -> None:
    _, arrival = log_in(shell, tmp_path)
    assert [report.stage for report in arrival.reports] == ["reached"]
    assert arrival.failure
    assert "No ROS 2 found there" in arrival.failure.message
    assert arrival.noise == (b"Welcome\0\xff to the robot\n" if shell in READS_A_FILE else b"")


@pytest.mark.parametrize("shell", ["bash", "tcsh"])  # all of them execute the same script
def test_a_shim_of_a_version_that_is_not_switched_on_is_passed_over(shell: str, tmp_path: Path) -> None:
    shim = tmp_path / "shims" / "python3"
    shim.parent.mkdir()
    shim.write_text("#!/bin/sh\necho pyenv: python3: command not found >&2\nexit 127\n")
    shim.chmod(0o755)
    _, arrival = log_in(shell, tmp_path, path=f"{shim.parent}:/usr/bin:/bin")
    assert [report.stage for report in arrival.reports] == ["reached"]


@pytest.mark.parametrize("shell", ["bash", "zsh"])  # fish and tcsh go on
def test_a_start_up_file_that_ends_the_login_is_said_to(shell: str, tmp_path: Path) -> None:
    ended, arrival = log_in(shell, tmp_path, "exit 0\n")
    reason = arrival.explain(ended)
    assert reason
    assert "ended before the bridge started" in reason.message
    assert "start-up file" in reason.hint


def test_a_start_up_file_that_takes_the_input_never_reaches_a_marker(tmp_path: Path) -> None:
    ended, arrival = log_in("bash", tmp_path, "exec cat\n")
    assert ended == 0
    assert not arrival.reports
    assert arrival.noise or arrival.failure  # cat gives back what was sent


def test_a_start_up_file_that_loops_is_silence(tmp_path: Path) -> None:
    ended, arrival = log_in("bash", tmp_path, "while :; do sleep 0.1; done\n", SILENT_S)
    assert (ended, arrival.reports, arrival.noise) == (None, [], b"")


def test_a_start_up_file_that_fakes_a_marker_deceives_nobody(tmp_path: Path) -> None:
    fake = MARKER.decode().replace("\0", "\\000") + "0123456789abcdef "
    _, arrival = log_in("bash", tmp_path, f'printf \'{fake}{{"stage": "bridge"}}\\n\'\n')
    assert not arrival.is_through
    assert [report.stage for report in arrival.reports] == ["reached"]
