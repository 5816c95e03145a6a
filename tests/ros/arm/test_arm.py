"""Joints are moved by name within the URDF's limits, by action and by topic; a joint trajectory is stopped by a hold
where the joints are, whoever ends it, in the middle of a move.
"""

from __future__ import annotations

import base64
import io
import os
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageColor

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.pictures.scene import LIMB
from ros2_mcp_demo.arm.description import tool_point
from support.agent import FULL, Refusal, until
from support.arm_moves import HOME, far, trajectory
from support.browser import CHROMIUM, browsing
from support.driver import Driver
from support.raw_server import RawServer, children, lives
from support.viewing import complaints, pictured_in_all_sizes, text, viewing

pytestmark = pytest.mark.timeout(180)
TOPIC, ACTION = "/arm_controller/joint_trajectory", "/arm_controller/follow_joint_trajectory"
PAN = "shoulder_pan_joint"
TAKES_S = 4.0 if FULL else 12.0
"""A move that is ended in its middle: the longer it takes, the later the end of a busy machine may be."""
BRAKES = 0.25
"""How far the shoulder may go on: it turns at 0.6 rad/s, the hold is there within 0.2 s, and it then brakes."""


@pytest.fixture(autouse=True)
def _at_home(agent, witness) -> Iterator[None]:
    """Each test begins with the arm near where it started."""
    if any(abs(witness.joints()[name] - at) > 0.05 for name, at in HOME.items()):
        agent.call("ros2_joint_move", joints=dict(HOME), speed=1)
    yield


def row(moved: dict[str, Any], name: str) -> dict[str, Any]:
    return next(found for found in moved["joints"] if found["name"] == name)


def test_the_scene_shows_the_arm_where_its_joints_are(agent, witness) -> None:
    def shown() -> bool:
        result = agent.whole("ros2_scene", {})
        facts, [picture] = result.structured_content, [part for part in result.content if part.type == "image"]
        pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.data))).convert("RGB")).astype(int)
        x, y, _ = tool_point(witness.joints())
        row = round(facts["top_px"] + (facts["y_max_m"] - y) / facts["metres_per_pixel"])
        column = round(facts["left_px"] + (x - facts["x_min_m"]) / facts["metres_per_pixel"])
        near = pixels[row - 15 : row + 15, column - 15 : column + 15].reshape(-1, 3)
        links = [layer for layer in facts["layers"] if layer["kind"] == "links"]
        return bool(links) and (np.abs(near - ImageColor.getrgb(LIMB)).max(axis=1) < 8).any()

    until(shown, 60.0)


@pytest.mark.skipif(not CHROMIUM, reason="needs Chromium")
def test_the_page_shows_the_arm_its_links_and_its_joints(agent, ros_environment: dict[str, str]) -> None:
    with viewing(ros_environment) as address, browsing(graphics=True) as page:
        page.look()
        page.open(address)
        page.until("/Robot at 0.00, 0.00 metres in world/.test(document.querySelector('#map canvas').ariaLabel)")
        page.until(f"{text('#values .tree')}.includes({PAN!r})")
        page.until(f"{text('#map .age')} === 'world · fixed'")
        assert page.run(text("#state")) == "live"
        joints = "[...document.querySelectorAll('#values .joints tbody tr')].map(row => row.cells[0].textContent)"
        assert page.run(joints)[:3] == ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
        pictured_in_all_sizes(page, "arm")
        page.run("document.querySelector('[aria-controls=space]').click()")
        page.until("/[1-9][0-9]* shapes of the robot/.test(document.querySelector('#space canvas').ariaLabel)")
        pictured_in_all_sizes(page, "arm-space")
        assert complaints(page) == []


