"""Every test talks to real ROS 2 processes on loopback, in a domain of its file of tests, and leaves none behind."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.domains import reserved_domains
from support.processes import peer_command, python_path

END_S = 10.0
os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(Path(__file__).with_name("quiet_fast_dds.xml")))

Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture(scope="module")
def domain_id() -> Iterator[int]:
    """The ROS domain of a file of tests, and the two after it: what one file kills, no other discovers."""
    with reserved_domains() as first:
        yield first


@pytest.fixture(scope="module")
def ros_environment(domain_id: int) -> dict[str, str]:
    """The environment of every ROS process that a test starts."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain_id),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": tempfile.gettempdir(),
        "PYTHONPATH": python_path(),
        "PYTHONUNBUFFERED": "1",
    }


@pytest.fixture
def start(ros_environment: dict[str, str]) -> Iterator[Start]:
    """Start Python processes, `start("bridge_peer.py", "argument", env={...})`; all are ended after the test.

    A name that ends in .py is a script of support/peers; anything else is a module. stdin and stdout are pipes.
    A process that does not end within 10 s of SIGTERM fails the test.
    """
    processes: list[subprocess.Popen[bytes]] = []

    def start_process(program: str, *arguments: str, env: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        is_script = program.endswith(".py")
        command = peer_command(program.removesuffix(".py")) if is_script else [sys.executable, "-m", program]
        process = subprocess.Popen(
            [*command, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**ros_environment, **(env or {})},
        )
        processes.append(process)
        return process

    yield start_process
    for process in processes:
        process.terminate()
    stubborn = [process.args for process in processes if not _ends_soon(process)]
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
