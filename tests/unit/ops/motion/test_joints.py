"""A move of joints is planned within the limits of the URDF, before anything is sent."""

from __future__ import annotations

from collections.abc import Mapping
from time import monotonic
from typing import Any

import pytest

from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.ops.motion.controllers import Controller
from ros2_mcp.ops.motion.joint_states import At, JointStates
from ros2_mcp.ops.motion.joints import JointRequest, Plan, check_request, joint_of, planned_move
from ros2_mcp.world.urdf import Urdf, parse
from ros2_mcp_demo.arm.description import ARM, HOME, description

URDF = parse(description())
CONTROLLER = Controller("/arm_controller", "/arm_controller/follow_joint_trajectory", "", ARM)


def states(**changed: float) -> JointStates:
    found = {name: HOME.get(name, 0.0) for name in (*ARM, "gripper_joint")} | changed
    return JointStates(["/joint_states"], {name: At(position, monotonic()) for name, position in found.items()})


async def planned(
    joints: Mapping[str, float], controller: Controller = CONTROLLER, urdf: Urdf = URDF, **more: Any
) -> Plan:
    request = JointRequest(joints=joints, **more)
    check_request(request)
    return await planned_move(request, [joint_of(urdf, name) for name in joints], controller, states())


async def test_the_joint_with_the_longest_way_goes_at_its_share_of_its_limit_and_all_arrive_together() -> None:
    plan = await planned({"elbow_joint": 0.0, "wrist_1_joint": 0.7}, speed=0.5)
    assert plan.planned_s == pytest.approx(1.5 * 1.2 / 1.5 / 0.5)
    point = plan.trajectory["points"][0]
    assert plan.trajectory["joint_names"] == list(ARM)
    assert point["positions"] == pytest.approx([0.0, -0.6, 0.0, 0.7, 0.0, 0.0])
    assert point["velocities"] == [0.0] * 6
    assert point["time_from_start"]["sec"] == 2


async def test_positions_from_where_the_joints_are_are_checked_where_they_lead() -> None:
    assert (await planned({"elbow_joint": -0.2}, relative=True)).targets == {"elbow_joint": pytest.approx(1.0)}
    with pytest.raises(BadInput, match="beyond its limits"):
        await planned({"elbow_joint": 1.5}, relative=True)


async def test_a_limit_itself_is_allowed_and_what_lies_behind_it_is_not() -> None:
    assert (await planned({"elbow_joint": 2.6})).targets["elbow_joint"] == 2.6
    with pytest.raises(BadInput, match=r"2\.6001 rad is beyond its limits"):
        await planned({"elbow_joint": 2.6001})


@pytest.mark.parametrize("limit", ['lower="${-pi}" upper="2.6"', 'lower="nan" upper="inf"'])
async def test_a_joint_whose_limits_are_no_numbers_is_not_held_between_zero_and_zero(limit: str) -> None:
    urdf = parse(description().replace('lower="-2.6" upper="2.6"', limit))
    with pytest.raises(BadInput, match="elbow_joint: its limits are unknown"):
        await planned({"elbow_joint": 0.0}, urdf=urdf)


async def test_a_time_in_which_a_joint_is_too_fast_is_refused_with_one_that_is_not() -> None:
    with pytest.raises(BadInput, match=r"Give at least 1\.20 s"):
        await planned({"elbow_joint": 0.0}, duration_s=1.1)
    assert (await planned({"elbow_joint": 0.0}, duration_s=1.2)).planned_s == 1.2


async def test_even_a_small_step_takes_a_moment() -> None:
    assert (await planned({"elbow_joint": 1.2001})).planned_s == 0.3


async def test_a_controller_that_does_not_tell_its_joints_gets_those_that_are_asked_for() -> None:
    plan = await planned({"elbow_joint": 1.0}, Controller("/arm", "", "/arm/joint_trajectory"))
    assert plan.trajectory["joint_names"] == ["elbow_joint"]


async def test_without_a_velocity_limit_a_time_is_asked_for() -> None:
    urdf = parse(description().replace(' velocity="1.5"', ""))
    with pytest.raises(BadInput, match="no velocity limit for elbow_joint"):
        await planned({"elbow_joint": 0.0}, urdf=urdf)
    assert (await planned({"elbow_joint": 0.0}, urdf=urdf, duration_s=5)).planned_s == 5


async def test_joints_of_which_nothing_is_heard_are_named_with_those_that_are() -> None:
    heard = JointStates(["/joint_states"], {"elbow_joint": At(0.0, monotonic())})
    with pytest.raises(NotFound, match="reports wrist_1_joint: only elbow_joint on /joint_states"):
        await heard.wait_for(["elbow_joint", "wrist_1_joint"], within_s=0.05)


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        (JointRequest(joints={}), "No joints"),
        (JointRequest(joints={"a": 1.0}, speed=0.5, duration_s=1.0), "either speed or duration_s"),
        (JointRequest(joints={"a": 1.0}, speed=0.0), "speed"),
        (JointRequest(joints={"a": 1.0}, duration_s=1e6), "duration_s"),
        (JointRequest(joints={"a": 1.0}, tolerance=0.0), "tolerance"),
    ],
)
def test_what_is_no_move_is_refused(request_: JointRequest, why: str) -> None:
    with pytest.raises(BadInput, match=why):
        check_request(request_)