@pytest.mark.promise("ros2_joint_move", "returns when they have arrived")
@pytest.mark.parametrize("way", [ACTION, TOPIC])
def test_joints_go_where_they_are_sent_and_the_others_stay(agent, witness, way: str) -> None:
    joints = {"elbow_joint": 0.9, "wrist_2_joint": 0.4}
    moved = agent.call("ros2_joint_move", joints=joints, speed=0.6, controller=way)
    assert moved["outcome"] == "reached", moved["note"]
    assert moved["interface"] == way
    found = witness.joints()
    for name, target in joints.items():
        assert found[name] == pytest.approx(target, abs=0.02)
        assert row(moved, name)["measured"] == pytest.approx(found[name], abs=0.01)
    assert found["shoulder_lift_joint"] == pytest.approx(-0.6, abs=0.01)
    if FULL:
        assert moved["elapsed_s"] < moved["planned_s"] + 3.0 + 1.5  # what it says itself when it gives up


def test_the_tool_is_looked_up_and_the_scene_has_the_base_in_the_world(agent) -> None:
    tool = agent.call("ros2_tf_lookup", target="base_link", source="tool_link")
    assert tool["chain"][0] == "tool_link" and 0.2 < tool["distance_m"] < 1.5 and not tool["is_static"]
    scene = agent.call("ros2_scene")
    assert (scene["frame_id"], scene["robot_x_m"], scene["robot_y_m"]) == ("world", 0.0, 0.0)
    assert "footprint" in {layer["kind"] for layer in scene["layers"]}

    def is_sound() -> bool:
        """Of a second in which a busy machine has not held up who tells the joints."""
        tree = agent.call("ros2_tf_tree", duration_s=1.0, picture=False)
        return (tree["roots"], tree["problems"]) == (["world"], [])

    until(is_sound)


@pytest.mark.full
def test_the_gripper_is_another_controller_and_is_found_by_its_joint(agent, witness) -> None:
    moved = agent.call("ros2_joint_move", joints={"gripper_joint": -0.015}, relative=True, tolerance=0.002)
    assert (moved["outcome"], moved["controller"]) == ("reached", "/gripper_controller")
    assert row(moved, "gripper_joint")["unit"] == "m"
    assert witness.joints()["gripper_joint"] == pytest.approx(0.005, abs=0.003)
    agent.call("ros2_joint_move", joints={"gripper_joint": 0.02}, tolerance=0.002)


@pytest.mark.promise("ros2_joint_move", "Targets are checked against the URDF's limits of position and speed")
@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ({"joints": {"elbow_joint": 2.7}}, "beyond its limits. The URDF allows -2.6 to 2.6 rad"),
        ({"joints": {"elbow_joint": 2.0}, "relative": True}, "beyond its limits"),
        ({"joints": {"elbow": 1.0}}, "Did you mean elbow_joint?"),
        ({"joints": {"right_finger_joint": 0.01}}, "follows gripper_joint"),
        ({"joints": {"camera_joint": 0.01}}, "is fixed"),
        ({"joints": {"elbow_joint": -1.2}, "duration_s": 0.5}, "Give at least 2.4"),
        ({"joints": {"elbow_joint": 1.0, "gripper_joint": 0.01}}, "No controller has all of"),
        ({"joints": {"elbow_joint": 1.0}, "controller": "/arm_controler"}, "Did you mean /arm_controller?"),
        ({"joints": {}}, "No joints are given"),
        ({"joints": {"elbow_joint": 1.0}, "speed": 1.5}, "speed"),
    ],
)
def test_what_is_beyond_the_limits_or_not_there_is_refused_and_nothing_moves(agent, witness, arguments, why) -> None:
    before = witness.joints()
    assert why in agent.refusal("ros2_joint_move", **arguments)
    after = witness.joints()
    assert all(after[name] == pytest.approx(at, abs=0.001) for name, at in before.items())


@pytest.mark.parametrize("way", [ACTION, TOPIC])
def test_a_stop_in_the_middle_of_a_joint_move_holds_the_joints_and_its_call_says_so(agent, witness, way: str) -> None:
    moving = agent.begin("ros2_joint_move", joints={PAN: far()[PAN]}, duration_s=TAKES_S, controller=way)
    before = witness.until_moving()
    stopped = agent.call("ros2_stop")
    moved = moving.result(30)
    held(witness, before)
    assert moved["outcome"] == "interrupted"
    assert "ros2_stop" in moved["note"]
    assert "Ended: motion" in stopped["note"] or stopped["goals"], stopped["note"]


