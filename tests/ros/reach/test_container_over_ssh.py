"""A container on a robot behind a real sshd: one login, and the bridge is in the container."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.address import parse_address
from ros2_mcp.model.errors import Unreachable
from ros2_mcp.settings import Settings
from support.far_side import OWN_PYTHON, engine, read_only_machine
from support.sshd import sshd


async def test_it_is_entered_by_one_address(domain_id: int, ros_environment: dict[str, str], tmp_path: Path) -> None:
    names = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    env = {name: ros_environment[name] for name in names if name in ros_environment}
    path = os.pathsep.join([str(engine(tmp_path, read_only_machine())), "/usr/bin", "/bin"])
    (tmp_path / "sshd").mkdir()
    with sshd(tmp_path / "sshd", {**env, "PATH": path}) as far:

        def settings(container: str) -> Settings:
            return Settings(
                robots=(parse_address(f"{far.address()}?container={container}"),),
                ssh_options=far.options(),
                bridge_python=Path(OWN_PYTHON),
                robot_env=(f"ROS_DOMAIN_ID={domain_id}",),
            )

        async with Bridge(lambda: start_carrier(settings("ros"))) as bridge:
            assert (await bridge.ready()).domain_id == domain_id
        async with Bridge(lambda: start_carrier(settings("idle"))) as bridge:
            with pytest.raises(Unreachable, match="The container idle is not running") as told:
                await bridge.ready()
            assert "docker start idle" in told.value.hint
