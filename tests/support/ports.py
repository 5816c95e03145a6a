"""Servers over HTTP and at a Unix socket: a port that nobody uses, and a process that listens."""

from __future__ import annotations

import fcntl
import itertools
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO

from support.agent import until
from support.processes import SHARED

END_S = 10.0
LISTENS_S = 60.0
PORTS = range(61000, 65000)
"""Above those that Linux gives to whoever asks for any (net.ipv4.ip_local_port_range), DDS in high domains included."""


def free_port(host: str = "127.0.0.1") -> int:
    """A port that nobody listens on, and that is given to no other test on this machine as long as this process runs.

    Each is a byte of one file, which this process locks: the kernel unlocks it when the process ends, however it does.
    """
    locks, tried = _locks()
    for port in itertools.islice(tried, len(PORTS)):
        with suppress(OSError), socket.socket() as probe:  # locked or bound by somebody else
            fcntl.lockf(locks, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, port)
            probe.bind((host, port))
            return port
    raise RuntimeError(f"All of the {len(PORTS)} ports for tests are taken.")


@cache
def _locks() -> tuple[IO[bytes], Iterator[int]]:
    """The file, which stays open (closing it would unlock all), and all ports again and again, each process's turn."""
    first = os.getpid() % len(PORTS)
    return (SHARED / "ros2-mcp-test-ports.lock").open("ab"), itertools.cycle([*PORTS[first:], *PORTS[:first]])


def until_listening(host: str, port: int) -> None:
    """Wait until somebody accepts connections."""
    deadline = time.monotonic() + LISTENS_S
    while True:
        try:
            socket.create_connection((host, port), 1.0).close()
            return
        except OSError:
            assert time.monotonic() < deadline, f"nobody listens on {host}:{port}"
            time.sleep(0.05)


@contextmanager
def listening(
    environment: dict[str, str],
    transport: str,
    *options: str,
    host: str = "127.0.0.1",
    log: IO[bytes] | None = None,
) -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """A server over HTTP for the time of a block: its port and its process. What it prints goes to `log`."""
    port = free_port(host)
    at = ("--transport", transport, "--host", host, "--port", str(port))
    process = subprocess.Popen(
        [sys.executable, "-m", "ros2_mcp", *at, *options], env=environment, stdout=log, stderr=log
    )
    try:
        until_listening(host, port)
        yield port, process
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextmanager
def serving(environment: dict[str, str], path: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A server at a Unix socket for the time of a block."""
    command = [sys.executable, "-m", "ros2_mcp", "--socket", str(path), "--tools", "all", *options]
    process = subprocess.Popen(command, env=environment)
    try:
        until(path.exists, LISTENS_S)
        yield process
    finally:
        process.terminate()
        process.wait(LISTENS_S)
