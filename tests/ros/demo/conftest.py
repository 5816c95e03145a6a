"""The simulated robot in its own process, and a ROS 2 node of the tests' own that looks at it."""

import os

import pytest

from support.demo_robot import Goals, Peer, build_interfaces, running_robot
from support.domains import reserved_domains


@pytest.fixture(scope="session")
def prefixes():
    """tf2_msgs and ros2_mcp_demo_interfaces, built, and importable here."""
    pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
    built = build_interfaces()
    with pytest.MonkeyPatch.context() as patched:
        for prefix in built:
            patched.syspath_prepend(prefix / "site-packages")
        yield built


@pytest.fixture
def domain_id():
    """A domain of each test's own: the robot of the test before has just left its."""
    with reserved_domains() as first:
        yield first


@pytest.fixture
def start_robot():
    """Start a robot: `with start_robot(prefixes, domain_id, *options) as process`."""
    return running_robot


@pytest.fixture(scope="module")
def robot_domain(prefixes):
    """The domain of a robot that the tests of a file share."""
    with reserved_domains() as first, running_robot(prefixes, first):
        yield first


@pytest.fixture
def peer(robot_domain, monkeypatch):
    """A peer in the domain of the robot."""
    monkeypatch.setitem(os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    peer = Peer(robot_domain)
    yield peer
    peer.close()


@pytest.fixture
def goals(peer):
    """A client of the robot's navigation."""
    goals = Goals(peer)
    yield goals
    goals.close()