def test_a_call_that_is_cancelled_holds_the_joints(agent, witness) -> None:
    moving = agent.begin("ros2_joint_move", joints={PAN: far()[PAN]}, duration_s=TAKES_S, controller=TOPIC)
    before = witness.until_moving()
    moving.cancel()
    held(witness, before, brakes=0.4)


def test_joint_states_that_fall_silent_end_the_move(agent, witness) -> None:
    moving = agent.begin("ros2_joint_move", joints={PAN: far()[PAN]}, duration_s=max(6.0, TAKES_S))
    witness.until_moving()
    agent.call("ros2_parameter_set", node_name="/joint_state_broadcaster", values={"enabled": False})
    try:
        moved = moving.result(30)
    finally:
        agent.call("ros2_parameter_set", node_name="/joint_state_broadcaster", values={"enabled": True})
    assert moved["outcome"] == "silent"
    assert f"No joint state was received for {'1.' if FULL else ''}" in moved["note"]
    assert witness.until_still()[PAN] < far()[PAN] - 0.3


def test_a_joint_that_is_stuck_is_named(agent) -> None:
    agent.call("ros2_parameter_set", node_name="/arm_controller", values={"stuck_joint": "elbow_joint"})
    try:
        moved = agent.call("ros2_joint_move", joints={"elbow_joint": 1.4, "wrist_1_joint": 0.5}, speed=0.8)
    finally:
        agent.call("ros2_parameter_set", node_name="/arm_controller", values={"stuck_joint": ""})
    assert moved["outcome"] == "aborted"
    assert "a goal tolerance was violated" in moved["note"]
    away = re.search(r"elbow_joint has not moved and is (\d\.\d+) rad from its target", moved["note"])
    assert away and float(away[1]) == pytest.approx(0.2, abs=0.051), moved["note"]  # as near as `_at_home` brings it


@pytest.mark.full
def test_a_second_move_of_the_same_controller_is_refused_meanwhile(agent, witness) -> None:
    moving = agent.begin("ros2_joint_move", joints={"shoulder_pan_joint": 0.6}, duration_s=2)
    witness.until_moving()
    assert "moves /arm_controller already" in agent.refusal("ros2_joint_move", joints={"elbow_joint": 1.0})
    assert moving.result(30)["outcome"] == "reached"


def held(witness, before: dict[str, float], brakes: float = BRAKES) -> None:
    """The shoulder stands far from its goal; it was still being moved before. In full, near where it was."""
    after = witness.until_still()
    assert before[PAN] - 0.05 < after[PAN] < far()[PAN] - 0.3
    if FULL:
        assert after[PAN] < before[PAN] + brakes


@pytest.mark.full
def test_a_stop_in_the_middle_of_a_goal_cancels_it_and_the_controller_holds(agent, witness) -> None:
    goal = agent.call(
        "ros2_send_action_goal", action_name=ACTION, goal_fields={"trajectory": trajectory(far(), TAKES_S)}
    )
    assert goal["accepted"]
    before = witness.until_moving()
    stopped = agent.call("ros2_stop")
    held(witness, before)
    (ended,) = stopped["goals"]  # a hold on the topic, where a test before has used it, may be first: that aborts it
    assert ended["confirmed"] and ended["status"] in ("CANCELED", "ABORTED")


@pytest.mark.promise("stopping", "joints are held where they are measured to be")
@pytest.mark.promise("stopping", "odometry (at most four topics) and joint states (at most eight)")
def test_a_stop_in_the_middle_of_a_trajectory_on_a_topic_holds_the_joints_where_they_are(agent, witness) -> None:
    sent = agent.call("ros2_topic_publish", topic_name=TOPIC, data=trajectory(far(), TAKES_S))
    assert sent["subscribers"] == 1
    assert "holds the joints" in sent["note"]
    before = witness.until_moving()
    stopped = agent.call("ros2_stop")
    held(witness, before)
    assert [topic["topic_name"] for topic in stopped["topics"]] == [TOPIC]
    # Who is held up for longer than a stop waits for it acknowledges the next one.
    until(lambda: stopped["topics"][0]["acknowledged"] or agent.call("ros2_stop")["topics"][0]["acknowledged"])
    assert "/joint_states reports that" in stopped["note"]  # how fast it braked is the machine's affair
    assert stopped["confirmed"] or "NOT observed still" in stopped["note"], stopped["note"]


