"""A child process whose pipes threads wait for, as on Windows, is the same to the link as any other."""

from __future__ import annotations

import asyncio
import os
import sys

import pytest

from ros2_mcp.link.child import Child
from ros2_mcp.link.installation import Command
from support.tasks import soon

ECHO = """
import os
os.write(2, b"hello")
while data := os.read(0, 65536):
    os.write(1, data)
"""


class Far:
    """A child, and what has come of it."""

    def __init__(self, code: str) -> None:
        self.child = Child(Command([sys.executable, "-c", code], os.environ), threaded=True)
        self.came = bytearray()
        self.ended = 0

    async def open(self) -> None:
        await self.child.open(self.came.extend, self._end)

    def _end(self) -> None:
        self.ended += 1


async def test_what_is_written_comes_back_whole_and_in_order_and_the_end_is_told_once() -> None:
    far = Far(ECHO)
    await far.open()
    sent = b"".join(number.to_bytes(4, "big") * 5_000 for number in range(300))  # 6 MB, more than any pipe holds
    for start in range(0, len(sent), 100_000):
        await far.child.writable()
        far.child.write(sent[start : start + 100_000])
    await soon(lambda: len(far.came) == len(sent))
    assert bytes(far.came) == sent
    assert far.child.log_tail() == ["hello"]
    await far.child.close(20.0)
    await soon(lambda: far.ended > 0)
    assert await far.child.ending() == "exited with code 0"
    assert far.ended == 1


async def test_writing_waits_while_the_child_does_not_read_and_goes_on_when_it_is_dead() -> None:
    far = Far("import time; time.sleep(1000)")
    await far.open()
    far.child.write(bytes(2_000_000))
    with pytest.raises(asyncio.TimeoutError):
        await asyncio.wait_for(far.child.writable(), 0.2)
    far.child.kill()
    await asyncio.wait_for(far.child.writable(), 20.0)  # only a machine that stands still needs so long
    far.child.write(b"to nobody")
    await soon(lambda: far.ended > 0)
    await far.child.close(0.0)
    assert await far.child.ending() == "died with signal SIGKILL"
