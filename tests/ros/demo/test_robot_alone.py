"""`ros2-mcp demo --robot` meets no real robot unless it is told to, and says how a client reaches it."""

import json
import os
import shlex
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.agent import until
from support.demo_robot import build_interfaces
from support.raw_server import RawServer

CHOOSES_GRAPH = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY")
SERVER = [sys.executable, "-m", "ros2_mcp"]


@pytest.fixture(scope="module", autouse=True)
def nothing_is_built_later(prefixes):
    """The robot builds what is missing in a process that outlives it, and a test that ends first."""
    build_interfaces(later=True)


@pytest.fixture
def start_alone(prefixes):
    """Start the robot as a user does, with these variables of its graph and no others; it ends after the test."""
    with robots_alone() as start:
        yield start


@pytest.fixture(scope="module")
def robot(prefixes):
    """The first robot on this machine."""
    with robots_alone() as start:
        yield start()


@contextmanager
def robots_alone():
    """What starts robots, which end with the block."""
    started = []

    def start(*options, **variables):
        environment = {name: value for name, value in os.environ.items() if name not in CHOOSES_GRAPH}
        command = [*SERVER, *options, "demo", "--robot"]
        process = subprocess.Popen(command, env={**environment, **variables}, stdout=subprocess.PIPE, text=True)
        started.append(process)
        told = [process.stdout.readline() for _ in range(8)]
        assert told[-1].startswith("robot ready"), told
        process.told = told
        return process

    try:
        yield start
    finally:
        for process in started:
            process.terminate()
        for process in started:
            process.communicate(timeout=60)


def graph_of(process):
    """What the kernel says of a process's graph: the robot is the process that was started."""
    entries = Path(f"/proc/{process.pid}/environ").read_bytes().decode().split("\0")
    variables = dict(entry.split("=", 1) for entry in entries if "=" in entry)
    return {name: variables[name] for name in CHOOSES_GRAPH if name in variables}


@pytest.mark.promise("README", "runs the robot alone, for a client of your own")
@pytest.mark.promise("README", "It uses a ROS domain of its own, on this machine only")
def test_it_keeps_to_itself_and_the_line_that_it_prints_leads_a_client_to_it(robot):
    graph = graph_of(robot)
    assert graph["ROS_DOMAIN_ID"] != "0"
    assert graph["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert f"domain {graph['ROS_DOMAIN_ID']}, on this machine only" in robot.told[0]

    line = shlex.split(robot.told[2])
    assert line[1:] == ["--domain-id", graph["ROS_DOMAIN_ID"], "config", "claude-code"]
    export, alias = robot.told[5:7]
    assert export == f"  export ROS_DOMAIN_ID={graph['ROS_DOMAIN_ID']} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST\n"
    assert shlex.split(alias) == ["alias", f"ros2-mcp={shlex.join(line[:1])}"]
    bare = {"PATH": os.environ["PATH"], "HOME": os.environ["HOME"]}
    printed = subprocess.run([*line[:-1], "cursor"], env=bare, capture_output=True, text=True, check=True)
    entry = json.loads(printed.stdout)["mcpServers"]["ros2"]
    client = RawServer({**bare, **entry["env"]}, *entry["args"], command=[entry["command"]])
    try:
        client.begin("2025-11-25")
        # Discovery may take longer than the first call waits for it.
        until(lambda: "/base_controller" in str(client.ask("tools/call", name="ros2_node_list", arguments={})))
    finally:
        client.end()


@pytest.mark.promise("README", "It uses a ROS domain of its own")
def test_a_second_robot_on_this_machine_does_not_meet_the_first(robot, start_alone):
    assert graph_of(robot)["ROS_DOMAIN_ID"] != graph_of(start_alone())["ROS_DOMAIN_ID"]


def test_the_domain_and_the_range_that_were_asked_for_are_kept(domain_id, start_alone):
    asked = {"ROS_DOMAIN_ID": str(domain_id), "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    robot = start_alone(**asked)
    assert graph_of(robot) == asked
    assert robot.told[0] == f"A simulated robot starts in ROS domain {domain_id}. Ctrl+C ends it.\n"
    by_option = start_alone("--domain-id", str(domain_id + 1), ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")
    assert graph_of(by_option)["ROS_DOMAIN_ID"] == str(domain_id + 1)


@pytest.mark.promise("README", "without them the robot says what it leaves out")
def test_without_a_compiler_it_says_what_it_leaves_out(start_alone, tmp_path):
    robot = start_alone(PATH=str(tmp_path), XDG_CACHE_HOME=str(tmp_path))
    assert "; left out: " in robot.told[-1] and "/navigate_to (no ros2_mcp_demo_interfaces)" in robot.told[-1]