def test_joint_states_of_the_agent_itself_are_no_measurement_and_are_refused_while_they_could_move_the_hold(
    agent, witness
) -> None:
    forged = {"topic_name": "/joint_states", "data": {"name": [PAN], "position": [-1.5]}}
    agent.call("ros2_topic_publish", **forged)
    before = witness.joints()[PAN]
    sent = agent.call("ros2_topic_publish", topic_name=TOPIC, data=trajectory(far(), TAKES_S))
    assert "holds the joints" in sent["note"]  # it has waited until the forged position was stale
    assert abs(witness.joints()[PAN] - before) < 0.5
    before = witness.until_moving()
    with pytest.raises(Refusal, match=PAN):
        agent.call("ros2_topic_publish", **forged)
    agent.call("ros2_stop")
    held(witness, before)
    witness.until_still()
    until(lambda: not agent.whole("ros2_topic_publish", forged).is_error)  # as soon as nothing of it moves any more


@pytest.fixture
def begin() -> Iterator[Callable[[RawServer, str], None]]:
    """Begins a move of the shoulder to the far side. Asked for before `start_server`, it waits after the test until
    all that this server had started is gone: a stopper holds the joints for seconds, and would in the next test, too.
    """
    begun: list[int] = []

    def move(server: RawServer, way: str, takes_s: float = TAKES_S) -> None:
        goal: dict[str, Any] = {"action_name": ACTION, "goal_fields": {"trajectory": trajectory(far(), takes_s)}}
        if way == "goal":
            answer = server.call("ros2_send_action_goal", **goal)
        else:
            answer = server.call("ros2_topic_publish", topic_name=TOPIC, data=trajectory(far(), takes_s))
        assert not answer["isError"], answer
        begun.extend([server.process.pid, *children(server.process.pid)])

    yield move
    until(lambda: not any(map(lives, begun)))


@pytest.mark.parametrize("way", ["topic", pytest.param("goal", marks=pytest.mark.full)])
def test_a_server_that_is_killed_in_the_middle_leaves_joints_that_are_held(
    begin: Callable[[RawServer, str], None], start_server: Callable[[], RawServer], witness, way: str
) -> None:
    server = start_server()
    begin(server, way)
    before = witness.until_moving()
    os.kill(server.process.pid, signal.SIGKILL)
    held(witness, before)


@pytest.mark.parametrize(
    "with_server", [pytest.param(False, marks=pytest.mark.full), True], ids=["the bridge", "bridge and server"]
)
def test_a_bridge_that_is_killed_in_the_middle_leaves_joints_that_are_held(
    begin: Callable[[RawServer, str], None], start_server: Callable[[], RawServer], witness, with_server: bool
) -> None:
    server = start_server()
    begin(server, "topic")
    before = witness.until_moving()
    bridge = next(pid for pid in children(server.process.pid))
    for pid in [bridge, *([server.process.pid] if with_server else [])]:
        os.kill(pid, signal.SIGKILL)
    held(witness, before)


@pytest.mark.promise("stopping", "the stopper cancels the goals")
@pytest.mark.parametrize("_", range(20 if FULL else 1))
def test_a_goal_whose_bridge_and_server_are_killed_together_is_cancelled(
    begin: Callable[..., None], start_server, witness, _: int
) -> None:
    server = start_server()
    begin(server, "goal", takes_s=12.0)  # its stopper has just begun, which takes seconds on a busy machine
    before = witness.until_moving()
    for pid in [children(server.process.pid)[0], server.process.pid]:
        os.kill(pid, signal.SIGKILL)
    after = witness.until_still()
    print(f"{after[PAN] - before[PAN]:.3f} rad further, at 0.2 rad/s")
    assert before[PAN] - 0.05 < after[PAN] < far()[PAN] - 0.3


