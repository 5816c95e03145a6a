"""A slow network between this process and a command: `slow_pipe.py BITS_PER_S DELAY_S COMMAND...`.

What comes on stdin reaches the command's stdin, and what that writes comes out of stdout: not faster than the rate,
and after the delay. Much fits into the link, as into the buffers of a real one: who does not hold back waits long.
"""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
import time

PART_BYTES = 1500
"""Of one packet of a real network."""
IN_THE_LINK = 1_000_000 // PART_BYTES
"""A megabyte: sockets at both ends, ssh and routers hold as much."""


def carry(source: int, sink: int, bits_per_s: float, delay_s: float) -> None:
    """Carries one direction until the source or the sink ends."""
    under_way: queue.Queue[tuple[float, bytes]] = queue.Queue(IN_THE_LINK)

    def deliver() -> None:
        while True:
            due, part = under_way.get()
            time.sleep(max(0.0, due - time.monotonic()))
            if not part:
                os.close(sink)
                return
            try:
                rest = memoryview(part)
                while rest:
                    rest = rest[os.write(sink, rest) :]
            except OSError:
                os._exit(0)

    delivering = threading.Thread(target=deliver)
    delivering.start()
    free_at = 0.0
    while True:
        part = os.read(source, PART_BYTES)
        free_at = max(free_at, time.monotonic()) + len(part) * 8 / bits_per_s
        under_way.put((free_at + delay_s, part))
        if not part:
            break
    delivering.join()


def main() -> None:
    bits_per_s, delay_s, *command = sys.argv[1:]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin and process.stdout
    how = (float(bits_per_s), float(delay_s))
    there = threading.Thread(target=carry, args=(0, os.dup(process.stdin.fileno()), *how), daemon=True)
    process.stdin.close()
    there.start()
    carry(process.stdout.fileno(), 1, *how)
    os._exit(process.wait())


if __name__ == "__main__":
    main()
