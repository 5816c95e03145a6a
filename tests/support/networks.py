"""A network of two, one end of which is in a namespace of its own: it can be taken away without anybody being told."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass


class NotPermitted(Exception):
    """This machine or user may not make networks."""


@dataclass(frozen=True)
class Network:
    """`host` is the address of this side; programs on the other side are started by `beside`."""

    host: str
    namespace: str

    @property
    def beside(self) -> list[str]:
        """What stands before a command so that it runs on the other side."""
        return ["ip", "netns", "exec", self.namespace]

    def set_link(self, state: str) -> None:
        """`down`: every packet is lost from now on, and nobody is told; `up` again."""
        _ip("-n", self.namespace, "link", "set", "far", state)


@contextmanager
def network() -> Iterator[Network]:
    """A network for the time of a block; raises `NotPermitted` where it cannot be."""
    number, namespace, near = os.getpid() % 250 + 1, f"ros2-mcp-{os.getpid()}", f"near{os.getpid()}"
    ours, theirs = f"10.213.{number}.1", f"10.213.{number}.2"
    steps = [
        ("netns", "add", namespace),
        ("link", "add", near, "type", "veth", "peer", "name", "far", "netns", namespace),
        ("addr", "add", f"{ours}/30", "dev", near),
        ("link", "set", near, "up"),
        ("-n", namespace, "addr", "add", f"{theirs}/30", "dev", "far"),
        ("-n", namespace, "link", "set", "far", "up"),
    ]
    try:
        try:
            for step in steps:
                _ip(*step)
        except (OSError, subprocess.CalledProcessError) as error:
            raise NotPermitted(getattr(error, "stderr", "") or str(error)) from error
        yield Network(ours, namespace)
    finally:
        with suppress(OSError, subprocess.CalledProcessError):
            _ip("netns", "del", namespace)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True, timeout=20)
