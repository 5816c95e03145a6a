"""The simulated robot in a process of its own, and a ROS 2 node of the tests' own that looks at it."""

import importlib
import math
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from ros2_mcp.commands.robots import LATER, ROBOTS
from support.processes import SOURCES, python_path

PATIENCE_S = 40.0
ASKS_AGAIN_S = 5.0
"""A server drops its answer where it has not discovered the client's reader 0.1 s after the request came."""


def interface(name):
    """The class of an interface such as `std_msgs/msg/String`."""
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


def build_interfaces(robot="rover", *, later=False):
    """The prefixes of the interface packages of a robot; takes a while the first time, then they are cached.

    `later`: with those that are built while the robot runs, too.
    """
    packages = [*ROBOTS[robot], *(LATER.get(robot, ()) if later else ())]
    sources = [str(SOURCES / "ros2_mcp_demo" / "interfaces" / package) for package in packages]
    command = [sys.executable, "-m", "ros2_mcp_interfaces", *sources]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, env=robot_environment([]), check=True)
    return [Path(line) for line in run.stdout.split()]


def with_interfaces(environment, prefixes):
    """The environment, in which the interfaces in these prefixes are known, too."""
    sites = [str(prefix / "site-packages") for prefix in prefixes]
    return {
        **environment,
        "PYTHONPATH": os.pathsep.join(filter(None, [*sites, environment.get("PYTHONPATH")])),
        "AMENT_PREFIX_PATH": os.pathsep.join([*map(str, prefixes), sys.prefix]),
    }


def robot_environment(prefixes, **more):
    """The environment of a process that knows the interfaces in these prefixes, on this machine alone."""
    environment = {**os.environ, "PYTHONPATH": python_path(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {**with_interfaces(environment, prefixes), **more}


@contextmanager
def running_robot(prefixes, domain_id, *options):
    """The robot's process, once it has said that it is ready; killed if it does not end by itself."""
    command = [sys.executable, "-m", "ros2_mcp_demo", *options]
    environment = robot_environment(prefixes, ROS_DOMAIN_ID=str(domain_id))
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True) as process:
        try:
            process.ready_line = process.stdout.readline()
            assert process.ready_line.startswith("robot ready"), process.ready_line
            yield process
            process.terminate()
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()


class Peer:
    """Subscribes, publishes, calls; every wait spins and is bounded."""

    def __init__(self, domain_id):
        import rclpy
        from rclpy.experimental import EventsExecutor
        from rclpy.signals import SignalHandlerOptions

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("peer", context=self.context)
        self._executor = EventsExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._clients = {}
        self._answered = set()
        """Services that have answered: they know this client."""

    def close(self):
        self._executor.remove_node(self.node)
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def wait(self, condition, timeout=PATIENCE_S):
        """Spin until the condition gives something true, and return that; fails after `timeout` s."""
        end = time.monotonic() + timeout
        while not (found := condition()):
            assert time.monotonic() < end, f"waited {timeout} s in vain"
            self._executor.spin_once(timeout_sec=0.05)
        return found

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def subscribe(self, topic, message_type, qos=10):
        """All messages from now on, in a list that grows."""
        received = []
        self.node.create_subscription(interface(message_type), topic, received.append, qos)
        return received

    def next(self, topic, message_type, qos=10):
        """The next message that arrives."""
        received = self.subscribe(topic, message_type, qos)
        return self.wait(lambda: received and received[-1])

    def call(self, service, service_type, **fields):
        """The response to a request, which is repeated until the server has once answered this peer."""
        answers = []
        asks_at = time.monotonic()

        def answered():
            nonlocal asks_at
            if time.monotonic() >= asks_at:
                future = self.ask(service, service_type, **fields)
                future.add_done_callback(lambda future: answers.append(future.result()))
                asks_at = math.inf if service in self._answered else time.monotonic() + ASKS_AGAIN_S
            return answers

        answer = self.wait(answered)[0]
        self._answered.add(service)
        return answer

    def ask(self, service, service_type, **fields):
        """The future of the response to a request."""
        return self.client(service, service_type).call_async(interface(service_type).Request(**fields))

    def client(self, service, service_type):
        """A client that knows the service's server; the same for all calls."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(interface(service_type), service)
        self.wait(self._clients[service].service_is_ready)
        return self._clients[service]

    def set_parameter(self, node, name, value):
        from rclpy.parameter import Parameter

        wanted = [Parameter(name, value=value).to_parameter_msg()]
        return self.call(f"/{node}/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=wanted).results[0]

    def drive(self, linear, angular, seconds, until=lambda: False):
        """Publish a velocity command at 10 Hz for so long, once the robot listens, or until the condition holds."""
        from geometry_msgs.msg import Twist
        from rclpy.duration import Duration

        publisher = self.node.create_publisher(Twist, "cmd_vel", 1)
        self.wait(publisher.get_subscription_count)
        command = Twist()
        publisher.publish(command)
        self.wait(lambda: publisher.wait_for_all_acked(Duration(seconds=0)))  # the robot knows the publisher, too
        command.linear.x, command.angular.z = linear, angular
        for _ in range(round(seconds * 10)):
            if until():
                break
            publisher.publish(command)
            self.spin(0.1)
        self.node.destroy_publisher(publisher)


class Goals:
    """An action client that waits by spinning the peer."""

    def __init__(self, peer):
        from rclpy.action import ActionClient

        self._peer = peer
        self._type = interface("ros2_mcp_demo_interfaces/action/NavigateTo")
        self._client = ActionClient(peer.node, self._type, "navigate_to")
        self.feedback = []
        peer.wait(self._client.server_is_ready)

    def send(self, x, y, **more):
        future = self._client.send_goal_async(
            self._type.Goal(x=x, y=y, **more), lambda message: self.feedback.append(message.feedback)
        )
        self._peer.wait(future.done)
        return future.result()

    def result(self, handle, timeout=PATIENCE_S):
        future = handle.get_result_async()
        self._peer.wait(future.done, timeout)
        return future.result()

    def close(self):
        self._client.destroy()
