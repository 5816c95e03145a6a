"""The simulated arm without ROS: it follows trajectories within its limits, and its URDF says what it is."""

import pytest

from ros2_mcp.world.urdf import Limits, parse
from ros2_mcp_demo.arm.description import ARM, BY_NAME, HOME, JOINTS, description, tool_point
from ros2_mcp_demo.arm.simulation import Simulation

STEP_S = 0.02


def run(arm, seconds):
    """Steps the arm; the fastest that each joint was meanwhile."""
    fastest = dict.fromkeys(arm.joints, 0.0)
    for _ in range(round(seconds / STEP_S)):
        arm.step(STEP_S)
        for name, joint in arm.joints.items():
            fastest[name] = max(fastest[name], abs(joint.velocity))
    return fastest


def test_its_urdf_has_the_joints_that_it_has():
    urdf = parse(description())
    assert urdf.problems == []
    assert urdf.root == "world"
    assert [joint.name for joint in urdf.moving] == [joint.name for joint in JOINTS]
    for joint in JOINTS:
        assert urdf.joints[joint.name].limits == Limits(joint.lower, joint.upper, joint.velocity, joint.effort)
    assert urdf.controlled.keys() == BY_NAME.keys()
    assert urdf.mount("tool_link").xyz == pytest.approx((0.0, 0.0, 1.15))
    assert set(parse(description("left/")).joints) == {f"left/{name}" for name in urdf.joints}


def test_its_tool_is_where_its_joints_put_it():
    x, y, z = tool_point(dict.fromkeys(ARM, 0.0))
    assert (x, y, z) == pytest.approx((0.0, 0.0, 1.21))
    x, y, z = tool_point({"shoulder_lift_joint": 1.5707963, "shoulder_pan_joint": 1.5707963})
    assert (x, y, z) == pytest.approx((0.0, 0.99, 0.22), abs=1e-6)


def test_it_stands_where_it_was_started():
    arm = Simulation()
    run(arm, 2.0)
    assert {name: joint.position for name, joint in arm.joints.items() if joint.position} == HOME
    assert not arm.is_moving()


@pytest.mark.parametrize("rates", [None, [0.0] * 6])
def test_a_trajectory_is_followed_to_its_end_within_the_limits_of_each_joint(rates):
    arm = Simulation()
    goal = [0.8, -0.2, 0.4, -0.5, 1.0, -0.3]
    arm.controllers["arm"].follow(ARM, [(3.0, goal, rates)])
    fastest = run(arm, 4.0)
    assert [arm.joints[name].position for name in ARM] == pytest.approx(goal, abs=2e-3)
    assert not arm.is_moving()
    assert all(fastest[name] <= joint.velocity for name, joint in BY_NAME.items())


def test_what_is_asked_too_fast_or_too_far_is_done_as_far_as_the_joint_can():
    arm = Simulation()
    arm.controllers["arm"].follow(ARM, [(0.1, [3.0, 0, 0, 0, 0, 0], None)])
    assert run(arm, 4.0)["shoulder_pan_joint"] <= 1.5
    assert arm.joints["shoulder_pan_joint"].position == pytest.approx(3.0, abs=2e-3)
    arm.controllers["arm"].follow(["shoulder_pan_joint"], [(1.0, [9.0], None)])
    run(arm, 5.0)
    assert arm.joints["shoulder_pan_joint"].position == 3.1


def test_a_hold_in_the_middle_ends_the_motion_where_it_is():
    arm = Simulation()
    arm.controllers["arm"].follow(ARM, [(4.0, [2.0, 0, 0, 0, 0, 0], [0.0] * 6)])
    run(arm, 2.0)
    pan = arm.joints["shoulder_pan_joint"]
    before, speed = pan.position, pan.velocity
    assert speed > 0.5
    arm.controllers["arm"].hold()
    run(arm, 2.0)
    assert not arm.is_moving()
    assert abs(pan.position - before) < speed * 0.2


def test_joints_that_are_left_out_stay():
    arm = Simulation()
    arm.controllers["arm"].follow(["wrist_3_joint"], [(1.0, [0.5], None)])
    run(arm, 2.0)
    assert arm.joints["elbow_joint"].position == pytest.approx(1.2, abs=1e-6)
    assert arm.joints["wrist_3_joint"].position == pytest.approx(0.5, abs=2e-3)
