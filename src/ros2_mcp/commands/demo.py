"""The simulated robot: run alone, or as the partner of the one-minute tour."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path

from ros2_mcp.commands.simulation import Graph, simulated_robot, with_interfaces
from ros2_mcp.link.environment import find_ros
from ros2_mcp.settings import Settings


def demo(settings: Settings, *, robot_only: bool, output: Path | None) -> int:
    """Runs the robot alone until it is stopped, or the whole tour."""
    if robot_only:
        return run_robot(settings)
    graph = Graph.private()
    print(f"A simulated robot starts on this machine (ROS domain {graph.domain_id}).", flush=True)
    with simulated_robot(settings, graph) as greeting:
        print(greeting, flush=True)
        from ros2_mcp.commands.tour import take_tour

        folder = output or Path(f"ros2-mcp-demo-{time.strftime('%H%M%S')}")
        folder.mkdir(parents=True, exist_ok=True)
        return asyncio.run(take_tour(settings, graph, folder))


def run_robot(settings: Settings) -> int:
    """Becomes the simulated robot, in the graph of this shell, until Ctrl-C."""
    command = find_ros(with_interfaces(settings)).command("ros2_mcp_demo")
    os.execvpe(command.argv[0], list(command.argv), dict(command.env))
