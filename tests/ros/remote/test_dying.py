"""Every way in which what drives a robot elsewhere may die: it stands within the link lease, each time of many."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from support.agent import FULL, until
from support.driver import Driver, fresh, repeat
from support.far_side import OWN_PYTHON, SurvivingEngine
from support.network_link import NetworkLink
from support.observer import Observer
from support.sshd import ssh_of, sshd
from support.standstill import undisturbed
from support.velocities import TWIST

LEASE_S = 2.0
LIMIT_S = LEASE_S + 0.3
ROUNDS = 20

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(
        not FULL, reason="set ROS2_MCP_FULL=1: 20 rounds of each way; test_outage has some of them once"
    ),
    pytest.mark.timeout(1800),
]


def kill_ssh(server: Driver) -> None:
    os.kill(ssh_of(server.process.pid), signal.SIGKILL)


def kill_server(server: Driver) -> None:
    server.process.kill()


def sleep(server: Driver) -> None:
    """What a laptop does whose lid is closed: nothing runs any more, and nobody is told."""
    for pid in (ssh_of(server.process.pid), server.process.pid):
        os.kill(pid, signal.SIGSTOP)


def wake(server: Driver) -> None:
    for pid in (server.process.pid, ssh_of(server.process.pid)):
        os.kill(pid, signal.SIGCONT)


def stands_after_s(server: Driver, observer: Observer, dies: Callable[[Driver], None]) -> float:
    """From a death to the last command that moves the robot, in s."""
    topic = fresh("dying")
    observer.join(by=topic, topic=topic, kind=TWIST)
    try:
        server.knows(topic, 1)
        repeat(server, observer, topic)
        observer.until_driven(topic, number=10)
        died_ns = time.monotonic_ns()
        dies(server)
        assert observer.comes_to_rest(topic, 4 * LEASE_S) == []
        return (max(one["sent"] for one in observer.messages(topic=topic) if any(one["values"])) - died_ns) / 1e9
    finally:
        observer.leave(by=topic)
        observer.forget()


@pytest.mark.parametrize("dies", [kill_ssh, kill_server, sleep])
def test_the_robot_stands_within_the_lease(
    laptop: Callable[..., Driver], link: NetworkLink, observer: Observer, dies: Callable[[Driver], None]
) -> None:
    servers: list[Driver] = []

    def dying() -> float:
        if not servers or dies is kill_server:
            servers.append(laptop())
        server = servers[-1]
        server.bridge()
        took_s = stands_after_s(server, observer, dies)
        if dies is sleep:
            wake(server)
            until(lambda: not server.answer(server.tool("ros2_topic_list"))["result"].get("isError"))
            server.stop()
        elif dies is kill_ssh:
            until(lambda: not server.answer(server.tool("ros2_topic_list"))["result"].get("isError"))
        return took_s

    took_s = [undisturbed(dying) for _ in range(ROUNDS)]
    print(f"{dies.__name__}: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= LIMIT_S


def container(folder: Path, ros_environment: dict[str, str], ends: ExitStack, domain_id: int) -> Driver:
    """A server whose robot is a container behind ssh: its engine's client may die, and what it began does not."""
    folder.mkdir()
    names = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    env = {name: ros_environment[name] for name in names if name in ros_environment}
    engine = SurvivingEngine(folder / "engine", ("env",))
    ends.callback(engine.end)
    client, program = folder / "client", folder / "docker"
    program.write_text(
        "\n".join(
            [
                "#!/bin/sh",
                '[ "$1" = inspect ] && { echo true; exit; }',
                f"[ -e {client} ] && exit 1",  # one bridge: its stream is one file
                f"echo $$ >{client}",
                f'exec {engine.program} "$@"',
                "",
            ]
        )
    )
    program.chmod(0o755)
    far = ends.enter_context(sshd(folder / "sshd", {**env, "PATH": f"{folder}:/usr/bin:/bin"}))
    ssh = [f"--ssh-option={word}" for word in far.options()]
    robot = ("--robot", far.address(None, f"?container=ros&domain_id={domain_id}"), "--bridge-python", OWN_PYTHON)
    server = Driver(ros_environment, *robot, *ssh, "--record-dir", str(folder))
    ends.callback(server.end)
    return server


def test_the_robot_in_a_container_there_stands_when_the_engines_client_dies(
    ros_environment: dict[str, str], domain_id: int, observer: Observer, tmp_path: Path
) -> None:
    took_s: list[float] = []
    for number in range(ROUNDS):
        with ExitStack() as ends:
            folder = tmp_path / str(number)
            server = container(folder, ros_environment, ends, domain_id)
            client = folder / "client"
            took_s.append(
                stands_after_s(server, observer, lambda _, at=client: os.kill(int(at.read_text()), signal.SIGKILL))
            )
    print(f"client of an engine: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= LIMIT_S
