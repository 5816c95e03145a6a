"""`ros2-mcp doctor --robot …` tells each stage on the way to a robot, and lets a person accept its host key."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from support.far_side import engine
from support.sshd import Sshd

PATIENCE_S = 150.0
"""It starts a bridge over ssh, and looks for what there is: 40 s and more on a busy machine."""

pytestmark = pytest.mark.timeout(400)


def doctor(far: Sshd, *options: str) -> list[str]:
    """The words of the command line."""
    ssh = [f"--ssh-option={word}" for word in options or far.options()]
    return [sys.executable, "-m", "ros2_mcp", "doctor", "--robot", far.address(), *ssh]


def test_each_stage_is_told(far: Sshd, ros_environment: dict[str, str]) -> None:
    (far.home / ".bashrc").write_text("echo Welcome to the robot\n")
    try:
        ran = subprocess.run(
            doctor(far), check=False, env=ros_environment, capture_output=True, text=True, timeout=PATIENCE_S
        )
    finally:
        (far.home / ".bashrc").unlink()
    assert ran.returncode == 0, ran.stdout + ran.stderr
    told = [line for line in ran.stdout.splitlines() if not line.startswith(" ")]
    titles = [match[1] for line in told if (match := re.match(r"\[(?:ok  |note)\] ([^:]+):", line))]
    stages = ["Program", "Command", "Login", "Reached", "ROS 2", "Bridge", "Robot"]
    assert [title for title in titles if title in stages] == stages
    assert f"Reached: {far.address()}" in ran.stdout
    assert "Welcome to the robot" in ran.stdout


def test_what_is_wrong_is_told_with_the_way_out(far: Sshd, ros_environment: dict[str, str], tmp_path: Path) -> None:
    words = doctor(far, *far.options(known_hosts=tmp_path / "none"))
    ran = subprocess.run(
        words,
        check=False,
        env=ros_environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        stdin=subprocess.DEVNULL,
    )
    assert ran.returncode == 1
    assert "[BAD ] Way in: The host key of 127.0.0.1 is not known here" in ran.stdout
    fix = next(line for line in ran.stdout.splitlines() if "fix: Run once in a terminal" in line)
    assert "doctor" not in fix  # the command that has just been run asks nothing without a terminal
    known = f"-oUserKnownHostsFile={tmp_path / 'none'}"
    assert "compare the key: ssh " in fix and known in fix
    assert fix.endswith(f" -p {far.port} {far.user}@127.0.0.1")


def test_a_person_at_a_terminal_accepts_a_host_key(far: Sshd, ros_environment: dict[str, str], tmp_path: Path) -> None:
    known = tmp_path / "known"
    words = doctor(far, *far.options(known_hosts=known))
    terminal, its_side = pty.openpty()
    # ssh asks at the controlling terminal, which a new session gets from this program of Debian's base.
    on_terminal = ["setsid", "--ctty", "--wait", *words]
    process = subprocess.Popen(on_terminal, env=ros_environment, stdin=its_side, stdout=its_side, stderr=its_side)
    os.close(its_side)
    said, deadline, has_answered = "", time.monotonic() + PATIENCE_S, False
    while time.monotonic() < deadline:
        try:
            said += os.read(terminal, 4096).decode(errors="replace")
        except OSError:  # it has ended
            break
        if "continue connecting" in said and not has_answered:
            os.write(terminal, b"yes\n")
            has_answered = True
    os.close(terminal)
    assert process.wait(PATIENCE_S) == 0, said
    assert "fingerprint" in said and "[ok  ] Bridge" in said
    assert f"[127.0.0.1]:{far.port}" in known.read_text()


def test_a_host_is_not_taken_for_its_container_and_an_engine_that_is_down_is_to_be_started(
    far: Sshd, ros_environment: dict[str, str], tmp_path: Path
) -> None:
    (far.home / ".bashrc").write_text(f"PATH={engine(tmp_path, ('env',))}:$PATH\n")
    words = doctor(far)
    words[words.index(far.address())] = far.address(query="?container=gone")
    try:
        ran = subprocess.run(
            words, check=False, env=ros_environment, capture_output=True, text=True, timeout=PATIENCE_S
        )
    finally:
        (far.home / ".bashrc").unlink()
    assert ran.returncode == 1
    assert f"Reached: {far.address()} (the host, not yet the container), " in ran.stdout
    assert "its container engine is not: Cannot connect to the Docker daemon." in ran.stdout
    assert "fix: Start the engine there" in ran.stdout


@pytest.mark.parametrize("way", ["docker://nobody", "ssh://robot"])
def test_a_program_that_is_not_there_is_told(ros_environment: dict[str, str], tmp_path: Path, way: str) -> None:
    words = [sys.executable, "-m", "ros2_mcp", "doctor", "--robot", way]
    environment = {**ros_environment, "PATH": str(tmp_path)}
    ran = subprocess.run(words, check=False, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert ran.returncode == 1
    assert f"[BAD ] Program: {way.partition(':')[0]} is not on PATH" in ran.stdout
