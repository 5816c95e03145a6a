"""ROS domains for tests: no two blocks that run at the same time on this machine share one, in whatever process."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ros2_mcp_bridge.exit.spawning import STOPPERS
from support import leaves_nothing, own_processes, shared_memory
from support.own_processes import Process
from support.processes import SHARED
from support.shared_memory import Segment

DOMAINS_OF_A_BLOCK = 3
LAST_DOMAIN = 101
"""Linux gives the ports that DDS would use in higher domains to anybody's sockets."""


@contextmanager
def reserved_domains() -> Iterator[int]:
    """The first of three neighbouring domain ids that are the block's alone, and in which nobody has left anything.

    They are those that have been free for longest. At the block's end all of our processes in these domains have to
    end within 10 s; then what the killed ones have left there in shared memory is removed.
    """
    firsts = range(1, LAST_DOMAIN - DOMAINS_OF_A_BLOCK + 2, DOMAINS_OF_A_BLOCK)
    locks = {SHARED / f"ros2-mcp-test-domain-{first}.lock": first for first in firsts}
    for path in sorted(locks, key=_last_used):
        with path.open("a") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            domains = range(locks[path], locks[path] + DOMAINS_OF_A_BLOCK)
            if shared_memory.holders(domains):  # of somebody who knows nothing of these locks
                continue
            shared_memory.remove_ports(domains)
            began = time.time()
            try:
                yield domains[0]
            finally:
                _leave(domains, began)
                os.utime(path)
            return
    raise RuntimeError(f"All {len(locks)} domains for tests are taken: see the locks in {SHARED}.")


def _last_used(path: Path) -> float:
    return path.stat().st_mtime if path.exists() else 0.0


def _leave(domains: range, since: float) -> None:
    """Nobody of ours is in the domains any more, and nothing of those who were: else it is told, ended and removed.

    What a test has killed leaves its segment, and so does a bridge or stopper that its own alarm ends, 1 s after it was
    told to end: on a busy machine that is nobody's fault (`test_bridge_leaves.py` holds that a bridge with an exit
    status of 0 leaves nothing). Nor is it where Fast DDS keeps a peer or the simulated robot from leaving now and then
    (docs/known-races.md). Whose a segment is, is not known if that process never said anything, or was not there when a
    test began or ended.
    """
    left = own_processes.wait_for_end(lambda: _in(domains))
    wrong = [f"{one.pid} ({one.command}) is left" for one in left]
    own_processes.kill(left)
    held = _holders_that_stay(domains)
    for pid, ports in held.items():
        holder = own_processes.process(pid)
        wrong.append(f"{pid} ({holder.command if holder else 'has ended'}) still has open {', '.join(ports)}")
    for segment in shared_memory.dead_segments():
        if segment.at >= since and (command := own_processes.seen(segment.process)):
            shared_memory.remove_segment(segment)
            if segment.process not in own_processes.killed_ids() and not _has_an_alarm(command):
                wrong.append(_told(segment, command))
    if not held:
        shared_memory.remove_ports(domains)
    assert not wrong, "\n".join([f"in the domains {[*domains]}:", *wrong])


def _has_an_alarm(command: str) -> bool:
    """Whether it is a bridge or a stopper, started as a module or by the program that is sent to a robot; or a peer of
    the tests, or the simulated robot.
    """
    parts = ("ros2_mcp_bridge", "-c import sys sys.path[:] = ", "/support/peers/", "ros2_mcp_demo")
    return any(part in command for part in parts) or command.strip() in STOPPERS


def _holders_that_stay(domains: range) -> dict[int, list[str]]:
    """Who still has ports of these domains open after END_S: one that is just ending closes them at its very end.

    Its environment may be gone before that, by which it is known as ours.
    """
    deadline = time.monotonic() + own_processes.END_S
    while (held := shared_memory.holders(domains)) and time.monotonic() < deadline:
        time.sleep(own_processes.POLL_S)
    return held


def _told(segment: Segment, command: str) -> str:
    when = leaves_nothing.test_at(segment.at - time.time() + own_processes.boot_s())
    return (
        f"{segment.process} ({command}) did not leave ROS at its end, though no test killed it: it began in the time of"
        f" {when}, and has left {shared_memory.FOLDER / segment.name}"
    )


def _in(domains: range) -> list[Process]:
    names = {str(domain) for domain in domains}
    return [one for one in own_processes.own() if own_processes.environment(one.pid).get("ROS_DOMAIN_ID") in names]
