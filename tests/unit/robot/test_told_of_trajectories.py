"""What a person reads of a trajectory before they approve it: all joints, the top speed, the time, the reach."""

from __future__ import annotations

import re
from typing import Any

from ros2_mcp.guard.exact import ExactCommand
from ros2_mcp.model.commands import LOCAL, SendGoal
from ros2_mcp.robot.joints import known
from ros2_mcp.robot.told_of_trajectories import told_of
from ros2_mcp.world.urdf import parse
from ros2_mcp_common.policy.curves import State
from ros2_mcp_common.policy.trajectory_limits import Joints

JOINTS = [f"joint_{number}" for number in range(1, 7)]
URDF = '<robot name="r"><link name="base"/>{}</robot>'.format(
    "".join(
        f'<link name="l{number}"/><joint name="joint_{number}" type="revolute"><parent link="{above}"/>'
        f'<child link="l{number}"/><origin xyz="0.1 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
        for number, above in enumerate(["base", *(f"l{number}" for number in range(1, 6))], 1)
    )
)
STAND = known(Joints({name: State(0.0) for name in JOINTS}))


def point(seconds: int, at: float) -> dict[str, Any]:
    time = {"sec": seconds, "nanosec": 0}
    return {"positions": [at] * 6, "velocities": [0.0] * 6, "accelerations": [], "time_from_start": time}


def trajectory(*points: dict[str, Any]) -> dict[str, Any]:
    return {"header": {"stamp": {"sec": 0, "nanosec": 0}}, "joint_names": JOINTS, "points": list(points)}


def test_no_joint_and_no_time_is_left_out_of_what_a_person_reads() -> None:
    value = {"trajectory": trajectory(point(4, 0.5), point(10, -0.25))}
    told = told_of([("trajectory", value["trajectory"])], STAND, parse(URDF))
    command = SendGoal(
        principal=LOCAL, name="/arm", type="p/action/A", value=value, goal_id="0" * 31 + "1", timeout_s=1
    )
    summary = ExactCommand.of(command, told=told).summary()
    assert summary[1 : 1 + len(told)] == told  # before the points, which are cut
    assert all(f"{name} from -0.25 to 0.5 rad" in told[0] for name in JOINTS)
    assert told[1] == "Top speed 0.1875 rad/s of joint_1; 2 points in 10 s."
    assert re.fullmatch(r"l6 comes at most 0\.6 m away from base, and at most down to z 0 m\.", told[2])
    assert all(line.isascii() for line in told)


def test_it_is_said_what_is_not_known() -> None:
    sent = [("trajectory", trajectory(point(4, 0.5)))]
    assert "No description (URDF)" in told_of(sent, STAND, None)[-1]
    assert told_of(sent, known(Joints()), parse(URDF)) == ["What trajectory does between its points is not known."]
    assert told_of([("trajectory", trajectory())], STAND, None) == []


def test_what_is_told_is_not_bound_to_the_approval() -> None:
    value = {"trajectory": trajectory(point(4, 0.5))}
    command = SendGoal(
        principal=LOCAL, name="/arm", type="p/action/A", value=value, goal_id="0" * 31 + "1", timeout_s=1
    )
    assert ExactCommand.of(command, told=["a"]).key == ExactCommand.of(command).key
