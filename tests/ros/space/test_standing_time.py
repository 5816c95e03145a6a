"""Simulated time that stands still, over real DDS: told with what /clock says, and once."""

from __future__ import annotations

from collections.abc import Callable

from support.agent import Agent, until


def test_a_clock_that_stands_still_is_told_with_since_when(agent: Agent, tell: Callable[..., None]) -> None:
    for parent, child in (("odom", "base_link"), ("base_link", "laser")):
        tell(parent, child, node="simulator", stamp_s=5.0)

    def said() -> str:
        if "is stopped at" not in "".join(agent.call("ros2_tf_tree", picture=False)["problems"]):
            return ""
        return agent.call("ros2_tf_lookup", target="odom", source="laser")["note"]

    note = until(said)
    assert "Simulated time stopped" in note and "at 5.000 s of its clock, and so did all stamps" in note
    assert "/clock, published by /simulator, is stopped at 5.000 s of its clock" in note
    assert "stale" not in note and "again and again, now" not in note
