"""Stands between a server and its bridge, as `--bridge-python`, and notes for how long the server was silent.

silence_peer FILE PYTHON ARGUMENTS...: runs that Python and hands on its stdin. Each silence of more than 0.1 s is a
line of the file: when it ended (CLOCK_MONOTONIC) and its length, in s. While bytes wait here unread nobody is silent.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from pathlib import Path

TOLD_S = 0.1


def main(file: str, *command: str) -> None:
    child = subprocess.Popen(command, stdin=subprocess.PIPE)
    assert child.stdin
    waiting = select.poll()
    waiting.register(0, select.POLLIN)
    with Path(file).open("a") as told:
        heard = 0.0
        while True:
            came_late = not waiting.poll(0) and waiting.poll()
            now = time.monotonic()
            if came_late and heard and now - heard > TOLD_S:
                told.write(f"{now} {now - heard}\n")
                told.flush()
            data = os.read(0, 1 << 20)
            heard = time.monotonic()
            if not data:
                break
            child.stdin.write(data)
            child.stdin.flush()
    child.stdin.close()
    sys.exit(child.wait())


main(*sys.argv[1:])
