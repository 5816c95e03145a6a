"""Peers that are told to end do end, even where the middleware hangs: see docs/known-races.md."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.processes import END_S, peer_command, python_path

ROUNDS, LISTENERS = 150, 4
HANGING = """
import ctypes, sys
from support.leaving import leave_on_sigterm

libc = ctypes.PyDLL(None)  # whose functions keep the interpreter's lock, as those of rclpy do
leave_on_sigterm(lambda: libc.select(0, None, None, None, None))
print("ready", flush=True)
sys.stdin.read()
"""


def test_a_peer_that_hangs_outside_of_python_ends_on_sigterm() -> None:
    environment = {**os.environ, "PYTHONPATH": python_path()}
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", HANGING], stdin=pipe, stdout=pipe, env=environment) as process:
        try:
            assert process.stdout and process.stdout.readline() == b"ready\n"
            process.terminate()
            assert process.wait(END_S) == -signal.SIGALRM
        finally:
            process.kill()


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_listeners_that_leave_at_the_same_time_all_end(ros_environment: dict[str, str]) -> None:
    """Tells how many the middleware held up: about one in eight hundred on a machine with far too much to do."""
    held_up = 0
    for _ in range(ROUNDS):
        listeners = [
            subprocess.Popen(
                peer_command("bridge_peer", "listen", "/said", reliability),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=ros_environment,
            )
            for reliability in ("RELIABLE", "BEST_EFFORT") * (LISTENERS // 2)
        ]
        try:
            for listener in listeners:
                assert listener.stdout and listener.stdout.readline() == b"ready\n"
            for listener in listeners:
                listener.terminate()
            codes = [listener.wait(4 * END_S) for listener in listeners]
        finally:
            for listener in listeners:
                listener.kill()
                listener.communicate()
        assert set(codes) <= {0, -signal.SIGALRM}
        held_up += codes.count(-signal.SIGALRM)
    print(f"held up by the middleware: {held_up} of {ROUNDS * LISTENERS}")
