"""The stopper: a process that sends the zeros if its bridge has died or hangs, and cancels the goals if
the server has died, too.

Its stdin is the lifeline (see `lifeline.py`). The end of the stream means that the bridge has died, silence that it
hangs; whether it is suspended (SIGSTOP), /proc says. The stopper has its own participant, and publishers that are
matched before anything moves, so that it need not wait for discovery when it has to act. There are two stoppers, which
do not know each other and do the same. See docs/decisions/0030-a-second-process-that-stops.md and
0062-a-third-party-that-stops.md.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rclpy.qos import QoSProfile

from ros2_mcp_bridge.exit.trajectories import topic_of
from ros2_mcp_bridge.exit.velocities import VelocityTopic, Zero
from ros2_mcp_bridge.request import OperationError
from ros2_mcp_bridge.ros import context as ros
from ros2_mcp_bridge.ros import interfaces, participants, qos, rcl
from ros2_mcp_bridge.ros.clock import RobotClock
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.ros.joint_states import JointStates
from ros2_mcp_bridge.stopper import survival, udp
from ros2_mcp_common.policy.flight import brakes
from ros2_mcp_common.policy.verbs import meaning

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.node import Node

# Five beats (BEAT_S of the lifeline): a bridge that is silent for so long while something moves may hang.
SILENCE_S = 0.25
# The period of turns while something moves, and so the delay with which a silence is noticed. If a turn took longer
# than two periods, this process itself was late, and the excess does not count as silence of the bridge.
TURN_S = 0.02
# The period of turns while nothing moves, in which late subscribers are noticed and reported to the bridge.
IDLE_S = 0.25
# For this long after a new topic, turns are as short as MATCHING_TURN_S, because the first command waits for the match.
MATCHING_S = 2.0
MATCHING_TURN_S = 0.003
# How long zeros are sent after the bridge's death: an undiscovered subscriber announces itself every 3 s (decision 13).
LATE_S = 4.0
# The period at which the topics are checked for a new publisher, which takes over from the bridge. A check costs 0.1 ms
# a topic.
SUCCESSOR_EVERY_S = 0.1
# After this time the stopper exits if ROS does not start; the bridge has the same limit.
ROS_IS_UP_WITHIN_S = 30.0
GIVE_UP_AFTER_S = 1.0
READ_BYTES = 65536
# As many calls as there can be goals to cancel at a time.
CALLS = QoSProfile(depth=64)


def main(name: str, lifeline: int, told: int) -> NoReturn:
    """Run the stopper until its lifeline ends and the robot has been stopped; `name` is shown by ps(1).

    Never returns.
    """
    survival.rename(name)
    survival.spare()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # it must not end before its bridge
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    os.set_blocking(told, False)
    bridge, first = os.getppid(), os.read(lifeline, READ_BYTES)
    if not first:  # nothing ever moved
        os._exit(0)
    signal.setitimer(signal.ITIMER_REAL, ROS_IS_UP_WITHIN_S)
    with udp.alone():
        node = ros.join(f"{participants.STOPPER_NODE}{os.getpid()}")
    survival.lock_memory()
    signal.setitimer(signal.ITIMER_REAL, 0)
    Stopper(node, bridge, lifeline, told).run(first)
    ros.destroy(node)
    sys.stderr.flush()
    os._exit(0)  # without waiting for threads of the middleware


class ZeroPublisher:
    """A publisher of zeros; implements `Exit` of a velocity topic."""

    def __init__(self, node: Node, interface: Any, topic: str, kind: tuple[str, str]) -> None:
        wanted = {"reliability": kind[0], "durability": kind[1]}
        self.kind = kind
        self._raw = rcl.publisher(node, interface, topic, qos.profile(wanted, max_depth=1))

    def publish_zero(self, data: bytes) -> None:
        """Publish this serialized zero."""
        self._raw.publish_raw(data)

    def matched(self) -> int:
        """Return the number of matched subscribers."""
        return self._raw.get_subscription_count()

    def has_all_matched(self) -> bool:
        """Return True: the stopper does not wait for matches."""
        return True

    def acknowledged(self) -> None:
        """Return None: the stopper does not use it."""

    def done(self) -> bool:
        """Return whether no acknowledgement is outstanding."""
        return rcl.is_acknowledged(self._raw)

    def destroy(self) -> None:
        """Destroy the publisher."""
        self._raw.destroy_when_not_in_use()


class Call:
    """A service call to be made if bridge and server are dead: it cancels a goal, or stops a vehicle."""

    def __init__(self, client: Client, request: Any, server: int) -> None:
        self._client = client
        self._request = request
        self._server = server
        self._is_made = False

    def make(self) -> None:
        """Make the call, once, as soon as its service is available and the server is gone.

        A living server acts itself.
        """
        if not self._is_made and _is_gone(self._server) and self._client.service_is_ready():
            self._is_made = True
            self._client.call_async(self._request)


class Stopper:
    """The state of each topic, as reported by the bridge, and the zeros sent for it. Single-threaded."""

    def __init__(self, node: Node, bridge: int, lifeline: int, told: int) -> None:
        self._node = node
        self._bridge = bridge
        self._lifeline = lifeline
        self._told = told
        self._poll = select.poll()
        self._poll.register(lifeline, select.POLLIN)
        self._begun = b""
        self._graph = Graph(node)
        self._clock = RobotClock(node, self._graph)
        self._joint_states = JointStates(node)
        self._topics: dict[tuple[str, str], VelocityTopic] = {}
        self._exits: dict[tuple[str, str, str, str], ZeroPublisher] = {}
        self._matched: dict[tuple[str, str], int] = {}
        self._clients: dict[tuple[str, str], Client] = {}
        self._calls: dict[int, Call] = {}
        self._matching_until = 0.0
        self._silent_s = 0.0
        self._zeros: list[Zero] = []

    def run(self, first: bytes) -> None:
        """Read the lifeline until it ends; stop what moves while the bridge is silent or suspended, and at the end."""
        self._take_in(first)
        looked_at = time.monotonic()
        while True:
            is_readable = bool(self._poll.poll(self._turn_s() * 1000))
            now = time.monotonic()
            if is_readable:
                piece = os.read(self._lifeline, READ_BYTES)
                if not piece:
                    break
                self._silent_s, self._zeros = 0.0, []
                self._take_in(piece)
            else:
                self._look_for_silence(now - looked_at)
            looked_at = time.monotonic()
            self._tell_matched()
        signal.setitimer(signal.ITIMER_REAL, LATE_S + GIVE_UP_AFTER_S)
        self._stop_for_good()

    def _turn_s(self) -> float:
        if time.monotonic() < self._matching_until:
            return MATCHING_TURN_S
        return TURN_S if self._moving() else IDLE_S

    def _moving(self) -> list[VelocityTopic]:
        return [topic for topic in self._topics.values() if topic.moves]

    def _look_for_silence(self, turn_s: float) -> None:
        """Add a turn to the silence of the bridge, and send zeros if the silence is too long
        or the bridge is suspended.

        A silence counts only as far as this process itself was not late. A suspended bridge (state `T`, SIGSTOP) counts
        at once; `t`, in which a debugger or profiler holds a process for moments, does not.
        """
        moving = self._moving()
        self._silent_s = self._silent_s + min(turn_s, 2 * TURN_S) if moving else 0.0
        if moving and not self._zeros:
            is_stopped = _state(self._bridge) == "T"
            if is_stopped or self._silent_s >= SILENCE_S:
                self._zeros = [Zero(topic) for topic in moving]
                self._tell({"why": "stopped" if is_stopped else f"silent for {self._silent_s:.3g} s"})
        for zero in self._zeros:
            zero.send()

    def _stop_for_good(self) -> None:
        """Stop what moves after the bridge's death: send zeros now, and to subscribers discovered within 4 s.

        A topic is left alone as soon as it has a new publisher: a new bridge, or another node that drives the robot. If
        the server is dead, too, the calls left to the stopper are made.
        """
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())  # its reader may have died, too
        zeros = [Zero(topic) for topic in self._moving()]
        before = {zero.topic: self._graph.publisher_gids(zero.topic.name) for zero in zeros}
        deadline, look_at = time.monotonic() + LATE_S, 0.0
        calls = list(self._calls.values())
        while (zeros or calls) and time.monotonic() < deadline:
            for call in calls:
                call.make()
            time.sleep(TURN_S)
            if time.monotonic() >= look_at:
                look_at = time.monotonic() + SUCCESSOR_EVERY_S
                zeros = [zero for zero in zeros if self._graph.publisher_gids(zero.topic.name) <= before[zero.topic]]
            for zero in zeros:
                zero.send()

    def _take_in(self, piece: bytes) -> None:
        *lines, self._begun = (self._begun + piece).split(b"\n")
        for line in filter(None, lines):
            told = json.loads(line)
            try:
                if "call" in told:
                    self._heed_call(told)
                else:
                    self._heed(told)
            except OperationError as error:
                what = told.get("topic") or told.get("service")
                sys.stderr.write(f"the stopper cannot stop {what}: {error.message}\n")

    def _heed_call(self, told: dict[str, Any]) -> None:
        """Add or remove a call to be made after a death.

        Its client is kept, because the next goal of that action needs it.
        """
        if "service" not in told:
            self._calls.pop(told["call"], None)
            return
        name, type_name = key = told["service"], told["type"]
        interface = interfaces.load(type_name)
        request = rcl.deserialize(bytes.fromhex(told["body"]), interface.Request)
        if meaning(name, type_name).verb != "cancel" and not brakes(name, type_name, request):
            raise OperationError("bad_request", "it is not a request that ends something")
        if key not in self._clients:
            self._clients[key] = rcl.client(self._node, interface, name, CALLS)
        self._calls[told["call"]] = Call(self._clients[key], request, told["server"])

    def _heed(self, told: dict[str, Any]) -> None:
        """Update a topic from one line of the bridge.

        A line without publishers says that the topic is no longer driven.
        """
        name, type_name = key = told["topic"], told["type"]
        wanted = {(*key, reliability, durability) for reliability, durability in told["profiles"]}
        for exit_key in [found for found in self._exits if found[:2] == key and found not in wanted]:
            self._topics[key].publishers.pop(self._exits[exit_key], None)
            self._exits.pop(exit_key).destroy()
        if not wanted:
            self._topics.pop(key, None)
            self._matched.pop(key, None)
            self._clock.forget(name)
            return
        interface = interfaces.load(type_name)
        if key not in self._topics:
            self._topics[key] = topic_of(
                name,
                type_name,
                interface,
                joint_states=self._joint_states,
                clock=self._clock,
                changed=_untold,
            )
        topic = self._topics[key]
        topic.frame_id, topic.joints, topic.moves = told["frame"], tuple(told["joints"]), told["moves"]
        if topic.is_stamped:
            self._clock.follow()
        for exit_key in wanted - self._exits.keys():
            self._exits[exit_key] = ZeroPublisher(self._node, interface, name, exit_key[2:])
            topic.publishers[self._exits[exit_key]] = None
            self._matching_until = time.monotonic() + MATCHING_S

    def _tell_matched(self) -> None:
        for key, topic in self._topics.items():
            if (matched := topic.matched()) != self._matched.get(key):
                self._matched[key] = matched
                self._tell({"topic": topic.name, "type": topic.type, "matched": matched})

    def _tell(self, line: dict[str, object]) -> None:
        """Send a line to the bridge, ignoring that it may no longer read."""
        with suppress(OSError):
            os.write(self._told, json.dumps(line).encode() + b"\n")


def _is_gone(process: int) -> bool:
    """Return whether a process of this machine has ended, reaped or not.

    For 0 and 1, which cannot be the server (a container, or a server that ended earlier), it
    is not known: return False.
    """
    return process > 1 and _state(process) in ("", "Z", "X")


def _state(process: int) -> str:
    """Return the state of a process of this machine as a letter of proc_pid_stat(5), or "" if
    there is no such process.
    """
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):  # the second if the process ends during the read
        return ""


def _untold(_topic: str, _frame_id: str) -> None:
    """Ignore a new frame of a command: the stopper reports none."""
