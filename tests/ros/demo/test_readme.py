"""README's commands, as printed, in a bare environment: with the system's Python, which the system manages (Debian 12,
Ubuntu 24.04), and with those that ROS2_MCP_PYTHONS names, such as `/opt/3.12/bin/python3:/opt/3.13/bin/python3`."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from support.source import ROOT

SYSTEM_PYTHON = "/usr/bin/python3"
PYTHONS = [SYSTEM_PYTHON, *filter(None, os.environ.get("ROS2_MCP_PYTHONS", "").split(os.pathsep))]
# They fetch some 150 MB, and the demo takes half a minute of its own.
COMMAND_S = 600
pytestmark = [pytest.mark.full, pytest.mark.timeout(2 * COMMAND_S)]


def is_managed(python):
    """Whether pip refuses to install beside this Python."""
    asked = [python, "-c", "import sysconfig; print(sysconfig.get_path('stdlib'))"]
    folder = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    return Path(folder, "EXTERNALLY-MANAGED").exists()


@pytest.fixture(scope="module", params=PYTHONS)
def in_checkout(request, tmp_path_factory):
    """Run a command in a fresh clone, with nothing in the environment but what reaches the network."""
    python = Path(request.param)
    if not python.exists() or (request.param == SYSTEM_PYTHON and not is_managed(python)):
        pytest.skip("needs a Python that the system manages")
    checkout, home = tmp_path_factory.mktemp("checkout"), tmp_path_factory.mktemp("home")
    subprocess.run(["git", "clone", "-q", str(ROOT), str(checkout)], check=True)
    network = {name: os.environ[name] for name in ("SSL_CERT_FILE", "HTTPS_PROXY") if name in os.environ}
    bare = {"PATH": f"{python.parent}:/usr/bin:/bin", "HOME": str(home), **network}

    def run(command):
        bash, pipe = ["bash", "-c", command], subprocess.PIPE
        return subprocess.run(
            bash, check=False, cwd=checkout, env=bare, stdout=pipe, stderr=pipe, text=True, timeout=COMMAND_S
        )

    return run


def of_readme(beginning, end):
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    return next(line for line in lines if line.startswith(beginning) and line.endswith(end))


@pytest.mark.promise(
    "README", "it reads topics and cameras, publishes, calls services, drives actions and sets parameters"
)
@pytest.mark.promise("README", "Needs Linux on x86_64 with Python 3.10 to 3.14")
@pytest.mark.promise("README", "uv run --extra jazzy ros2-mcp demo is all")
@pytest.mark.promise("README", "One command, nothing to source, nothing to install on the robot")
@pytest.mark.promise("README", "Then it starts a simulated robot made of ordinary ROS 2 nodes")
@pytest.mark.promise("README", "ROS 2 itself comes along")
@pytest.mark.promise("README", "Pictures and a transcript are left in the folder that it names")
@pytest.mark.promise("README", "a policy refuses it, the stop latches, and the operator resets it")
@pytest.mark.promise("README", "The first time this downloads ROS 2 and compiles, which takes some minutes")
def test_the_demo_runs(in_checkout):
    ended = in_checkout(of_readme("python3 -m venv", "ros2-mcp demo"))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "The tour took" in ended.stdout


def test_the_tests_run(in_checkout):
    """All are collected, and those of the house run: the whole suite has its own run."""
    command = of_readme("python3 -m venv", "--group test pytest")
    for ended in (in_checkout(f"{command} tests/house"), in_checkout(f"{command} --collect-only -q -n 0")):
        assert ended.returncode == 0, ended.stdout + ended.stderr


@pytest.mark.promise("README", "Nothing needs to be activated later")
@pytest.mark.promise("README", "On a machine without ROS 2, install '.[jazzy]'")
@pytest.mark.promise("README", "doctor says which ROS 2 it found, why, and how to mend what is wrong")
def test_it_installs_and_the_remedy_that_doctor_prints_mends_what_it_found(in_checkout):
    installed = in_checkout(of_readme("python3 -m venv", "pip install .") + " && ros2-mcp config cursor")
    assert installed.returncode == 0, installed.stdout + installed.stderr
    command = json.loads(installed.stdout[installed.stdout.index("{") :])["mcpServers"]["ros2"]["command"]

    told = in_checkout(f"{command} --ros-root /nowhere doctor")
    assert told.returncode == 1
    fix = next(line for line in told.stdout.splitlines() if "fix: Run: " in line)
    mended = in_checkout(fix.split("fix: Run: ")[1].split("; or source")[0])
    assert mended.returncode == 0, mended.stdout + mended.stderr
    assert in_checkout(f"{command} --ros-root /nowhere doctor").returncode == 0
