"""Data Black Boxes of both generations as real nodes, and servers that know their interfaces."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from ros2_mcp_interfaces import build, default_cache
from support.agent import DISCOVERY_S, Agent, agent_for
from support.demo_robot import with_interfaces
from support.processes import peer_command

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def prefixes() -> list[Path]:
    """The built interface packages; kept for the next run."""
    return build([HERE / "interfaces"], default_cache(), lambda _line: None)


@contextmanager
def box_node(generation: int, environment: dict[str, str], prefixes: list[Path]) -> Iterator[None]:
    """A Data Black Box while the block runs."""
    command = peer_command("box_peer", str(generation))
    known = with_interfaces(environment, prefixes)
    node = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=known)
    try:
        assert node.stdout and node.stdout.readline() == "ready\n"
        yield
    finally:
        node.kill()
        node.communicate(timeout=30)


def found(agent: Agent) -> Agent:
    """The client, as soon as its server has discovered the box."""
    deadline = time.monotonic() + DISCOVERY_S
    while not agent.call("ros2_service_list", pattern="/get_messages")["services"]:
        assert time.monotonic() < deadline, "not discovered"
        time.sleep(0.1)
    return agent


def serving(environment: dict[str, str], prefixes: list[Path], domain: int, folder: Path) -> dict[str, str]:
    """The environment of a server in that domain that knows the interfaces and records below the folder."""
    return {
        **environment,
        "ROS_DOMAIN_ID": str(domain),
        "ROS2_MCP_INTERFACES": os.pathsep.join(map(str, prefixes)),
        "ROS2_MCP_RECORD_DIR": str(folder),
    }


@pytest.fixture(scope="module", params=[1, 2], ids=["generation 1", "generation 2"])
def agent(
    request: pytest.FixtureRequest,
    ros_environment: dict[str, str],
    domain_id: int,
    prefixes: list[Path],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Agent]:
    """A client whose robot has a Data Black Box of one generation, in a domain of its own; `agent.generation`."""
    environment = serving(ros_environment, prefixes, domain_id + request.param - 1, tmp_path_factory.mktemp("bags"))
    with box_node(request.param, environment, prefixes), agent_for(environment, "--tools", "all") as client:
        client.generation = request.param
        yield found(client)


@pytest.fixture
def stranger(
    agent: Agent, ros_environment: dict[str, str], domain_id: int, prefixes: list[Path], tmp_path: Path
) -> Iterator[Agent]:
    """A second client beside `agent`, whose server lacks the interfaces of the box."""
    environment = serving(ros_environment, prefixes, domain_id + agent.generation - 1, tmp_path)
    environment["ROS2_MCP_INTERFACES"] = ""
    with agent_for(environment, "--tools", "all") as client:
        yield found(client)


@pytest.fixture
def start_agent(
    ros_environment: dict[str, str], domain_id: int, prefixes: list[Path], tmp_path: Path
) -> Iterator[Callable[..., Agent]]:
    """Start a server in a domain without a Data Black Box, which records below `tmp_path`."""
    environment = serving(ros_environment, prefixes, domain_id + 2, tmp_path)
    with ExitStack() as running:
        yield lambda *options: running.enter_context(agent_for(environment, "--tools", "all", *options))
