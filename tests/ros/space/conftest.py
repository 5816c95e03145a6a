"""Nodes that tell transforms, for the tests of frames."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from ros2_mcp_interfaces import build, default_cache
from support.processes import SOURCES, peer_command, running

Tell = Callable[..., None]
TF2 = SOURCES / "ros2_mcp_demo" / "interfaces" / "tf2_msgs"


@pytest.fixture(scope="module")
def tf_peer(ros_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Nodes that tell transforms."""
    prefixes = build([TF2], default_cache(), lambda _line: None)
    known = {
        **ros_environment,
        "AMENT_PREFIX_PATH": os.pathsep.join(map(str, [*prefixes, sys.prefix])),
        "PYTHONPATH": os.pathsep.join(
            [*(str(each / "site-packages") for each in prefixes), ros_environment["PYTHONPATH"]]
        ),
    }
    with running(known, *peer_command("tf_peer")) as process:
        yield process


@pytest.fixture(scope="module")
def tell(tf_peer: subprocess.Popen[str]) -> Tell:
    """Has a node tell an edge: `tell("odom", "base_link", node="base", hz=20)`."""

    def say(parent: str, child: str, **edge: Any) -> None:
        assert tf_peer.stdin
        tf_peer.stdin.write(json.dumps({"parent": parent, "child": child, "node": "base", "hz": 20, **edge}) + "\n")
        tf_peer.stdin.flush()

    return say
