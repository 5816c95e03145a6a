"""`ros2_robot` on the simulated robots: every field against what is known of them."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from support.agent import Agent, agent_for, until
from support.demo_robot import build_interfaces, with_interfaces
from support.processes import running

ROBOTS = ["rover", "arm", "drone"]


@pytest.fixture(scope="module", params=ROBOTS)
def simulated(request: pytest.FixtureRequest, ros_environment: dict[str, str]) -> Iterator[tuple[str, Agent]]:
    """The kind of robot, and a client of a server beside it."""
    known = with_interfaces(ros_environment, build_interfaces(request.param, later=True))
    command = (sys.executable, "-m", "ros2_mcp_demo", "--robot", request.param)
    with running(known, *command), agent_for(ros_environment) as agent:
        yield request.param, agent


@pytest.mark.promise("ros2_robot", "kind, size, command inputs, sensors, joints, where it is")
def test_every_field_is_right_and_all_of_it_is_small(simulated: tuple[str, Agent]) -> None:
    kind, agent = simulated

    def whole() -> dict[str, Any] | None:
        """Once everything has been discovered."""
        found = agent.call("ros2_robot")
        return None if wrong(kind, found) else found

    found: dict[str, Any] = {}
    try:
        found = until(whole, 45.0)  # each try takes seconds
    except AssertionError:
        last = agent.call("ros2_robot")
        pytest.fail("\n".join([*wrong(kind, last), json.dumps(last, indent=1, ensure_ascii=False)]))
    assert len(json.dumps(found, ensure_ascii=False, separators=(",", ":")).encode()) <= 4000


def wrong(kind: str, found: dict[str, Any]) -> list[str]:
    """The fields that are not as they should be."""
    return [field for field, expected in FACTS[kind].items() if not agrees(expected, found[field])]


def agrees(expected: str | list[str], found: Any) -> bool:
    if isinstance(expected, list):
        return len(expected) == len(found) and all(map(agrees, expected, found))
    return bool(re.fullmatch(expected, found))


RATE = r" [\d.]+ Hz"
FACTS: dict[str, dict[str, str | list[str]]] = {
    "rover": {
        "name": "ros2_mcp_demo",
        "kind": "differential drive base, 2 wheels",
        "base_frame": "base_link",
        "footprint": "0.40 × 0.40 m, centred",
        "place": r"In map at x -?0.\d\d y -?0.\d\d m, yaw -?\d° \(TF, localised, 0.\d s old\).",
        "command_inputs": [
            r"/cmd_vel Twist → /base_controller.*",
            r"/cmd_vel_nav Twist → /base_controller \(from .*\)",
            r"/navigate_to NavigateTo \(action\) → /navigator",
            r"/navigate_to_pose NavigateToPose \(action\) → /bt_navigator",
        ],
        "other_actions": ["/compute_path_to_pose ComputePathToPose → /planner_server"],
        "topics_without_publisher": ["/speed_limit SpeedLimit → /controller_server"],
        "command_services": [
            "/enable_motors SetBool",
            "/reset_odometry Trigger",
            "/self_test Trigger",
            "/set_mode SetMode",
            "/slow_echo SlowEcho",
            "/spawn_obstacle SpawnObstacle",
            "/gripper/close SetBool",
        ],
        "sensors": [
            rf"/scan LaserScan{RATE} in laser at 0 0 0.22, 0.12 to 5 m over 359°",
            r"/battery_state BatteryState \d+%.*",
            rf"/camera/depth/image_raw Image{RATE} in camera_optical at 0.15 0 0.35",
            rf"/imu Imu{RATE} in imu_link at 0 0 0.1",
            rf"/camera/image_raw Image{RATE} 70° wide in camera_optical at 0.15 0 0.35",
        ],
        "state_topics": [
            rf"/joint_states JointState{RATE}",
            rf"/odom Odometry{RATE}",
            rf"/gripper/joint_states JointState{RATE}",
            r"/heartbeat String «.*»",
            r"/mode String «manual»( \(\d+(\.\d+)? s old, from before\))?",
        ],
        "joints": [
            *(rf"{side}_wheel_joint continuous -?[\d.]+ rad" for side in ("left", "right")),
            r"gripper_joint 0.08 \(no unit\)",
        ],
        "controllers": [],
        "stacks": ["Nav2: 3 of 3 active"],
        "frames": r"map → odom → base_link; 7 frames in total",
        "unhealthy": [],
    },
    "arm": {
        "name": "ros2_mcp_arm",
        "kind": "arm of 6 joints and a gripper",
        "base_frame": "base_link",
        "footprint": "0.20 × 0.20 m, centred",
        "place": r"In world at x 0.00 y 0.00 m, yaw 0° \(TF, static\).",
        "command_inputs": [
            rf"/{name}_controller/follow_joint_trajectory FollowJointTrajectory "
            rf"\(action, or topic joint_trajectory\) → /{name}_controller"
            for name in ("arm", "gripper")
        ],
        "other_actions": [],
        "topics_without_publisher": [],
        "command_services": ["/self_test Trigger"],
        "sensors": [],
        "state_topics": [rf"/joint_states JointState{RATE}", r"/heartbeat String «.*»"],
        "joints": [
            *(
                rf"{name}_joint -?[\d.]+ rad, limits -{limit} to {limit} rad, at most {speed} rad/s"
                for name, limit, speed in (
                    ("shoulder_pan", 3.1, 1.5),
                    ("shoulder_lift", 1.8, 1.2),
                    ("elbow", 2.6, 1.5),
                    ("wrist_1", 2, 2),
                    ("wrist_2", 3.1, 2),
                    ("wrist_3", 2, 2),
                )
            ),
            r"gripper_joint prismatic 0.02 m, limits 0 to 0.04 m, at most 0.1 m/s",
        ],
        "controllers": [
            "/arm_controller",
            "/gripper_controller",
        ],
        "stacks": [],
        "frames": r"world → base_link; 11 frames in total",
        "unhealthy": [],
    },
    "drone": {
        "name": "ros2_mcp_demo_drone",
        "kind": "drone, 4 rotors",
        "base_frame": "base_link",
        "footprint": "0.69 × 0.69 m, centred, swept by the rotors",
        # It stands 0.12 m high, and its position is measured with a standard deviation of 0.02 m: five of them.
        "place": r"In map at x -?0.\d\d y -?0.\d\d z 0.(0[2-9]|1\d|2[0-2]) m, yaw 90° \(TF, localised, 0.\d s old\).",
        "command_inputs": [
            r"/X3/cmd_vel Twist → /quadcopter",
            r"/mavros/setpoint_velocity/cmd_vel TwistStamped → /mavros/mavros",
            r"/mavros/setpoint_velocity/cmd_vel_unstamped Twist → /mavros/mavros",
            r"/mavros/setpoint_position/local PoseStamped \(goal\) → /mavros/mavros",
        ],
        "other_actions": [],
        "topics_without_publisher": [],
        "command_services": [
            "/mavros/set_mode SetMode",
            "/mavros/cmd/arming CommandBool",
            "/mavros/cmd/command CommandLong",
            "/mavros/cmd/land CommandTOL",
            "/mavros/cmd/takeoff CommandTOL",
            "/mavros/mission/push WaypointPush",
        ],
        "sensors": [
            rf"/mavros/global_position/global NavSatFix{RATE} in gps_link at 0 0 0.08",
            r"/mavros/battery BatteryState \d+%.*",
        ],
        "state_topics": [
            rf"/odom Odometry{RATE}",
            rf"/mavros/extended_state ExtendedState{RATE}",
            rf"/mavros/state State{RATE}",
            r"/mavros/global_position/compass_hdg Float64 [\d.]+",
            r"/mavros/global_position/rel_alt Float64 -?[\d.e-]+",
            r"/mavros/home_position/home HomePosition.*",
            r"/mavros/mission/waypoints WaypointList.*",
            r"/mavros/statustext/recv StatusText",
        ],
        "joints": [],
        "controllers": [],
        "stacks": ["MAVROS"],
        "frames": r"map → base_link; 5 frames in total",
        "unhealthy": [],
    },
}
"""What is known of each robot; of texts and lines the whole, as a regular expression."""
