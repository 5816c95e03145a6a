"""Two network namespaces with a narrow link between them: the kernel's own queues, TCP over it, and a real sshd."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

_BURST = "2kb"
"""A little more than one segment: what passes at once after a pause."""
_QUEUE = "400ms"
"""What waits longer than that is dropped, as in a modem with a short queue."""
_NETWORK = "10.231.64"
_PROGRAMS = ("ip", "tc", "nsenter")


@dataclass(frozen=True, kw_only=True)
class NarrowNetwork:
    """Programs begun with `robot` or `laptop` before them are on one side of the link; the robot is `address`."""

    kbit: int
    robot: tuple[str, ...]
    laptop: tuple[str, ...]
    address: str = f"{_NETWORK}.1"
    _ends: tuple[tuple[tuple[str, ...], str], ...] = field(repr=False)

    def narrow(self) -> None:
        """As much per second as it is for, both ways; also after `cut`."""
        for before, device in self._ends:
            bucket = ("tbf", "rate", f"{self.kbit}kbit", "burst", _BURST, "latency", _QUEUE)
            _run(*before, "tc", "qdisc", "replace", "dev", device, "root", *bucket)

    def cut(self) -> int:
        """Nothing passes any more, and nobody is told; returns since when (CLOCK_MONOTONIC, ns)."""
        for before, device in self._ends:
            _run(*before, "tc", "qdisc", "replace", "dev", device, "root", "blackhole")
        return time.monotonic_ns()

    def carried_bytes(self) -> tuple[int, int]:
        """What the robot's side has received and sent by now, with all headers."""
        before, device = self._ends[0]
        lines = _run(*before, "cat", "/proc/net/dev").splitlines()
        counts = next(line for line in lines if line.strip().startswith(f"{device}:")).partition(":")[2].split()
        return int(counts[0]), int(counts[8])


@contextmanager
def narrow_network(kbit: int) -> Generator[NarrowNetwork, None, None]:
    """Such a network for the time of a block. Skips the test where this user may not make one."""
    if os.geteuid() or not all(map(shutil.which, _PROGRAMS)):
        pytest.skip(f"needs root, and {', '.join(_PROGRAMS)} (apt-get install iproute2 util-linux)")
    mark = f"rm{os.getpid() % 100_000}"
    names, devices = (f"{mark}-robot", f"{mark}-laptop"), (f"{mark}r", f"{mark}l")
    made: list[str] = []
    try:
        for name in names:
            try:
                _run("ip", "netns", "add", name)
            except subprocess.CalledProcessError as error:
                pytest.skip(f"needs the right to make network namespaces: {error.stderr}")
            made.append(name)
        pair = [word for name, device in zip(names, devices, strict=True) for word in ("name", device, "netns", name)]
        _run("ip", "link", "add", *pair[:4], "type", "veth", "peer", *pair[4:])
        ends: list[tuple[tuple[str, ...], str]] = []
        for number, (name, device) in enumerate(zip(names, devices, strict=True), 1):
            before = ("nsenter", f"--net={Path('/run/netns') / name}")
            _run(*before, "ip", "address", "add", f"{_NETWORK}.{number}/30", "dev", device)
            for each in ("lo", device):
                _run(*before, "ip", "link", "set", each, "up")
            ends.append((before, device))
        network = NarrowNetwork(kbit=kbit, robot=ends[0][0], laptop=ends[1][0], _ends=tuple(ends))
        network.narrow()
        yield network
    finally:
        for name in made:
            _run("ip", "netns", "delete", name)  # the devices go with them


def _run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout
