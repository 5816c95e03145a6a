"""The words of `ros2_stop`: it is confirmed only if there is nothing to doubt."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ros2_mcp.ops.actions.running import RunningGoal
from ros2_mcp.ops.stop.judge import Observation
from ros2_mcp.ops.stop.stop import Stopped, StoppedGoal, StoppedTopic, _doubts, _facts, _unknown, looked_again

ENDED = {"repeats": 0, "relays": 0, "dropped": [], "topics": []}
UNSEEN = Observation(verdict="not observed", sentence="Not observed.")
BASE_STANDS = Observation(verdict="observed still", sentence="Observed still.", has_base=True)
JOINTS_STAND = Observation(verdict="observed still", sentence="Observed still.")


@pytest.mark.promise("stopping", "The answer of ros2_stop names them")
@pytest.mark.promise("README", "every zero was acknowledged (or nobody listens), nobody else publishes on those topics")
@pytest.mark.promise("stopping", "a subscriber did not acknowledge the zero, or discovery is still under way")
@pytest.mark.parametrize(
    ("topic", "doubt"),
    [
        (StoppedTopic("/cmd_vel", 1, True), ""),
        (StoppedTopic("/cmd_vell", 0, None), ""),  # nobody has to acknowledge it
        (
            StoppedTopic("/cmd_vel", 1, True, ["/teleop"]),
            "/teleop also publishes on /cmd_vel: the robot may still move.",
        ),
        (StoppedTopic("/cmd_vel", 1, False), "Not every subscriber of /cmd_vel has acknowledged the zero."),
        (
            StoppedTopic("/cmd_vel", 2, None),
            "Arrival of the zero on /cmd_vel is unknown: not every subscriber acknowledges.",
        ),
        (StoppedTopic("/cmd_vel", 0, False, error="/cmd_vel got no zero."), "/cmd_vel got no zero."),
        (StoppedTopic("/cmd_vell", 0, False), ""),
        (
            StoppedTopic("/cmd_vel", 0, None, unreached_subscribers=2),
            "2 subscribers of /cmd_vel did not get the zero: stop again.",
        ),
        (
            StoppedTopic("/cmd_vel", 1, True, unreached_subscribers=1),
            "1 subscriber of /cmd_vel did not get the zero: stop again.",
        ),
    ],
)
def test_a_topic_is_still_only_if_everybody_who_listens_has_said_that_the_zero_arrived(
    topic: StoppedTopic, doubt: str
) -> None:
    assert " ".join(_doubts([topic], [], UNSEEN)) == doubt


def test_a_subscriber_that_never_acknowledges_needs_to_where_nothing_shows_that_the_robot_stands() -> None:
    topic = StoppedTopic("/cmd_vel", 1, None)
    assert _doubts([topic], [], UNSEEN) != [] and _doubts([topic], [], BASE_STANDS) == []


def test_a_subscriber_that_left_is_a_doubt_unless_another_stays_and_odometry_shows_that_the_base_stands() -> None:
    said = ["/base received commands on /cmd_vel and has left the graph: it may still move."]
    one_left = StoppedTopic("/cmd_vel", 1, True, lost_subscribers=["/base"])
    assert _doubts([one_left], [], UNSEEN) == _doubts([one_left], [], JOINTS_STAND) == said
    assert _doubts([one_left], [], BASE_STANDS) == []
    assert _doubts([replace(one_left, subscribers=0, is_deserted=True)], [], BASE_STANDS) == said
    nameless = StoppedTopic("/cmd_vel", 0, None, is_deserted=True)
    assert _doubts([nameless], [], BASE_STANDS)[0].startswith("A subscriber received commands on /cmd_vel and has left")


@pytest.mark.promise("README", "(or nobody listens)")
def test_that_nobody_listens_is_said() -> None:
    assert _facts(ENDED, [StoppedTopic("/cmd_vell", 0, None)], [], {}) == ["/cmd_vell has no subscriber now."]
    assert _facts(ENDED, [StoppedTopic("/cmd_vel", 0, None, unreached_subscribers=1)], [], {}) == []


def test_what_cannot_be_stopped_is_named_up_to_a_bound() -> None:
    services = [("service", f"/s{number} (std_srvs/srv/Trigger)") for number in range(30)]
    [doubt] = _unknown([*services, ("topic", "/lamp (std_msgs/msg/Bool)")])
    assert doubt.startswith("NOT judged: this server has called 30 services and published on 1 topic")
    assert "/s9 (" in doubt and "/s10 (" not in doubt and "/lamp (std_msgs/msg/Bool)" in doubt
    assert _unknown([]) == []


def test_goals_that_had_ended_are_not_counted_as_cancelled() -> None:
    goals = [StoppedGoal("/go", "a", "CANCELED", True, True), StoppedGoal("/go", "b", "SUCCEEDED", True, False)]
    stopped = Stopped(repeats_stopped=0, relays_stopped=0, topics=[], goals=goals, confirmed=True, note="")
    assert "1 goal cancelled, 1 goal had ended already" in stopped.summary()


def test_a_goal_that_goes_on_has_not_ended_already() -> None:
    goals = [StoppedGoal("/go", "a", "EXECUTING", False)]
    nothing = Stopped(repeats_stopped=0, relays_stopped=0, topics=[], goals=goals, confirmed=False, note="")
    stopped = replace(nothing, is_doubted=True)
    assert stopped.summary().startswith("NOT confirmed") and "had ended already" not in stopped.summary()
    assert _doubts([], goals, UNSEEN) == ["Goal a has not ended yet."]


class Looks:
    """Looks up running goals on a busy computer: only with patience."""

    def __init__(self, found: list[RunningGoal] | None) -> None:
        self._found, self.patience_s = found, list[float]()

    async def __call__(self, *_: object, **patience: float) -> list[RunningGoal] | None:
        self.patience_s += patience.values()
        return self._found if patience else None


GOAL = RunningGoal("/navigate_to_pose", "nav2_msgs/action/NavigateToPose", "a1", "EXECUTING")


async def test_a_goal_of_another_client_is_looked_for_again_where_the_robot_moves_or_the_first_look_was_too_short() -> (
    None
):
    assert await looked_again(Looks([GOAL]), [], is_moving=True) == [GOAL]
    assert await looked_again(Looks([GOAL]), None, is_moving=False) == [GOAL]
    assert await looked_again(Looks(None), None, is_moving=False) is None
    quick = Looks([GOAL])
    assert await looked_again(quick, [], is_moving=False) == [] and quick.patience_s == []
    assert await looked_again(quick, [GOAL], is_moving=True) == [GOAL]  # still unknown: what was found counts
