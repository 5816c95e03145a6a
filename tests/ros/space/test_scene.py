"""What an agent sees around the simulated rover, live: the scene, and what its scanner and depth camera mean."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from ros2_mcp_demo.base import RADIUS
from support.agent import Agent, agent_for, until
from support.demo_robot import Peer, build_interfaces, robot_environment, running_robot

PILLAR = (1.67, -32.0)
"""Distance (m) and bearing (degrees) of the red pillar from where the rover starts."""


@pytest.fixture(scope="module")
def agent(domain_id: int, ros_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server, and the rover with its transforms."""
    prefixes = build_interfaces()
    environment = {**ros_environment, **robot_environment(prefixes, ROS_DOMAIN_ID=str(domain_id))}
    with running_robot(prefixes, domain_id, "--seed", "7"), agent_for(environment, "--tools", "all") as client:
        client.knows("/scan", "/map", "/tf", "/tf_static", "/robot_description", "/camera/depth/image_raw")
        yield client


def complete(agent: Agent, *kinds: str, **arguments: Any) -> dict[str, Any]:
    """The scene, as soon as it has these layers and the robot: publishers may be discovered late."""

    def whole() -> dict[str, Any] | None:
        found = agent.call("ros2_scene", **arguments)
        shown = {layer["kind"] for layer in found["layers"]}
        return found if set(kinds) <= shown and found["robot_x_m"] is not None else None

    return until(whole)


def test_the_scene_of_a_live_robot_has_map_scan_outline_and_pose(agent: Agent) -> None:
    found = complete(agent, "grid", "scan", "footprint")
    assert found["frame_id"] == "map"
    assert (found["robot_x_m"], found["robot_y_m"]) == pytest.approx((0, 0), abs=0.1)
    assert found["robot_age_s"] is not None and found["seconds_from_start"] is None
    assert found["x_min_m"] < -2 and found["x_max_m"] > 6
    scan = found["meaning"]["scan"]
    assert (scan["nearest_m"], scan["nearest_bearing_deg"]) == pytest.approx(PILLAR, abs=5), scan
    [picture] = found["pictures"]
    assert picture["mime"] == "image/png" and max(picture["width"], picture["height"]) <= 1568


def test_a_scan_that_is_read_says_what_is_near_from_the_base(agent: Agent) -> None:
    def in_base() -> dict[str, Any] | None:
        scan = agent.call("ros2_topic_echo_wait", topic_name="/scan")["meaning"]["scan"]
        return scan if scan["is_base"] else None

    scan = until(in_base)
    assert scan["seen_from"] == "base_link"
    assert scan["nearest_m"] == pytest.approx(PILLAR[0], abs=0.1)  # noise of 1 cm in a beam
    assert scan["nearest_bearing_deg"] == pytest.approx(PILLAR[1], abs=6)
    assert scan["free_m"]["rear"] == pytest.approx(2.0, abs=0.1)


def test_a_depth_image_says_where_the_ground_is_and_what_stands_on_it(agent: Agent) -> None:
    def placed() -> dict[str, Any] | None:
        found = agent.call("ros2_topic_subscribe", topic_name="/camera/depth/image_raw")
        depth = found.get("meaning", {}).get("depth")
        return depth if depth and depth["ground_z_m"] is not None else None

    depth = until(placed)
    assert depth["is_base"] and depth["ground_z_m"] == pytest.approx(0.0, abs=0.03)
    assert depth["nearest_m"] > 1.0 + RADIUS


def test_a_robot_drawn_in_its_own_frame_is_at_its_origin(agent: Agent) -> None:
    found = complete(agent, "scan", frame="base_link", radius_m=3)
    assert (found["robot_x_m"], found["robot_y_m"], found["robot_yaw_deg"]) == pytest.approx((0, 0, 0), abs=1e-6)


def test_a_scan_is_of_the_pose_that_is_shown_although_a_silent_path_is_awaited(agent: Agent) -> None:
    """A path is awaited for 1.2 s; a scan that was read before would be older, and what it means of another heading."""

    def fresh() -> bool:
        found = agent.call("ros2_scene")
        assert any(line.startswith("The path ") for line in found["missing"]), found["missing"]
        return any(layer["kind"] == "scan" and (layer["age_s"] or 9.0) < 0.8 for layer in found["layers"])

    until(fresh)


def test_a_path_that_is_silent_is_awaited_at_the_first_question_alone(agent: Agent) -> None:
    """From then on it is heard, and what did not come need not be awaited again."""

    def told() -> str:
        found = agent.call("ros2_scene")
        return next((line for line in found["missing"] if line.startswith("The path /plan")), "")

    assert told()  # of the first question, which listens from then on
    until(lambda: told().endswith("is not shown: Nothing was sent so far."))


LOCAL = "/local_costmap/costmap"
CELLS, CELL_M = 30, 0.1
"""Of a window that rolls with the robot, as Nav2's local costmap does, in the frame of the odometry."""
OCCUPIED, MAGENTA = 100, (255, 0, 255)


def magenta_at(agent: Agent) -> tuple[float, float] | None:
    """The least and the greatest x of what the picture of that costmap has in the colour of obstacles, in m."""
    result = agent.whole("ros2_scene", {"grid": LOCAL, "frame": "odom"})
    facts, [picture] = result.structured_content or {}, [part for part in result.content if part.type == "image"]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.data))).convert("RGB")).astype(int)
    columns = np.nonzero((np.abs(pixels - MAGENTA).max(axis=2) < 40).sum(axis=0) > 50)[0]
    if facts["frame_id"] != "odom" or not len(columns):
        return None
    x_m = facts["x_min_m"] + (columns - facts["left_px"]) * facts["metres_per_pixel"]
    return float(x_m.min()), float(x_m.max())


def test_a_local_costmap_that_rolls_is_shown_in_the_odometry_frame(domain_id: int, agent: Agent) -> None:
    from nav_msgs.msg import OccupancyGrid
    from rclpy.qos import DurabilityPolicy, QoSProfile

    peer = Peer(domain_id)
    try:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = peer.node.create_publisher(OccupancyGrid, LOCAL, latched)
        for corner_m in (-1.5, -0.5):  # it rolls on before anybody looks
            grid = OccupancyGrid()
            grid.header.frame_id, grid.header.stamp = "odom", peer.node.get_clock().now().to_msg()
            grid.info.width = grid.info.height = CELLS
            grid.info.resolution = CELL_M
            grid.info.origin.position.x = grid.info.origin.position.y = corner_m
            grid.data = [OCCUPIED if cell % CELLS == CELLS - 1 else 0 for cell in range(CELLS * CELLS)]
            publisher.publish(grid)
        agent.knows(LOCAL)
        wall_m = -0.5 + CELLS * CELL_M
        until(lambda: magenta_at(agent) == pytest.approx((wall_m - CELL_M, wall_m), abs=0.03))
    finally:
        peer.close()
