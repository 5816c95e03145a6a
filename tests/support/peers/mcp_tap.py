"""Between a client and a stdio server: `mcp_tap.py LOG SERVER [ARGUMENT...]` writes every message that passes.

Each line of the log is `{"at": monotonic time in s, "from": "client" or "server", "message": ...}`. The first one tells
the processes. What the client does to this process (signals, end of input), it does to the server.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from typing import IO, Any


def main(log_path: str, *command: str) -> int:
    log = open(log_path, "a", buffering=1, encoding="utf-8")  # noqa: SIM115, PTH123 - open until the process ends
    lock = threading.Lock()

    def note(side: str, message: Any) -> None:
        with lock:
            log.write(json.dumps({"at": time.monotonic(), "from": side, "message": message}) + "\n")

    begun = time.monotonic()
    server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert server.stdin and server.stdout
    note("tap", {"pids": [os.getpid(), server.pid], "begun": begun})

    def carry(side: str, lines: Iterable[bytes], to: IO[bytes]) -> None:
        for line in lines:
            note(side, json.loads(line))
            try:
                to.write(line)
                to.flush()
            except BrokenPipeError:
                return

    def from_client() -> None:
        carry("client", sys.stdin.buffer, server.stdin)  # type: ignore[arg-type]
        note("client", "end of input")
        server.stdin.close()  # type: ignore[union-attr]

    def pass_on(number: int, _: object) -> None:
        note("client", signal.Signals(number).name)
        server.send_signal(number)

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, pass_on)
    threading.Thread(target=from_client, daemon=True).start()
    carry("server", server.stdout, sys.stdout.buffer)
    code = server.wait()
    note("server", f"ended with {code}")
    return max(code, 0)


if __name__ == "__main__":
    os._exit(main(*sys.argv[1:]))  # a thread may still wait for input that never comes
