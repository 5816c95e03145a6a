"""How every test is run: async ones on asyncio, watched for tasks that they leave; long ones only when asked for."""

from __future__ import annotations

import asyncio
import inspect
import os
import sys
from collections.abc import AsyncIterator, Generator, Iterator
from pathlib import Path
from typing import TypeVar

import pytest

from support.rounds import FULL
from support.tasks import running_tasks
from support.turns import turn

Report = TypeVar("Report", pytest.CollectReport, pytest.TestReport)
pytest_plugins = ("support.leaves_nothing", "support.running_tests")
ROS = Path(__file__).with_name("ros")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
"""As on users' machines: each of the thousand servers and bridges would be compiled anew, which takes 0.6 s."""
TOLD_LINES = 25
"""Of a failure's text at once; all of it stands in the summary at the end."""
TASKS_END_S = 1.0
"""A task that was cancelled needs a few rounds of the loop until it has ended; a busy machine stretches them."""


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(collector: pytest.Module, name: str, obj: object) -> None:
    """Every async test is anyio's to run, without a mark of its own."""
    if collector.istestfunction(obj, name) and inspect.iscoroutinefunction(obj):
        pytest.mark.anyio(obj)
        pytest.mark.usefixtures("no_task_is_left")(obj)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """How many files run side by side: with ROS two for each processor, as half of their time is waiting."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    has_turns = FULL or not _several_files_wait_for_ros(config)
    return 0 if has_turns else 2 * len(os.sched_getaffinity(0))


def _several_files_wait_for_ros(config: pytest.Config) -> bool:
    named = {(config.invocation_params.dir / argument.partition("::")[0]).resolve() for argument in config.args}
    whole_folders = [path for path in named if path.is_dir() and (path in ROS.parents or path.is_relative_to(ROS))]
    return bool(whole_folders) or sum(path.is_relative_to(ROS) for path in named) > 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that wait for ROS begin first; what needs many rounds, long times or a quiet machine must be asked for."""
    items.sort(key=lambda item: not item.path.is_relative_to(ROS))
    if FULL:
        return
    skip = pytest.mark.skip(reason="set ROS2_MCP_FULL=1 on a quiet machine")
    for item in items:
        if item.get_closest_marker("full"):
            item.add_marker(skip)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """What keeps a whole file from being run on this machine."""
    return _failed_for_want((yield))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """What keeps a test from being run on this machine."""
    return _failed_for_want((yield))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """A whole run that is ended at its bound has told what failed until then, though its summary never comes."""
    if report.failed and os.environ.get("CI") == "true" and "PYTEST_XDIST_WORKER" not in os.environ:
        told = report.longreprtext.splitlines()[-TOLD_LINES:]
        sys.stderr.write("\n".join(["", f"{report.when} of {report.nodeid} failed:", *told, ""]))
        sys.stderr.flush()


def _failed_for_want(report: Report) -> Report:
    """On a machine of continuous integration (`CI=true`) nothing is skipped because something is not installed."""
    if report.skipped and os.environ.get("CI") == "true" and isinstance(report.longrepr, tuple):
        reason = report.longrepr[2].removeprefix("Skipped: ")
        if reason.startswith("needs "):
            report.outcome, report.longrepr = "failed", f"With CI=true this must be there: {reason}"
    return report


@pytest.fixture(autouse=True)
def turn_of_the_test(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """While a test that is marked `alone` runs, no test of another worker does."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        yield
        return
    folder_of_all_workers = tmp_path_factory.getbasetemp().parent
    with turn(folder_of_all_workers) as its_own:
        if not request.node.get_closest_marker("alone"):
            yield
            return
        with its_own.alone():
            yield


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
async def no_task_is_left(anyio_backend: str) -> AsyncIterator[None]:
    """Fails the test if a task runs on that it has begun; those of fixtures of the whole file may."""
    before = running_tasks()
    yield
    loop = asyncio.get_running_loop()
    deadline = loop.time() + TASKS_END_S
    while (left := running_tasks() - before) and loop.time() < deadline:
        await asyncio.sleep(0.01)
    assert not left, left
