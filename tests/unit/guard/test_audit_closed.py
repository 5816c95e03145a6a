"""An audit that is closed while lines come from several threads: each is written or was refused, and none waits."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from ros2_mcp.guard.audit import Audit, Line
from ros2_mcp.guard.chain import verify
from support.agent import until
from support.rounds import FULL

ROUNDS = 300 if FULL else 5
THREADS = 4
FIRST, MORE = 20, 200
"""Lines before it is closed, and of each thread after that."""


@pytest.fixture(autouse=True)
def threads_alternate() -> Iterator[None]:
    """A thousand times as often as usual, so that they meet where they seldom do."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(before / 1000)
    yield
    sys.setswitchinterval(before)


def descriptors() -> int:
    return len([*Path("/proc/self/fd").iterdir()])


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux lists the descriptors of a process")
@pytest.mark.parametrize("policy", ["", "lab"])
def test_no_line_waits_for_an_audit_that_is_closed_and_no_descriptor_is_left(tmp_path: Path, policy: str) -> None:
    before = descriptors()
    for number in range(ROUNDS):
        folder = tmp_path / str(number)
        folder.mkdir()
        audit = Audit(lambda folder=folder: folder, path=folder, policy=policy)
        lines = [list[Line | None]() for _ in range(THREADS)]
        is_closed = threading.Event()

        def note(own: list[Line | None], audit: Audit = audit, is_closed: threading.Event = is_closed) -> None:
            left = MORE
            while left:
                own.append(audit._queue("note", {"value": len(own)}))  # pyright: ignore[reportPrivateUsage]
                left -= is_closed.is_set()

        threads = [threading.Thread(target=note, args=(own,)) for own in lines]
        for thread in threads:
            thread.start()
        until(lambda lines=lines: sum(map(len, lines)) >= FIRST)
        audit.close()
        is_closed.set()
        for thread in threads:
            thread.join()
        taken = [line for own in lines for line in own if line]
        assert all(line.done() for line in taken)
        assert {type(line.exception()) for line in taken} <= {type(None)}
        verdict = verify(folder)
        assert (verdict.faults, verdict.head.seq) == ([], len(taken))
        assert [own[-1] for own in lines] == [None] * THREADS
    assert descriptors() == before
