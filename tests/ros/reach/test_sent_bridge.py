"""A bridge that was sent: it runs from memory where nothing can be written, with its stopper, and leaves nothing."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from ros2_mcp.link.bootstrap import bootstrap
from ros2_mcp_bridge.exit.spawning import STOPPERS
from ros2_mcp_common.start.finding import Search
from support.agent import until
from support.bridge_client import PATIENCE_S, RELIABLE, STRING, Client, cdr_string
from support.far_side import OWN_PYTHON, bare, begun, engine, read_only_machine, sent_bridge
from support.raw_server import children, lives
from support.velocities import TWIST, cdr


def publish(client: Client, topic: str) -> None:
    """A string to a subscriber of the same bridge: ROS works there."""
    client.ok("subscribe", topic=topic, type=STRING, qos=RELIABLE, keep="all", max_samples=10, max_bytes=1000)
    client.ok(
        "publish",
        cdr_string("hi"),
        topic=topic,
        type=STRING,
        qos=RELIABLE,
        epoch=0,
        wait_match_s=PATIENCE_S,
        wait_ack_s=PATIENCE_S,
    )
    until(lambda: client.ok("ping") is not None and bool(client.samples), PATIENCE_S)


def drive(client: Client, topic: str) -> dict[str, object]:
    """One velocity; its stopper has to guard it."""
    client.send("failsafe_publish", topic=topic, type=TWIST, qos=RELIABLE)
    return client.ok("publish", cdr(TWIST, 0.1), topic=topic, type=TWIST, qos=RELIABLE, epoch=0)


def names(bridge: int) -> set[str]:
    """What the process list shows of those that a bridge has started."""
    found: set[str] = set()
    for pid in children(bridge):
        with suppress(FileNotFoundError, ProcessLookupError):  # it has ended meanwhile
            if lives(pid):
                found.add(Path(f"/proc/{pid}/comm").read_text().strip())
    return found


def test_it_runs_where_nothing_can_be_written_and_leaves_nothing(
    domain_id: int, ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """Root is read-only; the home folder and /tmp could be written, and nobody does."""
    home, temporary = tmp_path / "home", tmp_path / "tmp"
    home.mkdir()
    temporary.mkdir()
    way = read_only_machine("--bind", str(temporary), "/var/tmp", home=home)
    start = bootstrap(way, Search(python=OWN_PYTHON, domain_id=domain_id))
    with sent_bridge(start, bare(ros_environment)) as client:
        assert client.hello["domain_id"] == domain_id
        publish(client, "/sent")
        assert drive(client, "/sent_velocity")["unguarded"] == ""
        began = children(client.process.pid)
        assert len(began) >= 2  # the bridge and its stoppers
    until(lambda: not any(map(lives, began)), PATIENCE_S)  # a stopper may outlive its bridge
    assert [*home.rglob("*"), *temporary.rglob("*")] == []
    assert [report.stage for report in start.arrival.reports] == ["reached", "found", "bridge"]


def test_its_stopper_is_started_anew_from_the_same_memory(domain_id: int, ros_environment: dict[str, str]) -> None:
    start = bootstrap(("env",), Search(python=OWN_PYTHON, domain_id=domain_id))
    with sent_bridge(start, bare(ros_environment)) as client:
        assert drive(client, "/guarded")["unguarded"] == ""
        bridge = client.process.pid  # every step of the bootstrap has become the next one
        first = children(bridge)
        assert len(first) == len(STOPPERS)
        for pid in first:
            os.kill(pid, signal.SIGKILL)
        until(lambda: drive(client, "/guarded")["unguarded"] == "" and names(bridge) == {*STOPPERS}, PATIENCE_S)
        second = children(bridge)
        assert not {*first} & {*second}
        os.kill(bridge, signal.SIGKILL)
        until(lambda: not any(map(lives, second)), PATIENCE_S)


def test_a_container_on_the_host_is_entered_and_has_the_bridge(
    domain_id: int, ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """Of Docker there is only the client's name here: a script that knows its words, and enters another machine."""
    path = f"{engine(tmp_path, read_only_machine())}:{os.defpath}"
    start = bootstrap(("env",), Search(python=OWN_PYTHON, domain_id=domain_id), container="ros")
    with sent_bridge(start, bare(ros_environment, PATH=path)) as client:
        assert client.hello["domain_id"] == domain_id
    stages = [report.stage for report in start.arrival.reports]
    assert stages == ["reached", "container", "reached", "found", "bridge"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("idle", "The container idle is not running. Run there:"),
        ("nobody", "The container nobody cannot be entered: there is none of that name; running: ros, other."),
        ("denied", "The container denied cannot be entered: permission denied"),
        ("gone", "container engine is not: Cannot connect to the Docker daemon. Start the engine there"),
    ],
)
def test_a_container_that_cannot_be_entered_says_why(name: str, words: str, tmp_path: Path) -> None:
    tools = engine(tmp_path, ("env",))
    for program in ("python3", "sh", "env"):
        (tools / program).symlink_to(f"/usr/bin/{program}")
    start = bootstrap(("env",), Search(), container=name)
    with begun(start, {"PATH": str(tools)}) as process:
        assert process.stdout
        start.arrival.feed(process.stdout.read())
    assert start.arrival.failure
    assert words in str(start.arrival.failure)
    assert start.arrival.failure.hint


def test_without_a_word_about_ros_the_environment_of_a_running_node_is_taken(
    domain_id: int, ros_environment: dict[str, str]
) -> None:
    """As on a robot whose `.bashrc` sources ROS for terminals alone, and whose nodes a service has started."""
    sourced = f"AMENT_PREFIX_PATH={sys.prefix} ROS_DISTRO=jazzy ROS_DOMAIN_ID={domain_id + 1}"
    node = f"env {sourced} sleep 600 &"  # for who looks for one it is a process that was sourced, and nothing else
    has_begun = "until grep -q AMENT_PREFIX_PATH= /proc/$!/environ; do sleep 0.05; done"
    start = bootstrap((*read_only_machine(), "sh", "-c", f'{node} {has_begun}; exec "$@"', "sh"), Search())
    with sent_bridge(start, bare(ros_environment)) as client:
        assert client.hello["domain_id"] == domain_id + 1
    (found,) = (report.details for report in start.arrival.reports if report.stage == "found")
    assert found["kind"] == "running"
    assert f"ROS_DOMAIN_ID={domain_id + 1}" in found["why"]
