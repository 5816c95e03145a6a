"""Lists of goals: a person approves the whole list with its first goal, and it is decided before that is sent."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ros2_mcp.guard.approvals import Approvals
from ros2_mcp.guard.exact import ExactCommand
from ros2_mcp.guard.policy import Facts, Policy
from ros2_mcp.guard.policy_file import compiled, document_of
from ros2_mcp.model.commands import LOCAL, Route, SendGoal
from ros2_mcp.model.errors import ApprovalNeeded

KIND = "nav2_msgs/action/NavigateToPose"
RULES = """
policy: 1
allow:
  - goal: /navigate_to_pose
    type: nav2_msgs/action/NavigateToPose
    consent: each
    fields: {x: {range: [-5, 5]}}
"""


def goal(x: float) -> dict[str, Any]:
    return {"x": x, "behavior_tree": ""}


LIST = [goal(1.0), goal(2.0), goal(3.0)]


def first(route_id: str = "navigation_1", **changes: Any) -> ExactCommand:
    listed = Route(id=route_id, **{"goals": LIST, "loops": 2, "waits_s": [0.0, 5.0, 0.0], **changes})
    return ExactCommand.of(sending(1.0, listed))


def sending(x: float, route: Route | None = None) -> SendGoal:
    return SendGoal(
        principal=LOCAL,
        name="/navigate_to_pose",
        type=KIND,
        value=goal(x),
        goal_id="0" * 31 + "1",
        timeout_s=1,
        route=route,
    )


def later(x: float, route_id: str = "navigation_1") -> ExactCommand:
    return ExactCommand.of(sending(x, Route(id=route_id)))


def approved(approvals: Approvals, exact: ExactCommand) -> str:
    with pytest.raises(ApprovalNeeded) as needed:
        approvals.require(exact)
    approvals.approve(needed.value.request_id, by="operator ann")
    return approvals.require(exact)


def test_one_approval_covers_the_goals_of_the_list_for_the_job_that_sends_them() -> None:
    approvals = Approvals()
    given = approved(approvals, first())
    for x in (2.0, 3.0, 1.0, 2.0):
        assert approvals.require(later(x)) == given
    for other in (later(4.0), later(2.0, "navigation_2"), ExactCommand.of(sending(2.0)), first()):
        with pytest.raises(ApprovalNeeded):
            approvals.require(other)
    approvals.end_route("navigation_1")
    with pytest.raises(ApprovalNeeded):
        approvals.require(later(2.0))


def test_a_stop_ends_the_approval_of_the_rest() -> None:
    epoch = ["1"]
    approvals = Approvals(epoch=lambda: epoch[0])
    approved(approvals, replace(first(), epoch="1"))
    epoch[0] = "2"
    with pytest.raises(ApprovalNeeded):
        approvals.require(replace(later(2.0), epoch="2"))


def test_an_approval_binds_all_of_the_list_and_not_the_job_that_asks_again() -> None:
    assert first().key == first("navigation_2").key
    for change in (
        {"goals": LIST[:2], "waits_s": [0.0, 5.0]},
        {"goals": [LIST[0], LIST[2], LIST[1]]},
        {"loops": 3},
        {"waits_s": [0.0, 6.0, 0.0]},
        {"goes_on": True},
    ):
        assert first().key != first(**change).key, change


def test_the_person_reads_every_goal_with_loops_and_waits() -> None:
    told = first().summary()
    assert "3 goals" in told[1] and "2 times" in told[1] and "a missed one ends it" in told[1]
    assert told[2].startswith("Goal 1: x 1.0") and told[3].startswith("Goal 2, then wait 5.0 s: x 2.0")
    assert told[4].startswith("Goal 3: x 3.0")
    assert len(first(goals=[goal(float(x)) for x in range(1, 101)], waits_s=()).summary()) == 1 + 1 + 100 + 1


def test_a_grant_for_one_goal_covers_a_list_only_within_its_bounds() -> None:
    approvals = Approvals()
    with pytest.raises(ApprovalNeeded) as needed:
        approvals.require(ExactCommand.of(sending(1.0)))
    grant = approvals.grant(needed.value.request_id, 60.0, {"x": 2.5}, by="operator ann")
    near = {"goals": LIST[:2], "waits_s": ()}
    assert approvals.require(first(**near)) == grant.id
    with pytest.raises(ApprovalNeeded):
        approvals.require(first())


def test_a_goal_of_the_list_that_the_policy_refuses_refuses_it_before_anything_is_sent() -> None:
    document = document_of(RULES, "a test")
    policy = Policy(documents=(document,), rules=compiled([document]))
    command = sending(1.0, Route(id="navigation_1", goals=[goal(1.0), goal(9.0)]))
    decision = policy.decide(command, Facts(value=goal(1.0), route=[goal(1.0), goal(9.0)]))
    assert decision.verdict == "refused" and "goal 2 of 2: " in decision.reason
    assert policy.decide(command, Facts(value=goal(1.0), route=[goal(1.0), goal(2.0)])).verdict == "consent"
