"""Memory that was freed is kept for the next large message."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COPIES, SIZE = 20, 8_000_000
FAULTS = f"""
import resource
from ros2_mcp_common.allocation import keep_freed_memory
if {{}}:
    keep_freed_memory()
def copies():
    whole = bytearray({SIZE})
    return [bytes(whole), bytes(whole)]
copies()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range({COPIES}):
    copies()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(*, kept: bool, **tuned: str) -> int:
    """Page faults of copying large messages, in a process of its own."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    ran = subprocess.run(
        [sys.executable, "-c", FAULTS.format(kept)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env={**environment, **tuned},
    )
    return int(ran.stdout)


@pytest.mark.skipif(sys.platform != "linux" or not os.confstr("CS_GNU_LIBC_VERSION"), reason="glibc alone is told")
def test_large_messages_do_not_fault_each_page_anew() -> None:
    pages = COPIES * 3 * SIZE // os.sysconf("SC_PAGESIZE")
    assert faults(kept=False) > pages / 2
    assert faults(kept=True) < pages / 100
    assert faults(kept=True, MALLOC_TRIM_THRESHOLD_="100000") > pages / 2, "what the user has tuned stays so"
