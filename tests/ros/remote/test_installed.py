"""A bridge that is installed where it runs, as the ROS package: the robot's command starts it, and nothing is sent."""

from __future__ import annotations

import shlex
import sys
from collections.abc import AsyncIterator, Callable

import pytest

from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.errors import BadInput, Unreachable
from ros2_mcp.settings import Settings

PATIENCE_S = 60.0
INSTALLED = f"{shlex.quote(sys.executable)} -m ros2_mcp_bridge"


@pytest.fixture
async def reach(ros_environment: dict[str, str]) -> AsyncIterator[Callable[..., Bridge]]:
    bridges: list[Bridge] = []

    def begin(*command: str, **more: object) -> Bridge:
        settings = Settings(robot_command=command, **more)  # type: ignore[arg-type]
        bridges.append(Bridge(lambda: start_carrier(settings, ros_environment)))
        return bridges[-1]

    yield begin
    for bridge in bridges:
        await bridge.close()


async def test_a_command_that_starts_an_installed_bridge_reaches_it(
    reach: Callable[..., Bridge], domain_id: int
) -> None:
    bridge = reach(sys.executable, "-m", "ros2_mcp_bridge")
    assert (await bridge.ready()).domain_id == domain_id
    assert "ros2_mcp_bridge is installed in" in bridge.origin
    reply = await bridge.request("stats", timeout_s=PATIENCE_S)
    assert reply.ok["publishers"] == 0


async def test_what_a_login_prints_before_it_is_no_hindrance(reach: Callable[..., Bridge], domain_id: int) -> None:
    bridge = reach("sh", "-c", f'echo Welcome to the robot.; exec {INSTALLED} "$@"', "login")
    assert (await bridge.ready()).domain_id == domain_id


async def test_a_command_that_finds_no_such_package_says_what_it_said(reach: Callable[..., Bridge]) -> None:
    bridge = reach("sh", "-c", "echo \"Package 'ros2_mcp_bridge' not found\" >&2; exit 1")
    with pytest.raises(Unreachable, match=r"Package 'ros2_mcp_bridge' not found.*code 1") as caught:
        await bridge.ready()
    assert "colcon build" in (caught.value.hint or "")


async def test_settings_that_it_cannot_be_told_are_refused(reach: Callable[..., Bridge]) -> None:
    bridge = reach("ssh", "me@robot", "ros2 run ros2_mcp_bridge bridge", distro="jazzy")
    with pytest.raises(BadInput, match="in the ROS 2 that the command sets up"):
        await bridge.ready()
