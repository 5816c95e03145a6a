"""README's commands, as printed, in a bare environment whose Python the system manages (Debian 12, Ubuntu 24.04)."""

import io
import json
import os
import subprocess
import tarfile
from pathlib import Path

import pytest

from support.source import ROOT

SYSTEM_PYTHON = Path("/usr/bin/python3")
# They fetch some 150 MB, and the demo takes half a minute of its own.
COMMAND_S = 600
pytestmark = [pytest.mark.full, pytest.mark.timeout(2 * COMMAND_S)]


@pytest.fixture(scope="module")
def in_checkout(tmp_path_factory):
    """Run a command in a fresh checkout, with nothing in the environment but what reaches the network."""
    asked = [SYSTEM_PYTHON, "-c", "import sysconfig; print(sysconfig.get_path('stdlib'))"]
    if (
        not SYSTEM_PYTHON.exists()
        or not Path(
            subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip(), "EXTERNALLY-MANAGED"
        ).exists()
    ):
        pytest.skip("needs a Python that the system manages")
    checkout, home = tmp_path_factory.mktemp("checkout"), tmp_path_factory.mktemp("home")
    archive = subprocess.run(["git", "-C", str(ROOT), "archive", "HEAD"], capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(checkout)
    network = {name: os.environ[name] for name in ("SSL_CERT_FILE", "HTTPS_PROXY") if name in os.environ}
    bare = {"PATH": "/usr/bin:/bin", "HOME": str(home), **network}

    def run(command):
        bash, pipe = ["bash", "-c", command], subprocess.PIPE
        return subprocess.run(
            bash, check=False, cwd=checkout, env=bare, stdout=pipe, stderr=pipe, text=True, timeout=COMMAND_S
        )

    return run


def of_readme(beginning, end):
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    return next(line for line in lines if line.startswith(beginning) and line.endswith(end))


def test_the_demo_runs(in_checkout):
    ended = in_checkout(of_readme("python3 -m venv", "ros2-mcp demo"))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "The tour took" in ended.stdout


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
