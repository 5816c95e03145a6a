"""A step of `.ci/run` ends within 30 s of its bound and names what hangs: hangs of each kind are planted here."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from support.browser import CHROMIUM
from support.processes import ROOT

pytestmark = pytest.mark.timeout(600)  # on a busy machine several bounds are tried
STEP = [sys.executable, str(ROOT / ".ci/step.py")]
MARK = "ROS2_MCP_CI"
BOUNDS_S = (3, 10, 30, 60)
"""The first that lets the command reach the hang is judged: on a busy machine pytest or Chromium starts in seconds."""
REACHED_BEFORE_S = 1.0
"""So long before the bound at least: pytest has yet to finish its tests then, and Chromium to start what draws."""
ENDED_WITHIN_S = 30
"""Seconds after the bound within which a step has ended everything."""
LONG_BOUND_S = 300
"""For steps that end by themselves."""
BOUND_STATUS, LEFT_STATUS = 124, 3
SIDE_BY_SIDE = 3
UV = os.environ.get("UV") or shutil.which("uv") or shutil.which("uv", path=str(ROOT / ".venv-uv/bin"))
"""`uv run` names itself there."""

HANGS_IN_C = """
import ctypes, pathlib
def test_that_waits_in_c():
    pathlib.Path({ready!r}).touch()
    ctypes.PyDLL(None).sleep(1000)  # and keeps the GIL
"""
HANGS_IN_A_THREAD = """
import pathlib, threading
def wait_for_ever():
    pathlib.Path({ready!r}).touch()
    threading.Event().wait()
def test_that_leaves_a_thread():
    threading.Thread(target=wait_for_ever).start()
"""
HANGS_IN_A_FIXTURE = """
import pathlib, pytest, time
@pytest.fixture
def slow_to_end():
    yield
    pathlib.Path({ready!r}).touch()
    time.sleep(1000)
def test_whose_fixture_does_not_end(slow_to_end): pass
"""
STOPS_ITS_WORKER = """
import os, pathlib, signal
def test_that_stops_its_worker():
    pathlib.Path({ready!r}).touch()
    os.kill(os.getpid(), signal.SIGSTOP)
"""
LEAVES_A_GRANDCHILD = """
import subprocess
def test_that_leaves_a_grandchild(capfd):
    with capfd.disabled():
        subprocess.run(["sh", "-c", "setsid sleep 1234 &"], check=True)
"""
LOSES_ITS_WORKER = """
import os
def test_that_ends_its_worker():
    os._exit(0)
def test_of_the_same_file(): pass
"""
WAITS_IN_C = """
import ctypes
def test_that_waits_in_c():
    while True:
        ctypes.CDLL(None).pause()  # and lets other threads run; a handler of a signal would not be called
