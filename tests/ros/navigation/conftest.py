"""The simulated rover with Nav2's interfaces, and a server beside it."""

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import agent_for, until
from support.demo_robot import build_interfaces, robot_environment, running_robot
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
