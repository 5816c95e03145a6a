"""The entry point of the image as the first process of a namespace, with which the kernel ends all others."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from support.agent import FULL, until
from support.containers import CONTAINER, ENTRYPOINT, WHERE_NONE, children, there_are_containers
from support.driver import Driver, fresh, repeat
from support.raw_server import MODERN, RawServer

PATIENCE_S = 7.0
"""Of the script, with its processes."""
REST_S = 5.0 if FULL else 30.0
"""How long a zero may take to come at all; how soon is measured elsewhere (`tests/ros/commands/test_stop.py`)."""
END_S = PATIENCE_S + 33.0
"""On a machine that is busy with other tests."""

pytestmark = pytest.mark.skipif(not there_are_containers(), reason=WHERE_NONE)


class Container(Driver):
    """A server in a namespace of processes, with the script as its first one."""

    def __init__(self, environment: dict[str, str]) -> None:
        path = f"{Path(sys.executable).parent}:{environment['PATH']}"
        self.answers: dict[int | None, dict[str, Any]] = {}
        command = [*CONTAINER, ENTRYPOINT]
        RawServer.__init__(self, {**environment, "PATH": path}, "--tools", "all", command=command)
        self.begin(MODERN)

    def first(self) -> int:
        """The first process of the namespace, by the number that it has outside."""
        return children(self.process.pid)[0]

    def server(self) -> int:
        """The server, which is the first child of the first process."""
        return children(self.first())[0]


@pytest.fixture
def container(ros_environment: dict[str, str]) -> Iterator[Container]:
    running = Container(ros_environment)
    yield running
    running.end()


def test_a_server_that_is_killed_in_a_container_leaves_a_robot_that_stands(container, observer) -> None:
    topic = fresh("contained")
    observer.watch(topic)
    container.knows(topic, 4)
    repeat(container, observer, topic)
    observer.until_driven(topic, 1, of=4)
    os.kill(container.server(), signal.SIGKILL)
    assert observer.comes_to_rest(topic, REST_S) == []
    assert container.process.wait(END_S) == 128 + signal.SIGKILL


@pytest.mark.parametrize("how", ["the client closes stdin", "docker stop"])
def test_a_container_ends_with_its_client_and_by_a_signal(container, observer, how: str) -> None:
    topic = fresh("ended")
    observer.watch(topic)
    container.knows(topic, 4)
    repeat(container, observer, topic)
    observer.until_driven(topic, 1, of=4)
    ends: dict[str, Callable[[], None]] = {
        "the client closes stdin": container.process.stdin.close,
        "docker stop": partial(os.kill, container.first(), signal.SIGTERM),
    }
    ends[how]()
    until(lambda: container.process.poll() is not None, END_S)
    assert container.process.returncode == 0
    assert observer.comes_to_rest(topic, REST_S) == []
