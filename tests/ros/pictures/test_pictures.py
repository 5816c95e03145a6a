"""What an agent sees of the simulated robot while it drives, of its map, and of a room in a point cloud."""

from __future__ import annotations

import base64
import io
import os
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from support.agent import Agent, until

EDGE = timedelta(milliseconds=1)


def seen(agent: Agent, tool: str, **arguments: Any) -> tuple[dict[str, Any], np.ndarray]:
    """The result with its picture's pixels; kept in a folder to look at where ROS2_MCP_PICTURES names one."""
    result = agent.whole(tool, arguments)
    assert not result.is_error, result.content[0]
    assert result.structured_content is not None
    (data,) = (base64.b64decode(part.data) for part in result.content if part.type == "image")
    assert len(data) <= 700_000
    folder = os.environ.get("ROS2_MCP_PICTURES")
    if folder:
        Path(folder, f"{tool}_{arguments.get('kind') or arguments.get('color_mode') or ''}.png").write_bytes(data)
    image = Image.open(io.BytesIO(data))
    assert image.format == "PNG" and max(image.size) <= 1568
    return result.structured_content, np.asarray(image.convert("RGB")).astype(int)


def ground(found: dict[str, Any], pixels: np.ndarray) -> np.ndarray:
    """The pixels inside the axes."""
    if "resolution_m" in found and "width" in found:
        extent = found["height"] * found["resolution_m"], found["width"] * found["resolution_m"]
    else:
        extent = found["y_max_m"] - found["y_min_m"], found["x_max_m"] - found["x_min_m"]
    rows, columns = (round(metres / found["metres_per_pixel"]) for metres in extent)
    return pixels[found["top_px"] :, found["left_px"] :][:rows, :columns]


def drive(agent: Agent, duration: float) -> Any:
    command = {"linear": {"x": 0.3}, "angular": {"z": 0.8}}
    return agent.begin("ros2_topic_publish", topic_name="/cmd_vel", data=command, frequency=10, duration=duration)


def moves_at(agent: Agent) -> float:
    [message] = agent.call("ros2_topic_subscribe", topic_name="/odom", fields=["twist.twist.linear.x"])["messages"]
    return abs(message["twist.twist.linear.x"])


def blue(pixels: np.ndarray) -> np.ndarray:
    """Rows and columns of the first curve's pixels and of its sample in the legend."""
    return np.argwhere(np.abs(pixels - (0x1F, 0x6F, 0xC4)).sum(axis=2) < 12)


@pytest.mark.promise("ros2_plot", "Draw numeric fields over time")
def test_the_speed_is_seen_to_rise_while_the_robot_drives(agent: Agent) -> None:
    series = ["/odom:twist.twist.linear.x", "/odom:twist.twist.angular.z"]

    before = agent.call("ros2_status")["subscriptions"]
    plotting = ThreadPoolExecutor(1).submit(
        seen, agent, "ros2_plot", series=series, duration_s=8
    )  # 4 s until it drives
    until(lambda: agent.call("ros2_status")["subscriptions"] > before)
    driving = drive(agent, 30.0)
    found, pixels = plotting.result(60)
    driving.cancel()
    until(lambda: moves_at(agent) < 0.01)
    speed, turning = found["series"]
    assert (speed["unit"], turning["unit"]) == ("m/s", "rad/s")
    assert speed["max"] == pytest.approx(0.3, abs=0.1)
    assert speed["count"] > 20
    places = blue(pixels)
    assert np.ptp(places[:, 0]) > 60  # it changes
    assert np.ptp(places[:, 1]) > 600  # and fills the time


@pytest.mark.promise("ros2_plot", "or trajectories, as a picture")
def test_a_trajectory_is_as_large_as_the_way_driven(agent: Agent) -> None:
    driving = drive(agent, 30.0)
    until(lambda: moves_at(agent) > 0.2)
    found, pixels = seen(agent, "ros2_plot", series=["/odom:pose.pose.position"], duration_s=4, kind="xy")
    driving.cancel()
    until(lambda: moves_at(agent) < 0.01)
    x, y = found["series"]
    assert (x["name"], y["name"]) == ("/odom:pose.pose.position.x", "/odom:pose.pose.position.y")
    assert max(x["max"] - x["min"], y["max"] - y["min"]) > 0.2
    assert len(blue(pixels)) > 500


