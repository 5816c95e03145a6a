"""What stops a robot that an agent drives through a real client: `ros2_stop` where nobody can be asked, and Ctrl+C."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator

import pytest

from support.clients.client import Client, Workplace, session
from support.clients.opencode import OpenCode
from support.clients.script import Call
from support.observer import Observer, observing

pytestmark = [pytest.mark.full, pytest.mark.timeout(300)]

ENDS_S = 150.0
"""opencode takes 25 s to its first request on a machine with ten times the work that it can do."""
DRIVES_S = 150.0
"""Measured: 6 to 40 s from the client's start to the first command, beside other work."""
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
    """Codex: workspace-write, approvals never. Claude Code: only the stop is allowed. opencode: as it comes."""
    only_stop = ("--allowedTools=mcp__ros2__ros2_stop",) if client.name == "claude-code" else ()
    with session(client, ros_environment, [[Call("ros2_stop")]], options=only_stop) as run:
        run.ends(ENDS_S)
        sent = run.answers("tools/call")
        assert len(sent) == 1 and not sent[0].get("isError"), run.model.results()
        assert sent[0]["content"][0]["text"].splitlines()[0] in run.model.results()[0][0].text


def test_opencode_that_is_to_ask_before_all_tools_but_the_stop_runs_the_stop(
    ros_environment: dict[str, str], robot: subprocess.Popen[str]
) -> None:
    """With the permissions that docs/how-to/client.md has; without anybody who could answer, asking is a refusal."""

    def ask(place: Workplace) -> None:
        file = place.project / "opencode.json"
        permissions = {"ros2_*": "ask", "ros2_ros2_stop": "allow"}
        file.write_text(json.dumps({**json.loads(file.read_text()), "permission": permissions}))

    turns = [[Call("ros2_stop")], [Call("ros2_drive", {"distance_m": 0.05})]]
    with session(OpenCode(), ros_environment, turns, prepare=ask) as run:
        run.ends(ENDS_S)
        assert [call["params"]["name"] for call in run.asked("tools/call")] == ["ros2_stop"]


def test_a_client_that_is_interrupted_leaves_no_motion_behind(
    client: Client, ros_environment: dict[str, str], robot: subprocess.Popen[str], observer: Observer
) -> None:
    before = sum(observer.driven(topic=CMD_VEL).values())
    with session(client, ros_environment, [[LONG_MOTION]], options=client.allow_all) as run:
        _until(lambda: sum(observer.driven(topic=CMD_VEL).values()) > before + 10, DRIVES_S, run.said)
        # opencode does nothing on SIGINT or SIGTERM while a tool runs; in a terminal its server gets SIGINT, too.
        ignores = client.name == "opencode"
        run.interrupt(with_its_server=ignores)
        interrupted = time.monotonic()
        assert observer.comes_to_rest(CMD_VEL, ZERO_S) == []
        print(f"{client.name}: zero within {time.monotonic() - interrupted:.2f} s")
        if not ignores:
            run.process.wait(LEAVES_S)
    assert observer.moving(topic=CMD_VEL) == []


def _until(condition: Callable[[], bool], within_s: float, said: Callable[[], str]) -> None:
    """As `until`, but a failure says what the client has said."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, said()
        time.sleep(0.05)
