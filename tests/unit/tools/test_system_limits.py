"""A tool that finds no more files, memory or disk says so, and blames neither itself nor what it was asked."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.errors import BadInput, SystemLimit
from ros2_mcp.model.system_limits import system_limit
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import silent
from support.made_bridge import MadeBridge, robot_of

if sys.platform != "win32":
    import resource

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limits")
MOST_FILES = 300


@contextmanager
def no_file_left() -> Generator[None]:
    """This process can open nothing."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    held: list[int] = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (MOST_FILES, before[1]))
    try:
        with suppress(OSError):
            while True:
                held.append(os.open(os.devnull, os.O_RDONLY))
        yield
    finally:
        for descriptor in held:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


CALLS: dict[str, dict[str, Any]] = {
    "ros2_record_start": {"topic_names": ["/odom"]},
    "ros2_program_run": {"program": "1 + 1"},
}

FAILS: dict[str, dict[str, Any]] = {"ros2_record_start": {"topics": ["not a name"]}, "ros2_program_run": {}}
"""With these nothing is left running."""


@pytest.mark.parametrize("name", CALLS)
async def test_a_tool_that_can_open_no_file_names_the_limit(tmp_path: Path, name: str) -> None:
    robot = robot_of(MadeBridge())
    tools = Toolset(robot, BagStore(tmp_path), ["all"])
    if name not in tools.by_name:
        pytest.skip("needs the extra programs")
    try:
        with suppress(CallFailed):  # imports what it needs, while there are files
            await tools.call(name, {**CALLS[name], **FAILS[name]}, silent)
        with no_file_left(), pytest.raises(CallFailed) as failed:
            await tools.call(name, CALLS[name], silent)
    finally:
        await robot.jobs.close()
    said = str(failed.value)
    assert said.startswith("SystemLimit: This server cannot open another file") and f"({MOST_FILES})" in said
    assert "ulimit -n" in said and "--record-dir" not in said


def test_each_limit_of_the_system_is_told_by_its_name() -> None:
    for number, words in ((errno.ENOMEM, "memory"), (errno.ENOSPC, "disk is full"), (errno.EDQUOT, "quota")):
        limit = system_limit(OSError(number, os.strerror(number)))
        assert isinstance(limit, SystemLimit) and words in limit.message
    assert system_limit(PermissionError(errno.EACCES, "Permission denied")) is None
    assert system_limit(RuntimeError("failed (os error 2)")) is None


def test_an_error_on_purpose_keeps_its_words_but_where_no_file_is_left() -> None:
    for number, is_limit in ((errno.ENOSPC, False), (errno.EMFILE, True), (errno.ENFILE, True)):
        error = BadInput("It cannot be written.")
        error.__cause__ = OSError(number, os.strerror(number))
        assert (system_limit(error) is not None) is is_limit
