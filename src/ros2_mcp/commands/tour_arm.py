"""The tour's chapters with the simulated arm: moves by name, limits, a stop in the middle, and a stuck joint."""

from __future__ import annotations

import asyncio
from typing import Any

from ros2_mcp.commands.transcript import Tour

_TOPIC = "/arm_controller/joint_trajectory"
_PAN = "shoulder_pan_joint"
_STANDS = 0.005
"""The most that a stopped joint may move within half a second, in rad: far above the encoders' noise."""


async def look_at_the_arm(tour: Tour) -> None:
    """Show the joint positions, the tool, and the base."""
    tour.say("1. Where are the joints, and the tool?")
    for name, position in (await _joints(tour)).items():
        tour.show(f"{name:22} {position:7.3f}")
    tool = await tour.call("ros2_tf_lookup", target="base_link", source="tool_link")
    tour.show(f"{'tool_link':22} {tool['distance_m']:7.3f} m from base_link")
    seen = await tour.call("ros2_scene")
    tour.verify("the picture has its base in the world", (seen["frame_id"], seen["robot_x_m"]) == ("world", 0.0))


async def move_by_name(tour: Tour) -> None:
    """Move joints within their limits, and try to move one beyond."""
    tour.say("2. Move joints by name, within the limits of the URDF.")
    moved = await tour.call("ros2_joint_move", joints={_PAN: 0.5, "elbow_joint": 0.8}, speed=0.6, controller=_TOPIC)
    for joint in moved["joints"]:
        tour.show(f"{joint['name']:22} {joint['measured']:7.3f} of {joint['target']:.3f} {joint['unit']}")
    tour.verify("the joint states agree", moved["outcome"] == "reached")
    told = await tour.refused("ros2_joint_move", joints={"elbow_joint": 3.0})
    tour.verify("3 rad is refused: the URDF allows 2.6", "beyond its limits" in told)


async def stop_in_the_middle(tour: Tour) -> None:
    """Stop a trajectory, because it would continue by itself: the joints hold their measured positions."""
    tour.say("3. Begin a long move, and stop it in the middle.")
    move: dict[str, Any] = {"joints": {_PAN: -1.5}, "duration_s": 6.0, "controller": _TOPIC}
    moving = asyncio.create_task(tour.call("ros2_joint_move", **move))
    away = "position[0] < 0.1"
    await tour.call("ros2_wait_until", topic_name="/joint_states", condition=away, timeout_s=10.0)
    tour.show((await tour.call("ros2_stop"))["note"])
    moved = await moving
    tour.show(moved["note"])
    before = (await _joints(tour))[_PAN]
    await asyncio.sleep(0.5)
    after = (await _joints(tour))[_PAN]
    tour.verify(f"the shoulder is held at {after:.2f} rad, not at -1.5", abs(after - before) < _STANDS and after > -1.2)


async def find_what_is_stuck(tour: Tour) -> None:
    """Move a stuck joint: the result names it."""
    tour.say("4. One joint is stuck: which?")
    await tour.call("ros2_parameter_set", node_name="/arm_controller", values={"stuck_joint": "wrist_1_joint"})
    moved = await tour.call("ros2_joint_move", joints={"wrist_1_joint": 0.0, "elbow_joint": 1.0}, controller=_TOPIC)
    tour.show(f"{moved['outcome']}: {moved['note']}")
    tour.verify("the move says which", "wrist_1_joint has not moved" in moved["note"])
    await tour.call("ros2_parameter_set", node_name="/arm_controller", values={"stuck_joint": ""})


async def _joints(tour: Tour) -> dict[str, float]:
    message = (await tour.call("ros2_topic_echo_wait", topic_name="/joint_states"))["message"]
    return dict(zip(message["name"], message["position"], strict=True))


ARM = (look_at_the_arm, move_by_name, stop_in_the_middle, find_what_is_stuck)
