"""Every test talks to real ROS 2 processes on loopback, in a domain of its file of tests, and leaves none behind."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ros2_mcp_common import latch
from support.agent import Agent, agent_for
from support.demo_robot import build_interfaces, with_interfaces
from support.domains import reserved_domains
from support.observer import Observer, observing
from support.processes import peer_command, python_path, running
from support.tokens import leave_token

END_S = 10.0
os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(Path(__file__).with_name("quiet_fast_dds.xml")))

Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture(scope="module")
def domain_id() -> Iterator[int]:
    """The ROS domain of a file of tests, and the two after it: what one file kills, no other discovers."""
    with reserved_domains() as first:
        yield first


@pytest.fixture(scope="module")
def ros_environment(domain_id: int, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of every ROS process that a test starts; the state that servers keep is that file's alone."""
    state_home = tmp_path_factory.mktemp("state")
    leave_token(state_home)
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain_id),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "XDG_STATE_HOME": str(state_home),
        "PYTHONPATH": python_path(),
        "PYTHONUNBUFFERED": "1",
    }


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server with all tools, which the tests of a file share."""
    with agent_for(ros_environment, "--tools", "all") as client:
        yield client


@pytest.fixture
def start_agent(ros_environment: dict[str, str]) -> Iterator[Callable[..., Agent]]:
    """Start a server of this test's own: `start_agent("--read-only", ROS2_MCP_TOOLS="core")`."""
    with contextlib.ExitStack() as running:

        def begin(*options: str, **changed: str) -> Agent:
            return running.enter_context(agent_for({**ros_environment, **changed}, *options))

        yield begin


@pytest.fixture(scope="module")
def observer(ros_environment: dict[str, str]) -> Iterator[Observer]:
    """The observer of a file's tests, which alone judges what reached the robot; each has topics of its own."""
    with observing(ros_environment) as process:
        yield process


@pytest.fixture(scope="module")
def demo_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """The environment of a robot and of servers that know its own interfaces."""
    return with_interfaces(ros_environment, build_interfaces())


@pytest.fixture(scope="module")
def demo_robot(demo_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The simulated robot of a file of tests."""
    with running(demo_environment, sys.executable, "-m", "ros2_mcp_demo") as robot:
        yield robot


@pytest.fixture(autouse=True)
def _who_joined_leaves(request: pytest.FixtureRequest) -> Iterator[None]:
    """Subscribers that a test's observer got during the test are gone after it: a domain shows 32 participants only."""
    if "observer" not in request.fixturenames:
        yield
        return
    observer: Observer = request.getfixturevalue("observer")
    before = observer.joined()
    yield
    for by in observer.joined():
        if by not in before:
            observer.leave(by=by)


@pytest.fixture(autouse=True)
def _no_latch_stays(request: pytest.FixtureRequest) -> Iterator[None]:
    """A latch that a test sets in the state which its module shares, it resets: nothing would move in the next."""
    if "ros_environment" not in request.fixturenames:
        yield
        return
    state_home = Path(request.getfixturevalue("ros_environment")["XDG_STATE_HOME"])
    before = _set_latches(state_home)
    yield
    assert not _set_latches(state_home) - before, "the test has left a latch set"


def _set_latches(state_home: Path) -> set[Path]:
    return {path for path in state_home.glob(f"ros2-mcp/*/{latch.FILE}") if latch.Latch(path).look().is_set}


@pytest.fixture
def start(ros_environment: dict[str, str]) -> Iterator[Start]:
    """Start Python processes, `start("bridge_peer.py", "argument", env={...})`; all are ended after the test.

    A name that ends in .py is a script of support/peers; anything else is a module. stdin and stdout are pipes.
    A module that does not end within 10 s of SIGTERM fails the test. A script is killed then: a peer that stays is no
    fault of what is tested.
    """
    modules: list[subprocess.Popen[bytes]] = []
    scripts: list[subprocess.Popen[bytes]] = []

    def start_process(program: str, *arguments: str, env: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        is_script = program.endswith(".py")
        command = peer_command(program.removesuffix(".py")) if is_script else [sys.executable, "-m", program]
        process = subprocess.Popen(
            [*command, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**ros_environment, **(env or {})},
        )
        (scripts if is_script else modules).append(process)
        return process

    yield start_process
    for process in (*scripts, *modules):
        process.terminate()
    stubborn = [process.args for process in modules if not _ends_soon(process)]
    for process in scripts:
        _ends_soon(process)
    assert not stubborn, f"did not end on SIGTERM: {stubborn}"


def _ends_soon(process: subprocess.Popen[bytes]) -> bool:
    try:
        process.wait(END_S)
        return True
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    finally:
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
