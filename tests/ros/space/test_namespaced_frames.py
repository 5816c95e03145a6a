"""Frames that are told in a namespace, with nobody on /tf itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from support.agent import Agent, Refusal, until


def test_the_frames_of_the_only_namespace_are_followed_and_it_is_said(agent: Agent, tell: Callable[..., None]) -> None:
    tell("odom", "base_link", node="base", namespace="/robot1", x=2.0)
    tell("base_link", "laser", node="mounts", namespace="/robot1", x=0.5, static=True)

    def answer() -> dict[str, Any] | None:
        try:
            return agent.call("ros2_tf_lookup", target="odom", source="laser")
        except Refusal:
            return None

    found = until(answer)
    assert found["translation"]["x"] == 2.5
    assert "published on /robot1/tf and /robot1/tf_static: /tf has no publisher." in found["note"]
    assert "/tf has no publisher." in agent.call("ros2_tf_tree", picture=False)["note"]
