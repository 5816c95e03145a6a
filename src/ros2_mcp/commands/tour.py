"""The one-minute tour: an MCP client over real stdio acts like an agent, and shows the answers."""

from __future__ import annotations

import asyncio
import json
import math
import os
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path

from mcp import Client, StdioServerParameters

from ros2_mcp.commands.prompted import PROMPTS
from ros2_mcp.commands.robots import DEFAULT
from ros2_mcp.commands.simulation import Graph, with_interfaces
from ros2_mcp.commands.tour_arm import ARM
from ros2_mcp.commands.tour_drone import DRONE
from ros2_mcp.commands.tour_nav2 import NAV2
from ros2_mcp.commands.tour_policy import PROFILE, SIGN, be_fooled
from ros2_mcp.commands.transcript import Tour
from ros2_mcp.settings import Settings

CHAPTERS: Mapping[str, Sequence[Callable[[Tour], Awaitable[None]]]] = {"drone": DRONE, "arm": ARM, "nav2": NAV2}
"""The chapters of each robot except the rover, whose chapters are in this module."""

_WITHIN_M = 0.02
"""The accuracy of `ros2_drive`, by odometry."""


async def take_tour(settings: Settings, graph: Graph, folder: Path, robot: str = DEFAULT) -> int:
    """Start the server over stdio, as a client would, and run the chapters of the robot. Save pictures and transcript
    in the folder. Return the exit code.
    """
    prefixes = with_interfaces(settings, robot).interface_prefixes
    variables = {
        **graph.variables(),
        "ROS2_MCP_INTERFACES": ":".join(map(str, prefixes)),
        # A latch that stays set here must not affect a real robot.
        "XDG_STATE_HOME": str(folder / "state"),
    }
    tour, is_over = Tour(folder), asyncio.Event()
    async with Client(_server(settings, folder, variables)) as tour.client:
        if robot in CHAPTERS:
            await tour.play(*CHAPTERS[robot])
            return tour.finish()
        await tour.play(look_around, drive_one_metre, use_services, navigate)
        # The second server starts while the first one records.
        guarded = asyncio.create_task(_under_policy(tour, settings, folder, variables, is_over))
        await tour.play(remember, _put_up_a_sign)
    is_over.set()
    await guarded
    return tour.finish()


async def _put_up_a_sign(tour: Tour) -> None:
    await tour.call("ros2_parameter_set", node_name="/camera", values={"sign": SIGN})


async def _under_policy(
    tour: Tour, settings: Settings, folder: Path, variables: Mapping[str, str], is_over: asyncio.Event
) -> None:
    """Run the last chapter with a second server. Under a policy only one server may act, so it waits until the first
    has ended.
    """
    async with Client(_server(settings, folder, variables, "--policy", PROFILE)) as client:
        await is_over.wait()
        tour.client = client
        await tour.play(lambda tour: be_fooled(tour, {**os.environ, **variables}))


def _server(settings: Settings, folder: Path, variables: Mapping[str, str], *more: str) -> StdioServerParameters:
    words = ["-m", "ros2_mcp", *_options(settings, folder), *more]
    return StdioServerParameters(command=sys.executable, args=words, env=dict(variables))


async def look_around(tour: Tour) -> None:
    """List the topics, and show what the sensors see."""
    tour.say("1. What is there?")
    topics = await tour.call("ros2_topic_list")
    for topic in topics["topics"]:
        tour.show(f"{topic['topic_name']:32} {topic['topic_type']}")
    tour.say("2. What do the sensors see?")
    scan = await tour.call("ros2_topic_echo_wait", topic_name="/scan", fields=["ranges", "range_max"])
    ranges = scan["message"]["ranges"]
    tour.show(f"the laser scanner sees {ranges['length']} ranges, the nearest at {ranges['min']:.2f} m")
    await tour.call("ros2_topic_subscribe", topic_name="/camera/image_raw")
    stats = await tour.call("ros2_topic_stats", topic_names=["/odom", "/scan", "/imu"], duration_s=2.0)
    for topic in stats["topics"]:
        tour.show(f"{topic['topic_name']:8} {topic['rate_hz']:6.2f} Hz, jitter {topic['jitter_s'] * 1000:.1f} ms")


async def drive_one_metre(tour: Tour) -> None:
    """Drive, stop, and verify it by odometry."""
    tour.say("3. Drive one metre, then stop.")
    before = await _position(tour)
    driven = await tour.call("ros2_drive", distance_m=1.0, speed=0.4)
    tour.show(f"{driven['outcome']}: {driven['measured']} m in {driven['elapsed_s']} s. {driven['note']}".rstrip())
    stopped = await tour.call("ros2_topic_subscribe", topic_name="/odom", duration=1.0, fields=["twist.twist.linear.x"])
    speed = stopped["messages"][-1]["twist.twist.linear.x"]
    after = await _position(tour)
    moved = math.dist(before, after)
    tour.verify(f"odometry says the robot moved {moved:.3f} m", abs(moved - 1.0) <= _WITHIN_M)
    tour.verify(f"the robot stands still ({speed:.3f} m/s)", abs(speed) < 0.02)
    await tour.call("ros2_topic_subscribe", topic_name="/camera/image_raw")


