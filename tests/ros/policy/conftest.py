"""A real server under a policy over real stdio, and the independent observer, which alone judges what arrived."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp.guard.state import StateFolder
from support.agent import until
from support.driver import MOVING, Driver, write_bag
from support.observer import Observer
from support.velocities import TWIST, cdr

POLICY = """
policy: 1
name: hall
allow:
  - {publish: "/**/cmd_vel", type: geometry_msgs/msg/Twist, rate_hz: 100, for_s: 60}
  - {relay: "/**/cmd_vel", types: [geometry_msgs/msg/Twist, geometry_msgs/msg/Vector3], from: "/**"}
  - {play: "/**/cmd_vel", type: geometry_msgs/msg/Twist, force: true}
limits:
  base:
    types: [geometry_msgs/msg/Twist]
    norm: {linear: 0.4, angular: 0.8}
    zero: [linear.y, linear.z, angular.x, angular.y]
    ramp: {linear: {up: 0.5, down: 2.0}, angular: {up: 1.5, down: 1.5}}
    hold_s: 0.5
"""
BAG_MESSAGES = 100


@pytest.fixture(scope="module")
def policy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy of these tests, whose folder nobody else can write to."""
    folder = tmp_path_factory.mktemp("policy")
    folder.chmod(0o700)
    file = folder / "policy.yaml"
    file.write_text(POLICY, encoding="utf-8")
    file.chmod(0o600)
    return file


class Limited(Driver):
    """A server under that policy, whose latch an operator can reset after a stop."""

    def __init__(self, environment: dict[str, str], *options: str) -> None:
        super().__init__(environment, *options)
        self._latch = StateFolder.of(domain_id=int(environment["ROS_DOMAIN_ID"]), env=environment).latch()

    def reset(self) -> None:
        self._latch.reset(by="operator", seen=self._latch.look().count)
        until(lambda: not self.do("ros2_status")["latched"])


@pytest.fixture(scope="module")
def start_server(
    ros_environment: dict[str, str], policy_file: Path, tmp_path_factory: pytest.TempPathFactory, observer: Observer
) -> Iterator[Callable[[], Limited]]:
    """Starts servers under that policy, with state of their own and a bag that drives at 0.5 m/s for two seconds."""
    drivers: list[Limited] = []

    def begin() -> Limited:
        folder = tmp_path_factory.mktemp("server")
        write_bag(folder / "bags", [cdr(TWIST, MOVING)] * BAG_MESSAGES)
        environment = {**ros_environment, "XDG_STATE_HOME": str(folder / "state")}
        options = ("--tools", "all", "--policy", str(policy_file), "--record-dir", str(folder / "bags"))
        drivers.append(Limited(environment, *options))
        return drivers[-1]

    yield begin
    for driver in drivers:
        driver.end()


@pytest.fixture(scope="module")
def server(start_server: Callable[[], Limited]) -> Limited:
    """One that the tests of a file share."""
    return start_server()
