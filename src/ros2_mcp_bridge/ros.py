# pyright: basic
"""Entering and leaving ROS: the context, the node, the executor."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier, try_shutdown

from . import frames


def enter(node_name):
    """Initialise ROS and make the bridge's node, as light as it can be; returns node and executor."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(node_name, use_global_arguments=False, enable_rosout=False, start_parameter_services=False)
    executor = _new_executor()
    executor.add_node(node)
    return node, executor


def leave(node, executor):
    """Undo `enter`."""
    executor.remove_node(node)
    node.destroy_node()
    executor.shutdown()
    try_shutdown()


def hello(node, executor):
    """The event that tells the server who we are."""
    return {
        "event": "hello",
        "protocol": frames.PROTOCOL,
        "python": platform.python_version(),
        "distro": os.environ.get("ROS_DISTRO") or _distro_of_wheels(),
        "rmw": get_rmw_implementation_identifier(),
        "domain_id": node.context.get_domain_id(),
        "node": node.get_fully_qualified_name(),
        "pid": os.getpid(),
        "executor": type(executor).__name__,
    }


def _new_executor():
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:  # before Jazzy
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor()
    return EventsExecutor()


def _distro_of_wheels():
    packages = Path(str(rclpy.__file__)).parent.parent
    return next((found.name.split("_")[1] for found in packages.glob("ros_*_rclpy-*.dist-info")), "")
