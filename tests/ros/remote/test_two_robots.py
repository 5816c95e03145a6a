"""Two robots of one server, each behind ssh and a network of its own; one of them falls silent."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from support.agent import FULL, Refusal, until
from support.driver import COMES_UP_S, Driver
from support.network_link import NetworkLink, network_link
from support.observer import Observer, observing
from support.sshd import Sshd
from support.velocities import TWIST, speed

pytestmark = pytest.mark.timeout(300)

REST_S = 5.0 if FULL else 30.0
"""The lease has lapsed after 2 s; test_outage measures it, here it matters which robot stands."""


@pytest.fixture
def links(far: Sshd) -> Iterator[dict[str, NetworkLink]]:
    with ExitStack() as between:
        links = {name: between.enter_context(network_link(far.port)) for name in ("lab", "yard")}
        for link in links.values():
            far.knows(link.port)
        yield links


@pytest.fixture
def observers(ros_environment: dict[str, str], domain_id: int) -> Iterator[dict[str, Observer]]:
    """One on each robot."""
    with ExitStack() as running:
        yield {
            name: running.enter_context(observing({**ros_environment, "ROS_DOMAIN_ID": str(domain)}))
            for name, domain in (("lab", domain_id), ("yard", domain_id + 1))
        }


@pytest.fixture
def server(
    far: Sshd, links: dict[str, NetworkLink], ros_environment: dict[str, str], domain_id: int, tmp_path: Path
) -> Iterator[Driver]:
    named = {
        name: far.address(link.port, f"?domain_id={domain_id + n}") for n, (name, link) in enumerate(links.items())
    }
    ssh = [f"--ssh-option={word}" for word in far.options()]
    robots = [word for name, address in named.items() for word in ("--robot", f"{name}={address}")]
    server = Driver(ros_environment, *robots, *ssh, "--record-dir", str(tmp_path), "--tools", "all")
    yield server
    for link in links.values():
        link.mend()
    server.end()


def is_known(server: Driver, robot: str) -> bool:
    """Whether the server reaches a robot, and knows the subscriber of its base."""
    try:
        return bool(server.do("ros2_topic_info", topic_name="/cmd_vel", robot=robot)["subscribers"])
    except Refusal:
        return False


def test_a_stop_of_all_is_answered_for_those_that_are_reached(
    server: Driver, links: dict[str, NetworkLink], observers: dict[str, Observer]
) -> None:
    for name, observer in observers.items():
        observer.join(by="base", topic="/cmd_vel", kind=TWIST)
        until(lambda name=name: is_known(server, name), COMES_UP_S)
        asked = {"topic_name": "/cmd_vel", "message_type": TWIST, "data": speed(TWIST, 0.5), "robot": name}
        server.tool("ros2_topic_publish", frequency=20, duration=60, **asked)
    for observer in observers.values():
        observer.until_driven("/cmd_vel")
    links["lab"].cut()
    stopped, _ = server.stop()
    told = {one["robot"]: one["stopped"] for one in stopped["robots"]}
    assert "The robot is out of reach" in told["lab"]["note"] and not told["lab"]["confirmed"]
    assert [topic["topic_name"] for topic in told["yard"]["topics"]] == ["/cmd_vel"]
    assert not stopped["confirmed"]
    for observer in observers.values():
        assert observer.comes_to_rest("/cmd_vel", REST_S) == []
    links["lab"].mend()
    until(lambda: is_known(server, "lab"), COMES_UP_S)
    again, _ = server.stop()
    assert not [one for one in again["robots"] if "not reached" in one["stopped"]["note"]]
