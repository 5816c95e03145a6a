"""What the latch ends says who has set it, and why: whoever drove, and how."""

from __future__ import annotations

from typing import Any

import pytest

from ros2_mcp.guard.state import StateFolder
from support.agent import until
from support.driver import WAYS, Driver, calm, fresh, going_on, until_driven
from support.observer import Observer


@pytest.mark.parametrize("way", ["repeat", "relay", "feed", "playback", "drive"])
def test_what_it_ends_says_who_has_set_it_and_why(
    server: Driver, observer: Observer, ros_environment: dict[str, str], way: str
) -> None:
    topic = fresh("ended")
    observer.watch(topic)
    server.knows(topic, 4)
    latch = StateFolder.of(domain_id=int(ros_environment["ROS_DOMAIN_ID"]), env=ros_environment).latch()
    moving = WAYS[way](server, observer, topic)
    begun = {} if way in ("repeat", "drive") else server.result(moving)
    try:
        moving = until_driven(server, observer, way, topic, moving)
    except AssertionError as error:  # what the server knows of it is the way to the cause
        raise AssertionError(f"{begun}: {job(server, begun) if begun else server.do('ros2_status')}") from error
    if way == "drive":
        moving = going_on(server, observer, topic, moving)
    latch.set(by="watchdog", reason="it moves at 0.5 m/s, and was told to stand")
    try:
        if way in ("repeat", "drive"):
            told = str(server.answer(moving))
        else:
            told = until(lambda: "It was ended by" in (told := job(server, begun)) and told)
    finally:
        latch.reset(by="operator", seen=latch.look().count)
        calm(observer, topic)
    why = "it was set by watchdog: «it moves at 0.5 m/s, and was told to stand»."
    assert f"It was ended by the latch of the robot, which only an operator resets; {why}" in told


def job(server: Driver, begun: dict[str, Any]) -> str:
    """What the server tells of a relay or a playback."""
    if own := begun.get("relay_id"):
        return str([row for row in server.do("ros2_relay_list")["relays"] if row["relay_id"] == own])
    return str(server.do("ros2_bag_play_status", playback_id=begun["playback_id"]))
