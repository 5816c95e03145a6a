# pyright: basic
"""Entering and leaving ROS: the context, the node, the executor."""

from __future__ import annotations

import os
import platform
import time
from collections import Counter
from functools import reduce
from operator import or_
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from . import frames

CANDIDATES = 3
LISTENING_S = 0.5


def enter(node_name):
    """Initialise ROS and make the bridge's node, as light as it can be.

    Returns the node, its executor, and a `Counter` of all others that are known to be there, by name and namespace.

    A new participant of Fast DDS listens a moment later than it speaks. Whose answer it misses then, it does not see
    before their next announcement, up to 3 s later. So several begin, and the one that heard most stays.
    """
    is_fast_dds = get_rmw_implementation_identifier().startswith("rmw_fastrtps")
    nodes = [_new_node(node_name) for _ in range(CANDIDATES if is_fast_dds else 1)]
    if is_fast_dds:
        time.sleep(LISTENING_S)
    heard = [others(node) for node in nodes]
    best = nodes[max(range(len(nodes)), key=lambda number: sum(heard[number].values()))]
    for node in nodes:
        if node is not best:
            _destroy_node(node)
    executor = _new_executor(best.context)
    executor.add_node(best)
    return best, executor, reduce(or_, heard)


def others(node):
    """A `Counter` of the nodes that this one sees; several may share a name and namespace."""
    found = Counter(node.get_node_names_and_namespaces())
    del found[node.get_name(), node.get_namespace()]
    return found


def leave(node, executor):
    """Undo `enter`."""
    executor.remove_node(node)
    executor.shutdown()
    _destroy_node(node)


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


def _new_node(node_name):
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    return rclpy.create_node(
        node_name,
        context=context,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
    )


def _destroy_node(node):
    context = node.context
    node.destroy_node()
    context.try_shutdown()


def _new_executor(context):
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:  # before Jazzy
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def _distro_of_wheels():
    packages = Path(str(rclpy.__file__)).parent.parent
    return next((found.name.split("_")[1] for found in packages.glob("ros_*_rclpy-*.dist-info")), "")
