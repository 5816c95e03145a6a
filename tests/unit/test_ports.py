"""The ports that tests give to servers: nobody else's, in whatever process."""

from __future__ import annotations

import os
import subprocess
import sys

from support.ports import PORTS, free_port
from support.processes import python_path

TAKE = "import sys; from support.ports import free_port; print(*[free_port() for _ in range(50)], flush=True); "


def test_processes_side_by_side_never_get_the_same_port() -> None:
    # All begin at the same port, as processes do whose ids differ by the number of ports.
    command = [sys.executable, "-c", f"import os; os.getpid = lambda: 7; {TAKE} sys.stdin.read()"]
    environment = {**os.environ, "PYTHONPATH": python_path()}
    pipe = subprocess.PIPE
    takers = [subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True) for _ in range(3)]
    try:
        lines = [taker.stdout.readline() for taker in takers if taker.stdout]
    finally:
        for taker in takers:
            taker.communicate()
    ports = [int(word) for line in lines for word in line.split()]
    assert len(ports) == len(set(ports)) == 150
    assert set(ports) <= set(PORTS)


def test_a_port_is_given_only_once() -> None:
    ports = [free_port() for _ in range(20)]
    assert len(set(ports)) == 20
