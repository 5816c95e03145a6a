"""Each process of pytest notes what it runs, so that a step which reaches its bound can say which tests had not ended.

A plugin of pytest. It does nothing unless `.ci/step.py` names a folder in the environment; the file there is called
after the worker and its pid, such as `gw0-1234`.
"""

from __future__ import annotations

import atexit
import os
from pathlib import Path

import pytest

FOLDER = "ROS2_MCP_RUNNING_TESTS"


def pytest_configure(config: pytest.Config) -> None:
    if folder := os.environ.get(FOLDER):
        worker = os.environ.get("PYTEST_XDIST_WORKER", "pytest")
        config.pluginmanager.register(RunningTests(Path(folder, f"{worker}-{os.getpid()}")), "running_tests")


class RunningTests:
    """Keeps the note of this process up to date; it goes with the process, unless that does not end."""

    def __init__(self, note: Path) -> None:
        # Kept open: a test may take another user's id for a while, who must not write here by name.
        self._descriptor = os.open(note, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self._say("collects tests, or waits for its workers")
        atexit.register(note.unlink, missing_ok=True)  # after the last thread that is not a daemon

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self._say(f"setup of {item.nodeid}")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> None:
        self._say(f"call of {item.nodeid}")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        self._say(f"teardown of {item.nodeid}")

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self._say(f"between tests, after {nodeid}")

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self) -> None:
        self._say("has finished its tests, and its Python does not end")

    def _say(self, what: str) -> None:
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, what.encode(), 0)
