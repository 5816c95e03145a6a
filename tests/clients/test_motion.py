"""What stops a robot that an agent drives through a real client: `ros2_stop` where nobody can be asked, and Ctrl+C."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator

import pytest

from support.clients.client import Client, session
from support.clients.script import Call
from support.observer import Observer, observing

ENDS_S = 60.0
DRIVES_S = 60.0
"""Measured: 6 to 20 s from the client's start to the first command, beside other work."""
ZERO_S = 2.0
"""From Ctrl+C to the zero; measured: 0.03 to 0.1 s, beside other work too."""
LEAVES_S = 15.0
CMD_VEL = "/cmd_vel"
LONG_MOTION = Call(
    "ros2_topic_publish", {"topic_name": CMD_VEL, "data": {"angular": {"z": 0.3}}, "frequency": 10, "duration": 120}
)


@pytest.fixture(scope="module")
def observer(ros_environment: dict[str, str]) -> Iterator[Observer]:
    with observing(ros_environment) as process:
        process.watch(CMD_VEL)
        yield process


def test_the_stop_runs_in_the_sandbox_that_a_client_has_by_itself(
    client: Client, ros_environment: dict[str, str], robot: subprocess.Popen[str]
) -> None:
    """Codex: workspace-write, approvals never. Claude Code is told of nothing that it may call, but of the stop."""
    only_stop = ("--allowedTools=mcp__ros2__ros2_stop",) if client.name == "claude-code" else ()
    with session(client, ros_environment, [[Call("ros2_stop")]], options=only_stop) as run:
        run.ends(ENDS_S)
        sent = run.answers("tools/call")
        assert len(sent) == 1 and not sent[0].get("isError"), run.model.results()
        assert sent[0]["content"][0]["text"].splitlines()[0] in run.model.results()[0][0].text


def test_a_client_that_is_interrupted_leaves_no_motion_behind(
    client: Client, ros_environment: dict[str, str], robot: subprocess.Popen[str], observer: Observer
) -> None:
    before = sum(observer.driven(topic=CMD_VEL).values())
    with session(client, ros_environment, [[LONG_MOTION]], options=client.allow_all) as run:
        _until(lambda: sum(observer.driven(topic=CMD_VEL).values()) > before + 10, DRIVES_S, run.said)
        run.interrupt()
        assert observer.comes_to_rest(CMD_VEL, ZERO_S) == []
        run.process.wait(LEAVES_S)
    assert observer.moving(topic=CMD_VEL) == []


def _until(condition, within_s, said):
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, said()
        time.sleep(0.05)