"""
HANGS = {"c": HANGS_IN_C, "thread": HANGS_IN_A_THREAD, "fixture": HANGS_IN_A_FIXTURE, "stopped": STOPS_ITS_WORKER}


@dataclass(frozen=True)
class Ended:
    """How a step ended."""

    status: int
    output: str
    mark: str

    def left(self) -> list[str]:
        """What runs on of all that carried the mark or was named in the output."""
        named = {int(pid) for pid in re.findall(r"\bpid (\d+), session", self.output)}
        left = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                carries = f"{MARK}={self.mark}".encode() in (process / "environ").read_bytes()
                state = (process / "stat").read_text().rpartition(")")[2].split()[0]
                if state != "Z" and (carries or int(process.name) in named):
                    left.append((process / "cmdline").read_text())
            except OSError:
                continue  # it has ended
        return left


def run_step(command: Sequence[str], bound_s: float, **environment: str) -> Ended:
    """Runs a command as a step, with a mark that no other test has. A step that does not end in time fails the test."""
    mark = ":".join(filter(None, [os.environ.get(MARK), f"{os.getpid()}-{time.monotonic_ns()}"]))
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "UV_", "COV_"))}
    environment = {**kept, "PYTHONPATH": str(ROOT / "tests"), MARK: mark, **environment}
    ended = subprocess.run(
        [*STEP, "planted", str(bound_s), *command],
        check=False,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=bound_s + ENDED_WITHIN_S,
    )
    return Ended(ended.returncode, ended.stdout, mark)


def run_until_it_hangs(command: Sequence[str], reached_at: Callable[[], float], **environment: str) -> Ended:
    """Runs a command until it comes to its hang before the bound; `reached_at` is when it did, in Unix time."""
    for bound_s in BOUNDS_S:
        began = time.time()
        ended = run_step(command, bound_s, **environment)
        if began <= reached_at() < began + bound_s - REACHED_BEFORE_S:  # the bound counts from a little later
            return ended
    raise AssertionError(f"it did not come to the hang within {BOUNDS_S[-1]} s:\n{ended.output}")


def pytest_of(folder: Path, text: str, *options: str) -> tuple[list[str], Path]:
    """A run of pytest of one planted test, with this project's options; and the file that it touches as it hangs."""
    ready = folder / "ready"
    (folder / "test_planted.py").write_text(text.replace("{ready!r}", repr(str(ready))))
    configured = ["-c", str(ROOT / "pyproject.toml"), "--rootdir", str(folder), "-p", "support.running_tests"]
    return [sys.executable, "-m", "pytest", *configured, *options, str(folder / "test_planted.py")], ready


def hang_in_pytest(folder: Path, text: str, *options: str) -> Ended:
    command, ready = pytest_of(folder, text, *options)
    return run_until_it_hangs(command, lambda: ready.stat().st_mtime if ready.exists() else 0.0)


def hang_at_a_server(command: Callable[[str], list[str]], **environment: str) -> Ended:
    """Runs a client of an HTTP server on loopback that takes connections and never answers."""
    connected_at = [0.0]
    connections: list[socket.socket] = []

    def accept() -> None:
        while True:
            try:
                connections.append(silent.accept()[0])
            except OSError:
                return  # it was shut down
            connected_at.append(time.time())

    with socket.create_server(("127.0.0.1", 0)) as silent, ThreadPoolExecutor(1) as accepting:
        accepting.submit(accept)
        address = f"http://127.0.0.1:{silent.getsockname()[1]}/"
        try:
            return run_until_it_hangs(command(address), lambda: connected_at[-1], NO_PROXY="127.0.0.1", **environment)
        finally:
            silent.shutdown(socket.SHUT_RDWR)
            for connection in connections:
                connection.close()


def hang_in_uv(folder: Path) -> Ended:
    def install(address: str) -> list[str]:
        where = ["--python", sys.executable, "--target", str(folder / "target"), "--cache-dir", str(folder / "cache")]
        return [str(UV), "--no-config", "pip", "install", *where, "--index-url", address, "a-package-that-never-comes"]

    return hang_at_a_server(install, UV_HTTP_TIMEOUT="1000")


def hang_in_chromium(folder: Path) -> Ended:
    def look(address: str) -> list[str]:
        quiet = ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"]
        return [str(CHROMIUM), *quiet, f"--user-data-dir={folder}", "--dump-dom", address]

    return hang_at_a_server(look)


@pytest.fixture(scope="module")
def ends(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Future[Ended]]:
    """How each planted hang ended; they mostly wait, so some wait side by side."""
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        options = {"thread": ["-n0"], "fixture": ["-n0"], "c": ["-n1"], "stopped": ["-n1"]}
        futures = {
            name: pool.submit(hang_in_pytest, tmp_path_factory.mktemp(name), text, *options[name])
            for name, text in HANGS.items()
        }
        if UV:
            futures["uv"] = pool.submit(hang_in_uv, tmp_path_factory.mktemp("uv"))
        if CHROMIUM:
            futures["chromium"] = pool.submit(hang_in_chromium, tmp_path_factory.mktemp("chromium"))
    return futures  # all have ended: what runs on while a test runs would count as left behind by that test


