"""The simulated robot in its own process, seen by an ordinary ROS 2 node.

The tests share a robot and come in their order: those that look first, then those that drive it from where it is.
"""

import math
from itertools import cycle

import pytest

from support.standstill import undisturbed

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

EXPECTED_TOPICS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/imu": "sensor_msgs/msg/Imu",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/battery_state": "sensor_msgs/msg/BatteryState",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/camera/image_raw": "sensor_msgs/msg/Image",
    "/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image",
    "/cmd_vel": "geometry_msgs/msg/Twist",
}


SLOW_ECHO = "ros2_mcp_demo_interfaces/srv/SlowEcho"


def stamp_ns(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def test_the_graph_shows_all_topics_with_their_types(peer):
    def complete():
        seen = {name: types[0] for name, types in peer.node.get_topic_names_and_types()}
        return EXPECTED_TOPICS.items() <= seen.items()

    peer.wait(complete)


def test_latched_messages_and_true_ranges_reach_a_late_subscriber(peer):
    grid = peer.next("/map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    assert (grid.info.width, grid.info.height, len(grid.data)) == (164, 124, 164 * 124)
    mounts = peer.next("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED).transforms
    assert {mount.child_frame_id for mount in mounts} >= {"laser", "imu_link", "camera_optical"}
    scan = peer.next("/scan", "sensor_msgs/msg/LaserScan", qos_profile_sensor_data)
    near = [r for r in scan.ranges[175:186] if math.isfinite(r)]
    assert sum(near) / len(near) == pytest.approx(2.45, abs=0.03)
    assert scan.header.frame_id == "laser"
    assert any(math.isinf(r) for r in scan.ranges)


def test_a_parameter_changes_what_it_says_at_once_and_nonsense_is_refused(peer):
    scans = peer.subscribe("/scan", "sensor_msgs/msg/LaserScan", qos_profile_sensor_data)
    peer.wait(lambda: scans)
    assert peer.set_parameter("lidar", "enabled", False).successful
    told_at = peer.node.get_clock().now().nanoseconds
    odometry = peer.subscribe("/odom", "nav_msgs/msg/Odometry")
    peer.wait(lambda: odometry and stamp_ns(odometry[-1]) > told_at + 500_000_000)
    assert max(map(stamp_ns, scans)) <= told_at
    too_fast = peer.set_parameter("base_controller", "max_linear_speed", 2.0)
    assert (too_fast.successful, "range" in too_fast.reason) == (False, True)
    fixed = peer.set_parameter("base_controller", "serial_number", "other")
    assert (fixed.successful, "read-only" in fixed.reason) == (False, True)
    assert peer.set_parameter("lidar", "enabled", True).successful


def test_services_answer_and_a_slow_one_delays_nothing(peer):
    echo_for(peer, 30.0)
    set_mode = "ros2_mcp_demo_interfaces/srv/SetMode"
    refused = peer.call("set_mode", set_mode, mode="dance")
    assert (refused.success, refused.previous_mode) == (False, "manual")
    assert "idle, manual, autonomous" in refused.message
    assert not peer.call("self_test", "std_srvs/srv/Trigger").success
    assert peer.call("enable_motors", "std_srvs/srv/SetBool", data=False).success
    assert peer.call("enable_motors", "std_srvs/srv/SetBool", data=True).success
    told = peer.call("slow_echo", SLOW_ECHO, text="hello", delay=0.3)  # all before the first, which takes 30 s
    assert told.text == "hello" and told.elapsed >= 0.3


@pytest.mark.full
def test_a_slow_service_takes_as_long_as_it_is_asked_to(peer):
    def asked():
        answer = echo_for(peer, 1.5)
        peer.wait(answer.done)
        return answer.result()

    slow = undisturbed(asked)
    assert (slow.text, slow.elapsed) == ("hello", pytest.approx(1.5, abs=0.2))


def echo_for(peer, delay):
    """The answer of a service that takes so long."""
    peer.client("slow_echo", SLOW_ECHO)
    return peer.ask("slow_echo", SLOW_ECHO, text="hello", delay=delay)


def test_the_gripper_publishes_only_while_its_lifecycle_node_is_active(peer):
    from lifecycle_msgs.msg import Transition

    def change(transition):
        wanted = Transition(id=transition)
        return peer.call("/gripper_driver/change_state", "lifecycle_msgs/srv/ChangeState", transition=wanted).success

    assert change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    states = peer.subscribe("/gripper/joint_states", "sensor_msgs/msg/JointState")
    assert not change(Transition.TRANSITION_ACTIVATE)
    assert change(Transition.TRANSITION_CONFIGURE)
    configured_at = peer.node.get_clock().now().nanoseconds
    odometry = peer.subscribe("/odom", "nav_msgs/msg/Odometry")
    peer.wait(lambda: odometry and stamp_ns(odometry[-1]) > configured_at + 500_000_000)
    activated_at = peer.node.get_clock().now().nanoseconds
    assert change(Transition.TRANSITION_ACTIVATE)
    peer.wait(lambda: states)
    assert min(map(stamp_ns, states)) >= activated_at
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_ACTIVATE)


def test_an_obstacle_put_down_is_seen_by_laser_and_camera(peer):
    before = peer.next("/camera/image_raw", "sensor_msgs/msg/Image")
    spawn = "ros2_mcp_demo_interfaces/srv/SpawnObstacle"
    assert peer.call("spawn_obstacle", spawn, name="crate", x=1.0, y=0.0, radius=0.25).success
    scans = peer.subscribe("/scan", "sensor_msgs/msg/LaserScan", qos_profile_sensor_data)
    peer.wait(lambda: scans and scans[-1].ranges[180] == pytest.approx(0.75, abs=0.05))
    after = peer.next("/camera/image_raw", "sensor_msgs/msg/Image")
    middle = 120 * after.step + 160 * 3
    assert bytes(before.data[middle : middle + 3]) != bytes(after.data[middle : middle + 3])
    assert after.data[middle] > 1.5 * after.data[middle + 2]


def test_it_drives_when_it_is_told_and_stops_when_commands_end(peer):
    assert driven(peer, 0.3) > 0.1


@pytest.mark.full
def test_it_drives_as_far_as_it_is_told(peer):
    # 2 s of commands and 0.5 s of time-out, less what speeding up costs, and braking from there.
    way = pytest.approx(0.3 * 2.5 - 0.3**2 / 2 / 1.0 + 0.3**2 / 2 / 2.0, rel=0.15)
    there_and_back = cycle((0.3, -0.3))
    assert abs(undisturbed(lambda: driven(peer, next(there_and_back)))) == way


def driven(peer, speed):
    """How far it drives along x until it stands, that is commanded for 2 s."""
    odometry = peer.subscribe("/odom", "nav_msgs/msg/Odometry")
    peer.wait(lambda: odometry)
    start = odometry[-1].pose.pose.position.x
    peer.drive(speed, 0.0, 2.0)
    peer.wait(lambda: odometry[-1].twist.twist.linear.x == 0.0)
    return odometry[-1].pose.pose.position.x - start


def test_a_wall_blocks_the_base_and_diagnostics_say_so(peer):
    diagnostics = peer.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")

    def warnings():
        return [status for array in diagnostics for status in array.status if status.level == b"\x01"]

    peer.drive(-0.5, 0.0, 60.0, until=warnings)
    assert "base blocked" in warnings()[0].message


def test_navigation_reaches_the_other_room_through_the_doorway(peer, goals):
    answer = goals.result(goals.send(2.9, 1.0, yaw=0.0, use_yaw=True), 100.0)
    assert (answer.status, answer.result.reached) == (4, True)
    assert math.dist((answer.result.final_x, answer.result.final_y), (2.9, 1.0)) < 0.2
    assert len(goals.feedback) > 10
    assert all(0.8 < f.y < 1.8 for f in goals.feedback if abs(f.x - 2.5) < 0.1)
    pose = peer.next("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped").pose.pose
    assert (pose.position.x, pose.orientation.z) == pytest.approx((2.9, 0.0), abs=0.2)


def test_a_canceled_goal_brakes_and_a_new_goal_replaces_the_old(peer, goals):
    first = goals.send(3.3, 1.3)
    second = goals.send(-1.5, 0.0)
    replaced = goals.result(first)
    assert (replaced.status, replaced.result.reason) == (6, "replaced by a new goal")
    peer.wait(lambda: any(f.state == "driving" for f in goals.feedback[-3:]))
    canceling = second.cancel_goal_async()
    peer.wait(canceling.done)
    assert len(canceling.result().goals_canceling) == 1
    assert goals.result(second).status == 5
    odometry = peer.next("/odom", "nav_msgs/msg/Odometry")
    assert abs(odometry.twist.twist.linear.x) < 0.01


def test_goals_that_cannot_be_are_rejected_or_aborted_with_a_reason(peer, goals):
    assert not goals.send(50.0, 0.0).accepted
    assert not goals.send(math.nan, 0.0).accepted
    inside_a_wall = goals.result(goals.send(2.5, 0.0))
    assert (inside_a_wall.status, "no free way" in inside_a_wall.result.reason) == (6, True)
    driving = goals.send(-1.5, -1.0)  # far enough that it does not arrive
    assert peer.call("enable_motors", "std_srvs/srv/SetBool", data=False).success
    stopped = goals.result(driving)
    assert (stopped.status, stopped.result.reason) == (6, "motors are disabled")


def test_without_interface_packages_it_says_what_it_leaves_out_and_ends_with_its_input(start_robot, domain_id):
    with start_robot([], domain_id, "--until-stdin-closes", "--namespace", "r2") as process:
        assert "/navigate_to (no ros2_mcp_demo_interfaces)" in process.ready_line
        process.stdin.close()
        assert process.wait(40) == 0
