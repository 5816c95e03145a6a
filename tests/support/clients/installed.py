"""Clients from npm, in pinned versions, in a cache outside the repository."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

VARIABLE = "ROS2_MCP_TEST_CLIENTS"
"""The folder of the cache, where it is not to be below XDG_CACHE_HOME."""
INSTALL_S = 300.0
"""Up to 430 MB are fetched; measured: 5 to 10 s from a mirror nearby."""


def cache() -> Path:
    if given := os.environ.get(VARIABLE):
        return Path(given)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home, "ros2-mcp", "test-clients")


def installed(package: str, version: str, pattern: str) -> Path:
    """The program that matches the pattern below `node_modules` of the package in this version; fetched once.

    The test is skipped where it cannot be fetched.
    """
    folder = cache() / f"{package.removeprefix('@').replace('/', '-')}-{version}"
    if not folder.exists():
        _install(folder, f"{package}@{version}")
    return next(folder.joinpath("node_modules").glob(pattern))


def _install(folder: Path, package: str) -> None:
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip(f"needs npm, or {package} in the folder that {VARIABLE} names")
    folder.parent.mkdir(parents=True, exist_ok=True)
    # Beside its place, so that a half fetched one is never used.
    with tempfile.TemporaryDirectory(dir=folder.parent) as making:
        Path(making, "package.json").write_text('{"private": true}')
        # No scripts: the programs lie in packages of their own, one for each platform.
        options = ("--ignore-scripts", "--no-audit", "--no-fund", "--no-package-lock", "--loglevel=error")
        run = subprocess.run(
            [npm, "install", *options, package],
            cwd=making,
            capture_output=True,
            text=True,
            timeout=INSTALL_S,
            check=False,
        )
        if run.returncode:
            pytest.skip(f"needs {package} from npm: {run.stderr[-300:]}")
        Path(making).rename(folder)
        Path(making).mkdir()  # for the end of the block
