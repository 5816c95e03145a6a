"""The latch is a file on this machine, and holds for a robot elsewhere, whose bridge does not see it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.address import parse_address
from support.agent import Refusal, until
from support.driver import Driver, fresh, repeat
from support.network_link import NetworkLink
from support.observer import Observer
from support.sshd import Sshd
from support.velocities import TWIST, TWIST_STAMPED

pytestmark = pytest.mark.timeout(300)
SLOW = {"linear": {"x": 0.1}}
SEEN_S = 2.0
"""A ping tells it, four times a second, and the bridge looks ten times a second."""
REST_S = 30.0
"""Only ends a hang: what drives would go on for a minute."""
WITHIN = pytest.mark.parametrize("within_s", [REST_S, pytest.param(SEEN_S, marks=pytest.mark.full)])

WATCHED = """\
policy: 1
allow: [{publish: "/**", type: geometry_msgs/msg/Twist, rate_hz: 100, for_s: 60}]
feedback: {topic: @ODOMETRY@, type: geometry_msgs/msg/TwistStamped, path: twist, max_age_s: 3.0}
"""


@WITHIN
def test_the_watchdog_there_sets_it_here(
    laptop: Callable[..., Driver],
    link: NetworkLink,
    far: Sshd,
    observer: Observer,
    ros_environment: dict[str, str],
    tmp_path: Path,
    within_s: float,
) -> None:
    """The robot tells nothing of its speed any more: the bridge stops it, and only this machine has a file."""
    topic, odometry = fresh("watched_there"), fresh("odom")
    policy = tmp_path / "watched.yaml"
    policy.write_text(WATCHED.replace("@ODOMETRY@", odometry))
    policy.chmod(0o600)
    server = laptop("--policy", str(policy))
    latch = StateFolder.of(elsewhere=parse_address(far.address(link.port)).identity, env=ros_environment).latch()
    observer.talk(topic=odometry, kind=TWIST_STAMPED, hz=50.0, value=0.3)
    observer.join(by=topic, topic=topic, kind=TWIST)
    server.knows(topic, 1)

    def is_told() -> bool:
        try:
            return bool(server.do("ros2_topic_echo_wait", topic_name=odometry))
        except Refusal:  # it is not discovered yet
            return False

    until(is_told, 60.0)
    driving = repeat(server, observer, topic)
    observer.until_driven(topic, number=20)
    observer.hush(topic=odometry)
    state = until(lambda: latch.look().is_set and latch.look())
    assert state.by == "watchdog" and "nothing" in state.reason
    assert observer.comes_to_rest(topic, within_s) == []
    assert "watchdog" in server.outcome(driving)
    with pytest.raises(Refusal, match="the latch of this robot is set"):
        server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=SLOW)
    latch.reset(by="operator", seen=latch.look().count)


@WITHIN
def test_who_sets_it_here_ends_what_moves_there_until_it_is_reset(
    laptop: Callable[..., Driver],
    link: NetworkLink,
    far: Sshd,
    observer: Observer,
    ros_environment: dict[str, str],
    within_s: float,
) -> None:
    server, topic = laptop(), fresh("latched_there")
    elsewhere = parse_address(far.address(link.port)).identity
    latch = StateFolder.of(elsewhere=elsewhere, env=ros_environment).latch()
    observer.join(by=topic, topic=topic, kind=TWIST)
    server.knows(topic, 1)
    driving = repeat(server, observer, topic)
    observer.until_driven(topic)
    latch.path.parent.mkdir(parents=True, exist_ok=True)  # type: ignore[union-attr]
    latch.set(by="another server", reason="a person pressed stop")
    assert observer.comes_to_rest(topic, within_s) == []
    assert "latch" in server.outcome(driving)
    with pytest.raises(Refusal, match="the latch of this robot is set"):
        server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=SLOW)
    latch.reset(by="operator", seen=latch.look().count)

    def drives() -> bool:
        try:
            server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=SLOW)
        except Refusal:
            return False
        return True

    until(drives)
    server.stop()