@pytest.mark.full
def test_a_goal_whose_bridge_alone_is_killed_goes_on(
    begin: Callable[[RawServer, str], None], start_server, witness
) -> None:
    server = start_server()
    begin(server, "goal")
    witness.until_moving()
    os.kill(children(server.process.pid)[0], signal.SIGKILL)
    assert witness.until_still()[PAN] == pytest.approx(far()[PAN], abs=0.02)


@pytest.mark.full
def test_what_stands_is_not_held_again_when_the_client_leaves(start_server, agent, witness) -> None:
    """Somebody else may be moving the arm by then."""
    server = start_server()
    answer = server.call("ros2_topic_publish", topic_name=TOPIC, data=trajectory({**HOME, PAN: 0.05}, 0.5))
    assert not answer["isError"], answer
    witness.peer.wait(lambda: abs(witness.joints()[PAN] - 0.05) < 0.01)
    witness.until_still()
    agent.call("ros2_topic_publish", topic_name=TOPIC, data=trajectory(far(), 2.5))
    witness.until_moving()
    server.end()
    witness.peer.wait(lambda: abs(witness.joints()[PAN] - far()[PAN]) < 0.01)


def test_a_trajectory_that_is_not_finite_is_not_sent(agent) -> None:
    data = trajectory({**HOME, PAN: "nan"}, 1.0)
    refusal = agent.refusal("ros2_topic_publish", topic_name=TOPIC, data=data)
    assert "points[0].positions[0]" in refusal


POLICY = """
policy: 1
name: cell
allow:
  - {publish: /**, types: ["**"]}
  - {goal: /**, types: ["**"]}
  - cancel: /**
limits:
  topic: {types: [trajectory_msgs/msg/JointTrajectory], each: {"points[].positions[]": [-1.5, 1.5]}}
  action: {types: [control_msgs/action/FollowJointTrajectory], each: {"trajectory.points[].positions[]": [-1.5, 1.5]}}
"""


@pytest.mark.full
@pytest.mark.parametrize("way", [TOPIC, ACTION])
def test_policy_lease_and_latch_hold_over_a_joint_move(
    ros_environment: dict[str, str], arm, witness, tmp_path: Path, way: str
) -> None:
    tmp_path.chmod(0o700)
    file = tmp_path / "policy.yaml"
    file.write_text(POLICY, encoding="utf-8")
    file.chmod(0o600)
    # A state folder of its own: under a policy one server acts on a robot, and that of the other tests does, too.
    environment = {**ros_environment, "XDG_STATE_HOME": str(tmp_path)}
    server = Driver(environment, "--tools", "all", "--policy", str(file))
    latch = StateFolder.of(domain_id=int(ros_environment["ROS_DOMAIN_ID"]), env=environment).latch()
    try:
        server.knows(TOPIC, 1)

        def begin_move(to: float) -> int:
            return server.tool("ros2_joint_move", joints={PAN: to}, duration_s=4, controller=way)

        with pytest.raises(Refusal, match=r"1\.5"):
            server.result(begin_move(1.6))
        moving = begin_move(1.4)
        before = witness.until_moving()
        server.process.send_signal(signal.SIGSTOP)
        assert witness.until_still()[PAN] < before[PAN] + 1.1 * 0.6 + BRAKES  # the lease is 1 s, and 0.1 s
        server.process.send_signal(signal.SIGCONT)
        ended = server.result(moving)
        assert ended["outcome"] == "interrupted"
        assert "link lease" in ended["note"]
        moving = begin_move(-0.6)
        before = witness.until_moving()
        latch.set(by="operator", reason="somebody is in the cell")
        assert witness.until_still()[PAN] > before[PAN] - 0.6 * 0.6 - BRAKES  # it is looked at every 0.25 s
        ended = server.result(moving)
        assert ended["outcome"] == "interrupted"
        assert "somebody is in the cell" in ended["note"]
        with pytest.raises(Refusal, match="the latch of this robot is set"):
            server.result(begin_move(0.0))
    finally:
        latch.reset(by="operator", seen=latch.look().count)
        server.end()
