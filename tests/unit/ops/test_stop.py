from __future__ import annotations

from ros2_mcp.ops.stop import Stopped, StoppedGoal, StoppedTopic, _is_still, _note


def test_a_topic_that_somebody_else_publishes_on_is_not_still() -> None:
    assert _is_still(StoppedTopic("/cmd_vel", 1, True))
    assert not _is_still(StoppedTopic("/cmd_vel", 1, True, ["/teleop"]))


def test_a_topic_that_nobody_listens_to_needs_no_acknowledgement() -> None:
    assert _is_still(StoppedTopic("/cmd_vell", 0, False))
    assert not _is_still(StoppedTopic("/cmd_vel", 1, False))


def test_the_note_names_who_else_may_move_the_robot() -> None:
    note = _note(0, [StoppedTopic("/cmd_vel", 1, True, ["/teleop"])], [])
    assert note == "/teleop also publishes on /cmd_vel: the robot may still move."


def test_goals_that_had_ended_are_not_counted_as_cancelled() -> None:
    goals = [StoppedGoal("/go", "a", "CANCELED", True, True), StoppedGoal("/go", "b", "SUCCEEDED", True, False)]
    assert "1 goal(s) cancelled, 1 had ended already" in Stopped(0, 0, [], goals, True, "").summary()
