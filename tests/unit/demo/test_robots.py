"""The simulated robots are the same for the command line and for the package that runs them."""

import importlib.util

from ros2_mcp.commands.robots import DEFAULT, LATER, ROBOTS
from ros2_mcp.link.interfaces import SHIPPED
from ros2_mcp_demo import robots


def test_the_command_line_offers_the_robots_that_there_are():
    assert list(ROBOTS) == list(robots.ROBOTS)
    assert DEFAULT in ROBOTS
    assert [module for module in robots.ROBOTS.values() if importlib.util.find_spec(module) is None] == []


def test_every_interface_package_that_is_shipped_is_built_for_some_robot_and_no_other():
    wanted = {package for packages in (*ROBOTS.values(), *LATER.values()) for package in packages}
    assert wanted == {folder.name for folder in SHIPPED.iterdir()}
