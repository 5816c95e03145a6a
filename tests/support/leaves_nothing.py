"""A plugin of pytest: no process that a test has started outlives it, nor one of a module's fixtures the module.

Whoever needs a moment to end is waited for. What is left after that is named, killed, and fails the test.
"""

from __future__ import annotations

import bisect
import os
import tempfile
import time
from collections.abc import Generator, Iterable
from pathlib import Path

import pytest

from support import own_processes, shared_memory
from support.own_processes import Process

BEGAN_AT = time.time()
WAITED_S = 0.2
"""A wait that is longer is told in the test's report."""


def pytest_configure() -> None:
    """From here on whatever is started is found again."""
    own_processes.mark()
    own_processes.note_kills()


def pytest_unconfigure() -> None:
    """When all workers have ended, what anybody has left in shared memory during this run is removed."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        for segment in shared_memory.dead_segments():
            if segment.at >= BEGAN_AT:
                shared_memory.remove_segment(segment)


def pytest_sessionstart(session: pytest.Session) -> None:
    """What is kept and logged goes to pytest's folder of this run, which a later one removes: even if this is killed.

    Nothing that a test latches outlives it, nor is anything of this machine's robots found by one.
    """
    run: Path = session.config._tmp_path_factory.getbasetemp()  # what the fixture `tmp_path_factory` gives
    for variable in ("XDG_STATE_HOME", "ROS_LOG_DIR", "TMPDIR"):
        folder = run / variable.lower()
        folder.mkdir(exist_ok=True)
        os.environ[variable] = str(folder)
    tempfile.tempdir = None  # asked for anew


class Watch:
    """Which of our processes ran before the test that runs now, and which test ran when."""

    def __init__(self) -> None:
        self._seen: set[int] = set()
        self._ours: set[int] = set()
        self._orphans: set[int] = set()
        self._lasting: set[int] = set()
        self._began_s: list[float] = []
        self._tests: list[str] = []

    def begin(self, test: str) -> None:
        """A test begins, whose fixtures may have to be set up first."""
        self.look()
        self._began_s.append(own_processes.boot_s())
        self._tests.append(test)

    def look(self) -> None:
        """What there is now is not the test's: it was there before, or is of a fixture that outlives the test."""
        now = own_processes.listed()
        self._ours = (self._ours & now) | {one.pid for one in own_processes.own(now - self._seen)}
        self._orphans = {one.pid for one in self._orphaned()}
        self._seen = now

    def lasts(self, before: set[int]) -> None:
        """What is new since then outlives the module."""
        self._lasting |= own_processes.listed() - before

    def left_by_test(self) -> list[Process]:
        """What the test has begun, without that of processes which outlive it; and whose parents have died in it."""
        new = own_processes.own(own_processes.listed() - self._seen)
        orphaned = [one for one in self._orphaned() if one.pid not in self._orphans]
        return [one for one in new if not _is_of(self._ours, one)] + orphaned

    def left_by_module(self) -> list[Process]:
        """All that is ours, without what fixtures of the whole session have started."""
        return [one for one in own_processes.own() if not _is_of(self._lasting, one)]

    def _orphaned(self) -> list[Process]:
        found = [one for pid in self._ours if (one := own_processes.process(pid))]
        return [one for one in found if os.getpid() not in own_processes.ancestors(one)]

    def end_session(self) -> None:
        """Nothing may outlive it."""
        self._lasting.clear()

    def told(self, processes: Iterable[Process]) -> str:
        """Who was left, by which test."""
        return "\n".join(
            f"  {one.pid} ({one.command}), in state {one.state}, started {own_processes.boot_s() - one.started_s:.1f} s"
            f" ago in the time of {self.test_at(one.started_s)}"
            for one in processes
        )

    def test_at(self, boot_s: float) -> str:
        """The test that ran, was set up or was torn down at that time of `own_processes.boot_s()`."""
        index = bisect.bisect(self._began_s, boot_s + 0.01) - 1
        return self._tests[index] if index >= 0 else "no test"


def _is_of(kept: set[int], one: Process) -> bool:
    """Whether it or one of its ancestors is among those."""
    return not kept.isdisjoint((one.pid, *own_processes.ancestors(one)))


_watch = Watch()
test_at = _watch.test_at


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """What runs now is not the test's."""
    _watch.begin(item.nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[object],
) -> Generator[None, object, object]:
    """What a fixture of a module has started is the module's."""
    if fixturedef.scope == "function":
        return (yield)
    before = own_processes.listed()
    try:
        return (yield)
    finally:
        _watch.look()
        if fixturedef.scope in ("session", "package"):
            _watch.lasts(before)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, None, None]:
    """Wait for what the test has started, and after the last of a module for all; fail for what stays."""
    is_last = nextitem is None or nextitem.path != item.path
    _watch.left_by_test()  # so that they can be named when they have ended
    try:
        yield
    except BaseException:
        item.add_report_section("teardown", "left behind", _end(item, is_last, nextitem is None))
        raise
    if told := _end(item, is_last, nextitem is None):
        pytest.fail(told, pytrace=False)


def _end(item: pytest.Item, is_last: bool, ends_session: bool) -> str:
    """What was left, which is killed; empty if nothing was."""
    if ends_session:
        _watch.end_session()
    begun_s = own_processes.boot_s()
    left = own_processes.wait_for_end(_watch.left_by_module if is_last else _watch.left_by_test)
    waited_s = own_processes.boot_s() - begun_s
    whose = "module" if is_last else "test"
    if waited_s > WAITED_S:
        item.add_report_section("teardown", "waited", f"{waited_s:.1f} s for the end of what the {whose} had started")
    if not left:
        return ""
    told = f"left behind by this {whose}, {waited_s:.1f} s after its end:\n{_watch.told(left)}"
    own_processes.kill(left)
    return told
