"""A draft from what was found: a policy in order, that lets the agent drive slowly where nobody else does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ros2_mcp.guard import trials
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.policy_file import compiled, document_of
from ros2_mcp.guard.trials import Trial
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.policy.draft import Arm, Found, lines_of_draft
from ros2_mcp.world.urdf import Joint, Limits

TWIST, CAR = "geometry_msgs/msg/Twist", "ackermann_msgs/msg/AckermannDriveStamped"


def at(node: str, kind: str = TWIST) -> Endpoint:
    return Endpoint(node=node, type=kind, hash="", gid="", qos=QoS())


FOUND = Found(
    domain=3,
    inputs=[
        TopicEndpoints("/cmd_vel", [], [at("/base")]),
        TopicEndpoints("/cmd_vel_nav", [at("/controller_server")], [at("/base")]),
        TopicEndpoints("/car/drive", [], [at("/car", CAR)]),
    ],
    odometry=["/odom"],
    actions=[("/navigate_to_pose", "nav2_msgs/action/NavigateToPose")],
    services=[(f"/beep_{number}", "std_srvs/srv/Trigger") for number in range(50)],
    watching=["/collision_monitor"],
    own_limits=["/base cmd_vel_timeout: 0.5"],
)


def draft(found: Found) -> str:
    return "".join(lines_of_draft(found))


def verdict(text: str, **trial: object) -> str:
    document = document_of(text, "draft")
    policy = Policy(documents=(document,), rules=compiled([document]))
    usual = {"verb": "publish", "name": "/cmd_vel", "type": TWIST}
    return trials.decided(policy, Trial(**{**usual, **trial})).verdict  # type: ignore[arg-type]


@pytest.mark.promise("README", "ros2-mcp policy init drafts one from the robot that is running")
def test_a_draft_lets_the_agent_drive_slowly_where_the_robot_listens_and_nobody_drives() -> None:
    text = draft(FOUND)
    assert verdict(text, value={"linear": {"x": 0.2}}) == "allowed"
    assert verdict(text, value={"linear": {"x": 0.3}}) == "refused"
    assert verdict(text, name="/cmd_vel_nav") == "refused"
    assert "Not /cmd_vel_nav: /controller_server" in text
    car = {"name": "/car/drive", "type": CAR}
    assert verdict(text, **car, value={"drive": {"speed": 0.2}}) == "allowed"
    assert verdict(text, **car, value={"drive": {"speed": 0.3}}) == "refused"


def test_what_else_was_found_stands_there_as_comments() -> None:
    text = draft(FOUND)
    goal = {"verb": "goal", "name": "/navigate_to_pose", "type": "nav2_msgs/action/NavigateToPose"}
    assert verdict(text, **goal) == "refused"
    uncommented = text.replace("  # - {goal:", "  - {goal:")
    assert verdict(uncommented, **goal) == "consent"
    assert verdict(
        text.replace("  # - {call:", "  - {call:"), verb="call", name="/beep_0", type="std_srvs/srv/Trigger"
    ) == ("allowed")
    assert "and 10 more services" in text
    assert "#   /collision_monitor" in text and "#   /base cmd_vel_timeout: 0.5" in text
    assert document_of(text, "draft").feedback is not None


@pytest.mark.parametrize("outline", ["", "footprint: [[0.3, 0.2], [0.3, -0.2], [-0.3, -0.2], [-0.3, 0.2]] # Nav2's"])
def test_zones_of_a_robot_with_nav2_stand_there_as_comments_with_its_own_outline(outline: str) -> None:
    text = draft(replace(FOUND, outline=outline, base="base_link"))
    assert document_of(text, "draft").keep_out is None
    begin = text.index("# keep_out:")
    zones = "\n".join(line[2:] for line in text[begin:].splitlines()[:4])
    keep_out = document_of(f"policy: 1\n{zones}", "draft").keep_out
    assert keep_out and (len(keep_out.footprint), keep_out.radius_m) == ((4, 0.0) if outline else (0, 0.3))
    assert "keep_out" not in draft(replace(FOUND, actions=[]))


def test_of_a_robot_without_any_of_it_the_draft_says_so_and_is_in_order() -> None:
    text = draft(replace(FOUND, inputs=[], odometry=[], actions=[], services=[], watching=[], own_limits=[]))
    assert verdict(text) == "refused"
    assert "No odometry was found" in text and "Nothing was found that seems to watch over this robot" in text


FOLLOW = "control_msgs/action/FollowJointTrajectory"
ARM = Arm(
    name="/arm_controller",
    action="/arm_controller/follow_joint_trajectory",
    topic="/arm_controller/joint_trajectory",
    joints={
        "elbow": Joint("elbow", "revolute", "a", "b", limits=Limits(-1.57, 1.57, 2.0)),
        "wrist": Joint("wrist", "continuous", "b", "c", limits=Limits(velocity=0.5)),
        "lift": Joint("lift", "prismatic", "c", "d", limits=Limits(0.0, 0.4, 0.1)),
        "unknown": None,
    },
)


def arm_goal(name: str, to: float, seconds: int, start: float = 0.0) -> dict[str, object]:
    point = {"positions": [to], "velocities": [0.0], "time_from_start": {"sec": seconds, "nanosec": 0}}
    value = {"trajectory": {"joint_names": [name], "points": [point]}}
    return {"verb": "goal", "name": ARM.action, "type": FOLLOW, "value": value, "joints": {name: start}}


def test_a_draft_lets_an_arm_move_slowly_within_its_description_after_a_person_has_approved_it() -> None:
    text = draft(replace(FOUND, arms=[ARM], actions=[*FOUND.actions, (ARM.action, FOLLOW)]))
    assert verdict(text, **arm_goal("elbow", 1.0, 6)) == "consent"
    assert verdict(text, **arm_goal("elbow", 1.0, 4)) == "refused"  # 0.375 rad/s in its middle
    assert verdict(text, **arm_goal("elbow", 1.6, 30)) == "refused"  # beyond the description
    assert verdict(text, **arm_goal("wrist", 1.0, 8)) == "refused"  # 0.19 rad/s, 0.15 is 30 % of its own limit
    assert verdict(text, **arm_goal("wrist", 9.0, 100)) == "consent"
    assert verdict(text, **arm_goal("lift", 0.1, 6)) == "consent"
    assert verdict(text, **arm_goal("lift", 0.1, 4)) == "refused"  # 0.0375 m/s, 0.03 is 30 % of its own limit
    assert verdict(text, **arm_goal("shoulder", 0.1, 20)) == "refused"  # no joint of it
    assert "/arm_controller moves elbow, wrist, lift, unknown" in text
    assert "unknown: {speed: 0.3} # the robot has no description of it" in text
    assert text.count(ARM.action) == 2  # as a rule and as a limit, and not as a comment, too
