"""The simulated rover with Nav2's interfaces, and a server beside it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_interfaces import build, default_cache
from support import commanded
from support.agent import Agent, agent_for, until
from support.commanded import CommandedProcess
from support.demo_robot import build_interfaces, robot_environment, running_robot, with_interfaces
from support.domains import reserved_domains


@pytest.fixture(scope="module")
def built():
    """The prefixes of what the rover has besides, and that of nav2_msgs."""
    prefixes = build_interfaces(later=True)
    (later,) = (prefix for prefix in prefixes if prefix.name.startswith("nav2_msgs-"))
    return [prefix for prefix in prefixes if prefix != later], later


@pytest.fixture(scope="module")
def agent(built, tmp_path_factory):
    """A client of a server that was there, as the rover was, before nav2_msgs had been built."""
    first, later = built
    folder = tmp_path_factory.mktemp("navigation")
    arriving = folder / later.name
    prefixes = [*first, arriving]
    with reserved_domains() as domain_id, running_robot(prefixes, domain_id) as robot:
        assert "left out" not in robot.ready_line
        environment = robot_environment(prefixes, ROS_DOMAIN_ID=str(domain_id), XDG_STATE_HOME=str(folder / "state"))
        with agent_for(environment, "--tools", "all") as agent:
            agent.knows("/odom")
            assert "There is no action of type nav2_msgs" in agent.refusal("ros2_navigate", to=[{"x": 1.0, "y": 0.0}])
            arriving.symlink_to(later)
            agent.knows("/global_costmap/costmap")
            until(lambda: "/navigate_to_pose" in str(agent.call("ros2_list_actions")))
            yield agent


@pytest.fixture(scope="module")
def nav_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """With transforms, and the interfaces of the tests' own Nav2."""
    own = Path(commanded.__file__).parent / "interfaces" / "nav2_msgs"
    prefixes = [*build_interfaces("arm"), *build([own], default_cache(), lambda _line: None)]
    known = os.pathsep.join(map(str, prefixes))
    return {**with_interfaces(ros_environment, prefixes), "ROS2_MCP_INTERFACES": known}


@pytest.fixture(scope="module")
def nav2(nav_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    process = CommandedProcess("nav2_peer", nav_environment)
    yield process
    process.kill()


@pytest.fixture(scope="module")
def nav_agent(nav_environment: dict[str, str], nav2: CommandedProcess) -> Iterator[Agent]:
    with agent_for(nav_environment, "--tools", "all") as client:
        client.knows("/cmd_vel", "/odom", "/tf")
        yield client


@pytest.fixture
def navigator(nav_environment: dict[str, str], nav2: CommandedProcess, nav_agent: Agent) -> Iterator[CommandedProcess]:
    """Nav2's navigator, which the server knows and the test may kill; the base stands at the start."""
    until(lambda: nav2.speed() == 0.0)
    nav2.put()
    process = CommandedProcess("navigator_peer", nav_environment)
    nav_agent.until_answered("ros2_parameter_list", node_name="/bt_navigator")  # not one that was killed
    until(lambda: "/navigate_to_pose" in str(nav_agent.call("ros2_list_actions")))
    yield process
    process.end_or_kill()
