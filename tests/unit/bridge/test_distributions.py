"""The bridge runs with the ROS 2 of Humble to Lyrical, and with their Pythons, as far as names and syntax tell.

What was run is in `docs/reference/platforms.md`.
"""

from __future__ import annotations

import ast
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.rclpy_names import DISTRIBUTIONS, is_in, names_of, used
from support.source import modules

TESTS = Path(__file__).parents[2]
BRIDGE = "src/ros2_mcp_bridge/"
FAR_SIDE = ("start.finding", "start.stage1")
"""What runs before it is known which Python ROS has: from 3.8 on."""
PYTHONS = [f"3.{minor}" for minor in range(8, 15)]


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_every_name_of_rclpy_that_the_bridge_uses_is_there(distribution: str) -> None:
    missing = {name: place for name, place in used().items() if not is_in(name, distribution)}
    assert not missing, (
        f"These are not in tests/support/rclpy/{distribution}.txt. Is there another way in {distribution}? Where its "
        "rclpy has them, `python -m support.rclpy_names FOLDER` lists the names of a version anew."
    )


def test_what_the_bridge_uses_is_found_in_its_source() -> None:
    known = {
        "rclpy.init(signal_handler_options)",
        "rclpy.node.Node.get_publishers_info_by_topic",
        "rclpy.node.Node.create_client(qos_profile)",
        "rclpy.impl.Publisher.publish_raw",
        "rclpy.impl.Node.get_count_publishers",
        "rclpy.client.Client.call_async",
        "rclpy.executors.Executor.spin_once(timeout_sec)",
        "rclpy.topic_endpoint_info.TopicEndpointInfo.endpoint_gid",
        "rclpy.qos.QoSProfile.get_c_qos_profile",
        "rclpy.duration.Duration._duration_handle",
    }
    assert known <= used().keys()


def test_the_installed_rclpy_has_these_names_too() -> None:
    spec = importlib.util.find_spec("rclpy")
    if spec is None or not spec.origin:
        pytest.skip("needs rclpy: --extra jazzy or --extra kilted")
    found = names_of(Path(spec.origin).parent)
    # Of the compiled part some wheels bring no types; a profile takes any keyword in some versions.
    elsewhere = ("rclpy.impl.", "rclpy.signals.SignalHandlerOptions.", "rclpy.qos.QoSProfile(")
    assert not {name for name in used() if not name.startswith(elsewhere)} - found


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_every_module_of_the_bridge_is_imported_beside_the_names_of_a_distribution(distribution: str) -> None:
    command = [sys.executable, "-m", "support.stub_rclpy", distribution]
    environment = {**os.environ, "PYTHONPATH": str(TESTS)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 30


def test_the_bridge_has_the_syntax_of_python_3_8() -> None:
    for path, text in modules().items():
        if path.startswith(BRIDGE):
            ast.parse(text, path, feature_version=(3, 8))


def test_every_python_that_is_here_compiles_the_bridge_and_imports_what_finds_ros() -> None:
    sources = TESTS.parent / "src"
    code = (
        "import pathlib, sys; sys.path[:0] = [sys.argv[1]]\n"
        "for path in pathlib.Path(sys.argv[1]).glob('ros2_mcp_[bc]*/**/*.py'):\n"
        "    compile(path.read_bytes(), str(path), 'exec')\n"
        f"import {', '.join(f'ros2_mcp_common.{name}' for name in FAR_SIDE)}\n"
        "print('%d.%d' % sys.version_info[:2])"
    )
    tried = set[str]()
    for python in filter(None, map(shutil.which, (f"python{version}" for version in PYTHONS))):
        runs = subprocess.run([python, "-c", ""], capture_output=True, check=False).returncode == 0
        if runs:  # some are signposts to Pythons that are not chosen
            done = subprocess.run([python, "-I", "-c", code, str(sources)], capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            tried.add(done.stdout.strip())
    assert tried, "no Python is found by the name of its version"
