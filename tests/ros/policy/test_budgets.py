"""What a policy allows so many times in a minute is so many times, whoever is started again."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.agent import Refusal, until
from support.driver import Driver

POLICY = """
policy: 1
name: bell
allow:
  - {publish: /bell, type: std_msgs/msg/String, per_minute: 2}
  - {publish: /lamp, type: std_msgs/msg/String, rate_hz: 0.01}
"""


@pytest.fixture
def start_server(ros_environment: dict[str, str], tmp_path: Path) -> Iterator[Callable[[], Driver]]:
    tmp_path.chmod(0o700)
    file = tmp_path / "policy.yaml"
    file.write_text(POLICY)
    file.chmod(0o600)
    servers: list[Driver] = []

    def begin() -> Driver:
        environment = {**ros_environment, "XDG_STATE_HOME": str(tmp_path / "state")}
        servers.append(Driver(environment, "--tools", "all", "--policy", str(file)))
        return servers[-1]

    yield begin
    for server in servers:
        server.end()


def publish(server: Driver, topic: str) -> str:
    """What became of it."""
    try:
        message = {"topic_name": topic, "message_type": "std_msgs/msg/String", "data": {"data": "ding"}}
        return server.do("ros2_topic_publish", **message)["status"]
    except Refusal as refusal:
        return str(refusal)


def test_a_budget_does_not_begin_anew_with_another_bridge_or_another_server(
    start_server: Callable[[], Driver],
) -> None:
    server, began_s = start_server(), time.monotonic()
    left = [publish(server, topic) for topic in ("/bell", "/lamp", "/bell")]
    assert not any("policy" in each for each in left), left
    refused = {"/bell": ("may be used 2 times a minute", 60.0), "/lamp": ("more than 0.01 times a second", 100.0)}

    def holds() -> bool:
        """Each is refused, as long as it is: a slow machine takes a minute for two more starts."""
        said = {topic: (publish(server, topic), time.monotonic() - began_s) for topic in refused}
        return all(why in said[topic][0] or said[topic][1] > for_s for topic, (why, for_s) in refused.items())

    assert holds()
    bridge = server.bridge()
    os.kill(bridge, signal.SIGKILL)
    until(lambda: server.bridge() != bridge)
    assert holds()
    server.end()
    server = start_server()
    assert holds()


def test_a_server_that_waited_beside_another_one_has_none_of_the_budget_that_the_other_used(
    start_server: Callable[[], Driver],
) -> None:
    """Its bridge was told what was used before the other server acted."""
    first, second = start_server(), start_server()
    assert second.bridge()
    assert not any("policy" in publish(first, "/bell") for _ in range(2))
    assert "only one server may act" in publish(second, "/bell")
    first.end()
    assert "may be used 2 times a minute" in publish(second, "/bell")
