"""The simulated robot: run alone, or with the one-minute tour."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os
import shlex
import time
from dataclasses import replace
from pathlib import Path

from ros2_mcp.commands.simulation import Graph, build_later, reach_of_this_machine, simulated_robot, with_interfaces
from ros2_mcp.link.environment import find_ros, wheel_distro
from ros2_mcp.link.provenance import launch_command, own_provenance
from ros2_mcp.settings import Settings


def demo(settings: Settings, *, robot: str, robot_only: bool, output: Path | None) -> int:
    """Run a robot alone until it is stopped, or run the tour with it. Return the exit code."""
    if robot_only:
        return run_robot(settings, robot)
    graph = Graph.private()
    print(f"A simulated robot starts on this machine (ROS domain {graph.domain_id}).", flush=True)
    with simulated_robot(settings, graph, robot) as greeting:
        print(greeting, flush=True)
        build_later(settings, robot)
        from ros2_mcp.commands.tour import take_tour

        folder = (output or Path(f"ros2-mcp-demo-{time.strftime('%H%M%S')}-{graph.domain_id}")).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        return asyncio.run(take_tour(settings, graph, folder, robot))


def run_robot(settings: Settings, robot: str) -> int:
    """Replace this process by that simulated robot, until Ctrl+C: in the given domain, or else in a private domain."""
    domain_id = Graph.private().domain_id if settings.domain_id is None else settings.domain_id
    installation = find_ros(with_interfaces(replace(settings, domain_id=domain_id), robot))
    reach = reach_of_this_machine(installation.distro, os.environ)
    command = installation.command("ros2_mcp_demo", ["--robot", robot])
    command_line = shlex.join(launch_command(own_provenance(), wheel_distro() or ""))
    ours = f"{command_line} --domain-id {domain_id}"
    variables = " ".join(f"{name}={value}" for name, value in {"ROS_DOMAIN_ID": domain_id, **reach}.items())
    where = f"ROS domain {domain_id}" + (", on this machine only" if reach else "")
    print(
        f"A simulated robot starts in {where}. Ctrl+C ends it.\n"
        "What configures a client for it (others than claude-code: config --help), and a look without one:\n"
        f"  {ours} config claude-code\n"
        f"  {ours} call ros2_topic_list\n"
        "Or for the tutorial (docs/tutorial.md), in another terminal:\n"
        f"  export {variables}\n"
        f"  alias ros2-mcp={shlex.quote(command_line)}",
        flush=True,
    )
    build_later(settings, robot)
    os.execvpe(command.argv[0], list(command.argv), {**command.env, **reach})
