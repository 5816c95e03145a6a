"""What systemd does with all processes of the unit at once, as KillMode=control-group has it: the robot stands."""

from __future__ import annotations

import os
import signal
from contextlib import suppress

import pytest

from support.agent import FULL
from support.containers import children
from support.driver import Driver, fresh, repeat

REST_S = 5.0 if FULL else 30.0
"""How long a zero may take to come at all; how soon is measured elsewhere (`tests/ros/commands/test_stop.py`)."""
END_S = 40.0
"""On a machine that is busy with other tests."""


def family(pid: int) -> list[int]:
    """A process and all that it has started, itself first."""
    return [pid, *(one for child in children(pid) for one in family(child))]


@pytest.mark.parametrize("how", ["systemctl stop", "the server dies"])
def test_a_service_that_ends_leaves_a_robot_that_stands(ros_environment, observer, how: str) -> None:
    server, topic = Driver(ros_environment), fresh("service")
    observer.watch(topic)
    server.knows(topic, 4)
    repeat(server, observer, topic)
    observer.until_driven(topic, 1, of=4)
    all_of_it = family(server.process.pid)
    assert len(all_of_it) >= 3, "server, bridge and stopper"
    if how == "the server dies":
        server.process.kill()
        server.process.wait()
    for pid in all_of_it:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
    assert observer.comes_to_rest(topic, REST_S) == []
    assert server.process.wait(END_S) == (0 if how == "systemctl stop" else -signal.SIGKILL)
    server.end()
