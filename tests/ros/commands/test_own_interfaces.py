"""A package that `ros2-mcp interfaces build` has built is used by the server without any other option."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.agent import agent_for

pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

PACKAGE = {
    "msg/Crate.msg": "string label\nfloat64[] weights\ngeometry_msgs/Point at\n",
    "srv/Weigh.srv": "Crate crate\n---\nfloat64 total\n",
}
PEER = """
import sys, rclpy
from own_wares.msg import Crate
from own_wares.srv import Weigh
rclpy.init()
node = rclpy.create_node("scales")
latest = node.create_publisher(Crate, "crates_back", 10)
node.create_subscription(Crate, "crates", lambda crate: latest.publish(crate), 10)
def weigh(request, response):
    response.total = sum(request.crate.weights)
    return response
node.create_service(Weigh, "weigh", weigh)
print("ready", flush=True)
import threading
threading.Thread(target=lambda: (sys.stdin.read(), rclpy.try_shutdown()), daemon=True).start()
try:
    rclpy.spin(node)
except BaseException:
    pass
"""


@pytest.fixture
def built(tmp_path, ros_environment):
    """The environment with a cache of its own, and the prefix of the package."""
    for name, text in PACKAGE.items():
        file = tmp_path / "own_wares" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    environment = {**ros_environment, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "ros2_mcp", "interfaces", "build", str(tmp_path / "own_wares")]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=200, check=False)
    assert run.returncode == 0, run.stderr
    return environment, Path(run.stdout.split()[-1])


@pytest.fixture
def scales(built):
    """An independent node that uses the package."""
    environment, prefix = built
    paths = {
        "PYTHONPATH": f"{prefix / 'site-packages'}{os.pathsep}{environment['PYTHONPATH']}",
        "AMENT_PREFIX_PATH": f"{prefix}{os.pathsep}{sys.prefix}",
    }
    with subprocess.Popen(
        [sys.executable, "-c", PEER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**environment, **paths}
    ) as node:
        assert node.stdout and node.stdout.readline() == b"ready\n"
        yield node
        node.stdin.close()


@pytest.mark.promise("ros2_interface_list", "List the message, service and action types installed on the robot")
@pytest.mark.timeout(300)
def test_the_server_knows_a_built_package_and_speaks_it_with_other_nodes(built, scales) -> None:
    crate = {"label": "blue", "weights": [1.5, 2.0], "at": {"x": 1.0, "y": 0.0, "z": 0.0}}
    with agent_for(built[0], "--tools", "all") as agent:
        listed = agent.call("ros2_interface_list", package="own_wares")["interfaces"]
        agent.knows("/crates", "/crates_back")
        assert sorted(listed) == ["own_wares/msg/Crate", "own_wares/srv/Weigh"]
        reading = agent.begin("ros2_topic_echo_wait", topic_name="/crates_back", timeout=30)
        sent = agent.call("ros2_topic_publish", topic_name="/crates", message_type="own_wares/Crate", data=crate)
        assert (sent["status"], sent["subscribers"]) == ("published", 1)
        while not reading.done():  # it may have begun to listen later than the answer to the first came
            agent.call("ros2_topic_publish", topic_name="/crates", message_type="own_wares/Crate", data=crate)
        assert reading.result()["message"] == crate
        answer = agent.call("ros2_service_call", service_name="/weigh", fields={"crate": crate})
        assert answer["result"] == {"total": 3.5}
        wrong = {"crate": {**crate, "at": {"x": "one"}}}
        said = agent.refusal("ros2_service_call", service_name="/weigh", fields=wrong)
        assert said.startswith("BadValue: crate.at.x: ")
