"""The one-minute tour: an MCP client over real stdio does what an agent would do, and shows what it gets."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import base64
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

from mcp import Client, StdioServerParameters
from mcp.types import ImageContent

from ros2_mcp.commands.simulation import Graph, with_interfaces
from ros2_mcp.settings import Settings

_BOLD, _DIM, _GREEN, _RED, _END = "\033[1m", "\033[2m", "\033[32m", "\033[31m", "\033[0m"


class StepFailed(Exception):
    """A tool answered with an error that the tour cannot go on from."""


class Tour:
    """One client with a transcript; each step prints what was asked and what came back."""

    def __init__(self, client: Client, folder: Path) -> None:
        self._client = client
        self._folder = folder
        self._started = time.monotonic()
        self._pictures = 0
        self.transcript: list[dict[str, Any]] = []
        self.failures: list[str] = []

    def say(self, text: str) -> None:
        """A line of the story."""
        self.transcript.append({"say": text})
        print(f"\n{_paint(_BOLD, text)}", flush=True)

    def show(self, text: str) -> None:
        """A line of result."""
        self.transcript.append({"show": text})
        print(f"  {text}", flush=True)

    def verify(self, claim: str, holds: bool) -> None:
        """A claim that the tour proves, or fails with."""
        if not holds:
            self.failures.append(claim)
        self.show(_paint(_GREEN if holds else _RED, f"{'verified' if holds else 'NOT TRUE'}: {claim}"))

    async def call(self, tool: str, **arguments: Any) -> Any:
        """One tool call; returns its structured content and saves its pictures."""
        print(_paint(_DIM, f"  > {tool} {json.dumps(arguments)}"), flush=True)
        started = time.monotonic()

        async def on_progress(progress: float, total: float | None, message: str | None) -> None:
            print(_paint(_DIM, f"    … {progress:.0f}/{total or 0:.0f} s  {message or ''}"), flush=True)

        result = await self._client.call_tool(tool, arguments, progress_callback=on_progress)
        elapsed_s = time.monotonic() - started
        text = "".join(getattr(block, "text", "") for block in result.content)
        self.transcript.append({"tool": tool, "arguments": arguments, "seconds": round(elapsed_s, 3), "text": text})
        for image in result.content:
            if isinstance(image, ImageContent):
                self.show(f"picture saved: {self._save(image)}")
        if result.is_error:
            raise StepFailed(f"{tool}: {text}")
        return result.structured_content

    def _save(self, image: ImageContent) -> Path:
        self._pictures += 1
        path = self._folder / f"picture-{self._pictures}.{image.mime_type.split('/')[1]}"
        path.write_bytes(base64.b64decode(image.data))
        return path

    def finish(self) -> int:
        """Writes the transcript; returns the exit code."""
        path = self._folder / "transcript.json"
        path.write_text(json.dumps(self.transcript, indent=1, ensure_ascii=False))
        seconds = time.monotonic() - self._started
        print(f"\nThe tour took {seconds:.0f} s. Pictures and transcript: {self._folder.resolve()}")
        for failure in self.failures:
            print(_paint(_RED, f"failed: {failure}"), file=sys.stderr)
        return 1 if self.failures else 0


async def take_tour(settings: Settings, graph: Graph, folder: Path) -> int:
    """Starts the server as a client would, over stdio, and walks through what it can do; saves into the folder."""
    prefixes = with_interfaces(settings).interface_prefixes
    variables = {**graph.variables(), "ROS2_MCP_INTERFACES": ":".join(map(str, prefixes))}
    server = StdioServerParameters(
        command=sys.executable, args=["-m", "ros2_mcp", *_options(settings, folder)], env=variables
    )
    async with Client(server) as client:
        tour = Tour(client, folder)
        try:
            for chapter in (look_around, drive_one_metre, use_services, navigate, remember):
                await chapter(tour)
        except StepFailed as error:
            tour.failures.append(str(error))
    return tour.finish()


async def look_around(tour: Tour) -> None:
    """What is there, and what the sensors see."""
    tour.say("1. What is there?")
    topics = await tour.call("ros2_topic_list")
    for topic in topics["topics"]:
        tour.show(f"{topic['topic_name']:32} {topic['topic_type']}")
    tour.say("2. What do the sensors see?")
    scan = await tour.call("ros2_topic_echo_wait", topic_name="/scan", fields=["ranges", "range_max"])
    ranges = scan["message"]["ranges"]
    tour.show(f"the laser scanner sees {ranges['length']} ranges, the nearest at {ranges['min']:.2f} m")
    await tour.call("ros2_topic_subscribe", topic_name="/camera/image_raw")
    stats = await tour.call("ros2_topic_stats", topic_names=["/odom", "/scan", "/imu"], duration=2.0)
    for topic in stats["topics"]:
        tour.show(f"{topic['topic_name']:8} {topic['rate_hz']:6.2f} Hz, jitter {topic['jitter_s'] * 1000:.1f} ms")


async def drive_one_metre(tour: Tour) -> None:
    """Drive, stop, and prove it by odometry."""
    tour.say("3. Drive one metre, then stop.")
    before = await _position(tour)
    sent = await tour.call(
        "ros2_topic_publish", topic_name="/cmd_vel", data={"linear": {"x": 0.25}}, frequency=20.0, duration=4.0
    )
    tour.show(f"{sent['sent']} commands sent to {sent['subscribers']} subscriber(s). {sent['note']}")
    stopped = await tour.call("ros2_topic_subscribe", topic_name="/odom", duration=1.0, fields=["twist.twist.linear.x"])
    speed = stopped["messages"][-1]["twist.twist.linear.x"]
    after = await _position(tour)
    moved = math.dist(before, after)
    tour.verify(f"odometry says the robot moved {moved:.2f} m", 0.85 < moved < 1.15)
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
    """Send a goal that drives around walls, and cancel another."""
    actions = await tour.call("ros2_list_actions")
    if not actions["actions"]:
        tour.say("5. Navigation is left out: its interfaces could not be built here.")
        return
    tour.say("5. Navigate around walls, then cancel a second goal.")
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


async def remember(tour: Tour) -> None:
    """Record, break something, and ask the recording what happened."""
    tour.say("6. Record, break the laser scanner, and ask what happened.")
    topics = ["/scan", "/odom", "/diagnostics", "/rosout"]
    recording = await tour.call("ros2_record_start", topics=topics, name="incident")
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
    last = await tour.call("ros2_bag_read", bag="incident", topic_name="/scan", limit=1, fields=["range_max"])
    tour.show(f"the last scan came at {last['received_at'][-1]}")
    await tour.call("ros2_plot", series=["/scan:ranges[180]", "/odom:twist.twist.linear.x"], bag="incident")
    for line in (await tour.call("ros2_log_read", bag="incident", level="warn"))["lines"]:
        tour.show(f"{line['time']} {line['level']} {line['node']}: {line['text']}")
    await tour.call("ros2_parameter_set", node_name="/lidar", values={"enabled": True})
    back = await tour.call("ros2_wait_until", topic_name="/scan", condition="range_max > 0", timeout=5)
    tour.verify("the scanner is repaired", back["met"])


async def _position(tour: Tour) -> tuple[float, float]:
    odometry = await tour.call("ros2_topic_echo_wait", topic_name="/odom", fields=["pose.pose.position"])
    position = odometry["message"]["pose.pose.position"]
    tour.show(f"odometry: x {position['x']:.3f} m, y {position['y']:.3f} m")
    return position["x"], position["y"]


def _options(settings: Settings, folder: Path) -> list[str]:
    options = ["--tools", "default,memory,measure,pictures", "--record-dir", str(folder / "recordings")]
    options += ["--distro", settings.distro] if settings.distro else []
    return options + [word for workspace in settings.workspaces for word in ("--workspace", str(workspace))]


def _paint(style: str, text: str) -> str:
    return f"{style}{text}{_END}" if sys.stdout.isatty() else text