@pytest.mark.parametrize(
    ("hang", "names"),
    [
        (
            "c",
            [
                r"gw\d-\d+, for \d+ s: call of test_planted.py::test_that_waits_in_c",
                r"test_that_waits_in_c \(|in test_",
            ],
        ),
        ("stopped", [r"gw\d-\d+, for \d+ s: call of test_planted.py::test_that_stops_its_worker", r", T, \d+ s"]),
        ("thread", ["has finished its tests, and its Python does not end", "wait_for_ever"]),
        ("fixture", ["teardown of test_planted.py::test_whose_fixture_does_not_end", "slow_to_end"]),
        ("uv", ["uv --no-config pip install .* a-package-that-never-comes"]),
        ("chromium", [r"chromium .*http://127\.0\.0\.1:", "--type=renderer"]),
    ],
)
def test_a_step_that_hangs_ends_and_names_what_hangs(
    ends: Mapping[str, Future[Ended]], hang: str, names: list[str]
) -> None:
    if hang not in ends:
        pytest.skip(f"needs {hang}")
    ended = ends[hang].result()
    assert ended.status == BOUND_STATUS, ended.output
    for name in names:
        assert re.search(name, ended.output), ended.output
    assert ended.left() == []


def test_a_grandchild_that_holds_the_pipe_holds_up_nothing_and_fails_the_step(tmp_path: Path) -> None:
    command, _ = pytest_of(tmp_path, LEAVES_A_GRANDCHILD, "-n0")
    ended = run_step(command, LONG_BOUND_S)
    assert ended.status == LEFT_STATUS
    assert "1 passed" in ended.output
    assert re.search(r"has left these processes behind.*\n.*sleep 1234", ended.output), ended.output
    assert ended.left() == []


def test_a_worker_that_is_lost_fails_the_run_by_the_name_of_its_test(tmp_path: Path) -> None:
    command, _ = pytest_of(tmp_path, LOSES_ITS_WORKER, "-n1")
    ended = run_step(command, LONG_BOUND_S)
    assert ended.status not in (0, BOUND_STATUS, LEFT_STATUS), ended.output
    assert "crashed while running 'test_planted.py::test_that_ends_its_worker'" in ended.output
    assert ended.left() == []


def test_a_test_that_waits_in_c_is_ended_by_its_own_time_out(tmp_path: Path) -> None:
    command, _ = pytest_of(tmp_path, WAITS_IN_C, "-n1", "-o", "timeout=2", "-o", "faulthandler_timeout=1")
    ended = run_step(command, LONG_BOUND_S)
    assert ended.status not in (0, BOUND_STATUS, LEFT_STATUS), ended.output
    assert re.search(r"test_planted.py\", line \d+ in test_that_waits_in_c", ended.output), ended.output
    assert "crashed while running 'test_planted.py::test_that_waits_in_c'" in ended.output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_runner_ends_all_that_it_has_started(tmp_path: Path, number: signal.Signals) -> None:
    mark = ":".join(filter(None, [os.environ.get(MARK), f"{os.getpid()}-{time.monotonic_ns()}"]))
    inner = [*STEP, "inner", str(LONG_BOUND_S), "sh", "-c", "echo started; setsid sleep 1234"]
    with subprocess.Popen(
        [*STEP, "outer", str(LONG_BOUND_S), *inner], env={**os.environ, MARK: mark}, stdout=subprocess.PIPE, text=True
    ) as outer:
        assert outer.stdout
        assert outer.stdout.readline() == "started\n"
        outer.send_signal(number)
        output, _ = outer.communicate(timeout=ENDED_WITHIN_S)
    assert outer.returncode == 128 + number
    assert Ended(outer.returncode, output, mark).left() == []


def test_the_status_of_a_step_is_that_of_its_command() -> None:
    assert run_step(["sh", "-c", "echo said; exit 5"], LONG_BOUND_S).status == 5
    assert run_step(["sh", "-c", "kill -9 $$"], LONG_BOUND_S).status == 128 + signal.SIGKILL
    fine = run_step(["sh", "-c", "printf 'said, and no more'"], LONG_BOUND_S)
    assert (fine.status, fine.output) == (0, "said, and no more\n")
