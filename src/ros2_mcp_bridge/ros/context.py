"""Joining and leaving ROS: the context, the node, the executor."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from ros2_mcp_bridge.ros import participants, rcl
from ros2_mcp_common.wire.protocol import PROTOCOL, Hello

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node

# How many more participants are tried. With four others present, 2 of 10 new participants discovered all of them at
# once (decision 13); three participants triple the chance.
MORE_CANDIDATES = 2
# The time for answers: participants on this machine answer an announcement after 0.2 to 1 ms (decision 13), on a busy
# machine later.
ANSWERED_S = 0.2
# rcl logs to stderr, which is the bridge's log, and writes no file on the robot.
WITHOUT_LOG_FILES = ["--ros-args", "--disable-external-lib-logs"]
# The polling period of this wait; each time reads the kernel's table of ports.
_LOOK_EVERY_S = 0.01


def enter(node_name: str) -> tuple[Node, Executor]:
    """Initialise ROS and create the bridge's node. Return it with its executor."""
    node = join(node_name)
    try:
        from rclpy.experimental.events_executor import EventsExecutor as BestExecutor
    except ImportError:  # before Jazzy
        from rclpy.executors import SingleThreadedExecutor as BestExecutor
    executor = BestExecutor(context=node.context)
    executor.add_node(node)
    return node, executor


def join(node_name: str) -> Node:
    """Initialise ROS and create a node with as few entities as possible.

    A participant that has not discovered all others on this machine at once discovers the rest only at their next
    announcement, up to 3 s later. Then more participants are tried, and the one that has discovered most is kept.
    """
    node = _new_node(node_name)
    deadline = time.monotonic() + ANSWERED_S
    while not (complete := participants.all_discovered(node)) and time.monotonic() <= deadline:
        time.sleep(_LOOK_EVERY_S)
    if not complete:
        nodes = [node, *(_new_node(node_name) for _ in range(MORE_CANDIDATES))]
        time.sleep(ANSWERED_S)
        node = max(nodes, key=participants.discovered)
        for other in nodes:
            if other is not node:
                destroy(other)
    return node


def leave(node: Node, executor: Executor) -> None:
    """Undo `enter`: the node disappears from the graph, and nothing of it stays in shared memory."""
    executor.remove_node(node)
    executor.shutdown()
    rcl.destroy_endpoints()
    destroy(node)


def hello(node: Node, executor: Executor) -> dict[str, object]:
    """Return the event that introduces this bridge to the server."""
    packages = Path(str(rclpy.__file__)).parent.parent
    wheels = (found.name.split("_")[1] for found in packages.glob("ros_*_rclpy-*.dist-info"))
    introduction = Hello(
        python=platform.python_version(),
        distro=os.environ.get("ROS_DISTRO") or next(wheels, ""),
        rmw=get_rmw_implementation_identifier(),
        domain_id=node.context.get_domain_id(),
        node=node.get_fully_qualified_name(),
        pid=os.getpid(),
        executor=type(executor).__name__,
    )
    return {"event": "hello", "protocol": PROTOCOL, **introduction._asdict()}


def _new_node(node_name: str) -> Node:
    context = Context()
    with _receiving_after_sending():
        rclpy.init(args=WITHOUT_LOG_FILES, context=context, signal_handler_options=SignalHandlerOptions.NO)
        return rclpy.create_node(
            node_name,
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )


@contextmanager
def _receiving_after_sending() -> Generator[None, None, None]:
    """A context manager in which newly started threads run only while the present thread waits: they share its
    processor at lower priority.

    A new participant of Fast DDS 2.14 announces itself a moment before it processes what its threads receive, so it
    misses answers that come within a fraction of a millisecond, as those from this machine do. See decision 13.
    """
    if not hasattr(os, "sched_setaffinity") or os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_OTHER:
        yield
        return
    processors = os.sched_getaffinity(0)
    with suppress(OSError):
        # The processor that this thread runs on (field 39 of its stat) is seldom one that others keep busy.
        after_name = Path("/proc/thread-self/stat").read_text().rpartition(")")[2]
        os.sched_setaffinity(0, {int(after_name.split()[36])})
        try:  # real-time priority for this thread alone, where that is allowed
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
        except PermissionError:  # otherwise batch for all: none preempts another
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    try:
        yield
    finally:
        for thread in Path("/proc/self/task").iterdir():
            with suppress(OSError):  # the thread may have ended meanwhile
                os.sched_setaffinity(int(thread.name), processors)
                os.sched_setscheduler(int(thread.name), os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))


def destroy(node: Node) -> None:
    """Undo `join`."""
    context = node.context
    node.destroy_node()
    context.try_shutdown()