@pytest.mark.promise("README", "The past answers in the same words as the present")
def test_a_recording_shows_what_was_seen_live(agent: Agent) -> None:
    begun = agent.call("ros2_record_start", topic_names=["/odom", "/map", "/cloud"], name="run")
    until(lambda: {"/odom", "/map", "/cloud"} <= recorded_topics(agent, begun["recording_id"]))
    live, _ = seen(agent, "ros2_plot", series=["/odom:pose.pose.position.x"], duration_s=1.5)
    agent.call("ros2_record_stop", recording_id=begun["recording_id"])
    begin = datetime.fromisoformat(live["started_at"].replace("Z", "+00:00"))
    end = begin + timedelta(seconds=live["duration"])

    def is_same(earlier: timedelta, later: timedelta) -> bool:
        time_of_it = {"start": (begin - earlier).isoformat(), "end": (end + later).isoformat()}
        again, _ = seen(agent, "ros2_plot", series=["/odom:pose.pose.position.x"], bag="run", **time_of_it)
        assert again["source"].startswith("bag run")
        return again["series"] == live["series"]

    assert live["series"][0]["count"] > 10
    # Two subscriptions receive the same message at times that differ a little: at an edge one may have it alone.
    assert any(is_same(*shifts) for shifts in product((timedelta(), EDGE, -EDGE), repeat=2))
    shown_now, pixels = seen(agent, "ros2_get_map_as_image", topic_name="/map")
    shown_then, recorded_pixels = seen(agent, "ros2_get_map_as_image", topic_name="/map", bag="run")
    # The robot is not in the recording; its arrow of 13 pixels ends at most a pixel's diagonal farther from its place.
    now, then = ground(shown_now, pixels), ground(shown_then, recorded_pixels)
    metres, rows = shown_now["metres_per_pixel"], np.arange(len(now))[:, None]
    across = np.arange(now.shape[1]) - (shown_now["robot_x_m"] - shown_now["origin_x_m"]) / metres
    along = len(now) - rows - (shown_now["robot_y_m"] - shown_now["origin_y_m"]) / metres
    beside = np.hypot(across, along) > 13 + np.sqrt(2)
    assert not beside.all() and (now != then)[~beside].any() and not (now != then)[beside].any()
    assert shown_then["free"] == shown_now["free"] and shown_then["robot_x_m"] is None
    assert shown_then["note"].startswith("Recorded at 20") and shown_then["seconds_from_start"] >= 0
    assert seen(agent, "ros2_get_pointcloud_as_bev", topic_name="/cloud", bag="run")[0]["frame_id"] == "room"


def recorded_topics(agent: Agent, recording_id: str) -> set[str]:
    [run] = agent.call("ros2_record_status", recording_id=recording_id)["recordings"]
    return {topic["topic_name"] for topic in run["topics"] if topic["written"]}


@pytest.mark.promise("ros2_get_map_as_image", "axes in metres, origin and robot")
@pytest.mark.promise("ros2_get_map_as_image", "Show an occupancy grid as a picture")
@pytest.mark.promise("ros2_get_map_as_image", "resolution, size, shares of free, occupied and unknown")
def test_the_map_is_shown_with_its_facts(agent: Agent) -> None:
    found, pixels = seen(agent, "ros2_get_map_as_image", topic_name="/map")
    message = agent.call("ros2_topic_subscribe", topic_name="/map", fields=["info"])["messages"][0]
    info = message["info"]
    assert (found["width"], found["height"]) == (info["width"], info["height"])
    assert found["resolution_m"] == pytest.approx(info["resolution"])
    assert found["origin_x_m"] == pytest.approx(info["origin"]["position"]["x"])
    assert found["free"] + found["occupied"] + found["unknown"] == pytest.approx(1)
    assert (ground(found, pixels) == 0).all(axis=2).mean() == pytest.approx(found["occupied"], abs=0.05)
    pose = agent.call("ros2_topic_subscribe", topic_name="/pose")["messages"][0]["pose"]["pose"]["position"]
    assert (found["robot_x_m"], found["robot_y_m"]) == pytest.approx((pose["x"], pose["y"]), abs=0.2)
    row, column = np.argwhere((pixels == (255, 140, 0)).all(axis=2)).mean(axis=0)
    left = found["origin_x_m"] + (column - found["left_px"]) * found["metres_per_pixel"]
    assert left == pytest.approx(found["robot_x_m"], abs=0.3)
    assert row > found["top_px"]


@pytest.mark.promise("ros2_get_pointcloud_as_bev", "Show a point cloud from above")
@pytest.mark.promise("ros2_get_pointcloud_as_bev", "extent")
def test_a_room_is_seen_from_above(agent: Agent) -> None:
    found, pixels = seen(
        agent, "ros2_get_pointcloud_as_bev", topic_name="/cloud", resolution=0.1, color_mode="rgb", zmax=1.8
    )
    assert (found["frame_id"], found["not_finite"], found["color_mode"]) == ("room", 2, "rgb")
    assert [found[key] for key in ("x_min_m", "x_max_m", "y_min_m", "y_max_m")] == pytest.approx([-4, 4, -2, 2])
    assert found["z_max_m"] == pytest.approx(1.5)
    pixels = ground(found, pixels)
    red = np.argwhere((pixels[:, :, 0] > 200) & (pixels[:, :, 1] < 60) & (pixels != (0xE0, 0x20, 0x20)).any(axis=2))
    row, column = red.mean(axis=0)
    scale = found["metres_per_pixel"]
    assert (found["x_min_m"] + column * scale, found["y_max_m"] - row * scale) == pytest.approx((2.0, 0.5), abs=0.1)
    assert pixels[0, 0].tolist() == [0xE0] * 3


def test_intensity_is_shown_as_colours_with_their_scale(agent: Agent) -> None:
    found, pixels = seen(
        agent, "ros2_get_pointcloud_as_bev", topic_name="/cloud", resolution=0.1, color_mode="intensity"
    )
    assert (found["color_low"], found["color_high"]) == (10.0, 90.0)
    pixels = ground(found, pixels)
    corner, floor = pixels[0, 0], pixels[pixels.shape[0] // 2, pixels.shape[1] // 4]
    assert corner[0] > corner[2] and floor[2] > floor[0]


def test_other_topics_are_refused_by_name(agent: Agent) -> None:
    assert "/scan is a sensor_msgs/msg/LaserScan" in agent.refusal("ros2_get_map_as_image", topic_name="/scan")
    assert "/map is a nav_msgs" in agent.refusal("ros2_get_pointcloud_as_bev", topic_name="/map")
    refusal = agent.refusal("ros2_plot", series=["/odom:twist.twist.lineer.x"])
    assert "Did you mean linear?" in refusal
