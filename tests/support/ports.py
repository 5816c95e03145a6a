"""Servers over HTTP and at a Unix socket: a port that nobody uses, and a process that listens."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from support.agent import until

END_S = 10.0
LISTENS_S = 60.0


def free_port(host: str = "127.0.0.1") -> int:
    """One that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return probe.getsockname()[1]


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
    environment: dict[str, str], transport: str, *options: str, host: str = "127.0.0.1"
) -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """A server over HTTP for the time of a block: its port and its process."""
    port = free_port(host)
    at = ("--transport", transport, "--host", host, "--port", str(port))
    process = subprocess.Popen([sys.executable, "-m", "ros2_mcp", *at, *options], env=environment)
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
        until(path.exists)
        yield process
    finally:
        process.terminate()
        process.wait(LISTENS_S)