async def use_services(tour: Tour) -> None:
    """Call a service, and change the robot's behaviour by a parameter."""
    tour.say("4. Call a service, set a parameter.")
    reset = await tour.call("ros2_service_call", service_name="/reset_odometry", fields={})
    tour.show(f"/reset_odometry answered: {reset['result']}")
    await tour.call("ros2_parameter_set", node_name="/base_controller", values={"max_linear_speed": 0.1})
    await tour.call(
        "ros2_topic_publish", topic_name="/cmd_vel", data={"linear": {"x": 0.5}}, frequency=20.0, duration=2.0
    )
    slow = math.dist((0.0, 0.0), await _position(tour))
    tour.verify(f"with max_linear_speed 0.1 two seconds of 0.5 m/s moved it only {slow:.2f} m", 0.05 < slow < 0.3)
    await tour.call("ros2_parameter_set", node_name="/base_controller", values={"max_linear_speed": 0.5})


async def navigate(tour: Tour) -> None:
    """Send a goal that drives around walls, ask why one fails, and cancel another."""
    actions = {entry["name"] for entry in (await tour.call("ros2_list_actions"))["actions"]}
    if "/navigate_to" not in actions:
        tour.say("5. Navigation is left out: its interfaces could not be built here.")
        return
    tour.say("5. Navigate around walls, then cancel a second goal.")
    if "/navigate_to_pose" in actions:
        await _navigate_with_nav2(tour)
    else:  # its interfaces are still being built; the tour does not wait for them
        outcome = await tour.call(
            "ros2_send_action_goal",
            action_name="/navigate_to",
            goal_fields={"x": 2.0, "y": 1.0},
            wait_for_result=True,
            timeout_sec=40.0,
        )
        tour.show(f"{outcome['status']}: {json.dumps(outcome['result'])}")
        tour.verify("the goal was reached", outcome["status"] == "SUCCEEDED")
    goal = await tour.call("ros2_send_action_goal", action_name="/navigate_to", goal_fields={"x": 0.0, "y": 0.0})
    await tour.call("ros2_cancel_action_goal", action_name="/navigate_to", goal_id_hex=goal["goal_id"])
    ended = await tour.call(
        "ros2_action_request_result", action_name="/navigate_to", goal_id_hex=goal["goal_id"], timeout_sec=10.0
    )
    tour.verify(f"the second goal is {ended['status']}", ended["status"] == "CANCELED")


async def _navigate_with_nav2(tour: Tour) -> None:
    done = await tour.call("ros2_navigate", to=[{"x": 2.0, "y": 1.0}])
    (leg,) = done["legs"]
    tour.verify(f"the goal was reached in {leg['duration_s']} s, to {leg['away_m']} m", done["outcome"] == "reached")
    why = (await tour.call("ros2_navigate", to=[{"x": 2.5, "y": -1.0}]))["explanation"]
    tour.show(f"a goal in a wall: {why['cause']} {' '.join(why['helps'])}")
    tour.verify("the failure is explained", "is occupied" in why["cause"])


async def remember(tour: Tour) -> None:
    """Record, break something, and ask the recording what happened."""
    tour.say("6. Record, break the laser scanner, and ask what happened.")
    topics = ["/scan", "/odom", "/diagnostics", "/rosout"]
    recording = await tour.call("ros2_record_start", topic_names=topics, name="incident")
    await asyncio.sleep(1.0)
    await tour.call("ros2_parameter_set", node_name="/lidar", values={"enabled": False})
    await asyncio.sleep(2.5)
    recorded = await tour.call("ros2_record_stop", recording_id=recording["recording_id"])
    tour.show(f"{recorded['messages']} messages were recorded")
    health = await tour.call("ros2_health_check", bag="incident", start="last 1.5 s")
    for finding in health["findings"]:
        tour.show(f"{finding['subject']}: {finding['problem']}")
    silent = [row["topic_name"] for row in health["topics"] if row["state"] == "SILENT"]
    tour.verify(f"the recording tells what is silent: {', '.join(silent)}", silent == ["/scan"])
    last = await tour.call("ros2_bag_read", bag="incident", topic_name="/scan", message_limit=1, fields=["range_max"])
    tour.show(f"the last scan came {last['times_s'][-1]:.3f} s after {last['start']}")
    await tour.call("ros2_plot", series=["/scan:ranges[180]", "/odom:twist.twist.linear.x"], bag="incident")
    for line in (await tour.call("ros2_log_read", bag="incident", level="warn"))["lines"]:
        tour.show(f"{line['time']} {line['level']} {line['node']}: {line['text']}")
    await tour.call("ros2_parameter_set", node_name="/lidar", values={"enabled": True})
    back = await tour.call("ros2_wait_until", topic_name="/scan", condition="range_max > 0", timeout_s=5)
    tour.verify("the scanner is repaired", back["met"])


async def _position(tour: Tour) -> tuple[float, float]:
    odometry = await tour.call("ros2_topic_echo_wait", topic_name="/odom", fields=["pose.pose.position"])
    position = odometry["message"]["pose.pose.position"]
    tour.show(f"odometry: x {position['x']:.3f} m, y {position['y']:.3f} m")
    return position["x"], position["y"]


def _options(settings: Settings, folder: Path) -> list[str]:
    options = ["--tools", "default,memory,measure,pictures,motion", "--record-dir", str(folder / "recordings")]
    options += ["--prompts", str(PROMPTS)]
    options += ["--distro", settings.distro] if settings.distro else []
    return options + [word for workspace in settings.workspaces for word in ("--workspace", str(workspace))]
