"""The stopper as a process: it sends the zeros where its bridge cannot, because that has died or hangs, and cancels
the goals where the server has died, too.

Its stdin is the lifeline (see `lifeline.py`): the end of it tells of the bridge's death, silence of a hang; that it is
stopped, the kernel tells. It has a participant of its own, and publishers that are matched before anything moves, so
that it discovers nobody when it has to act. There are two of them, which know nothing of each other and act alike.
See docs/decisions/0030-a-second-process-that-stops.md and 0062-a-third-party-that-stops.md.
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

# Five beats (BEAT_S of the lifeline): a bridge that is late by so much may hang. Decided.
SILENCE_S = 0.25
# A turn while something moves: so soon after it is one, a silence is seen. A turn that lasted for longer than two of
# them was this process's own lateness, and no silence of the bridge. Chosen.
TURN_S = 0.02
# While nothing moves: for late subscribers of topics, of which the bridge is told. Chosen.
IDLE_S = 0.25
# For so long after a new topic, turns are as short as matching: the first command waits for it. Chosen.
MATCHING_S = 2.0
MATCHING_TURN_S = 0.003
# After the bridge's death: a subscriber that has not been discovered announces itself every 3 s (decision 13).
LATE_S = 4.0
# In which a successor of the bridge is looked for, which takes over. Chosen: each time costs 0.1 ms a topic.
SUCCESSOR_EVERY_S = 0.1
# From its start to its end if ROS does not come up, as of the bridge; and beyond LATE_S, if something hangs at its end.
ROS_IS_UP_WITHIN_S = 30.0
GIVE_UP_AFTER_S = 1.0
READ_BYTES = 65536
# Of the calls that are left: as many as goals that may be left at a time.
CALLS = QoSProfile(depth=64)


def main(name: str, lifeline: int, told: int) -> NoReturn:
    """Run the stopper until its lifeline ends, and until the robot has been stopped then; `ps` shows that name."""
    survival.rename(name)
    survival.spare()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # it ends with its bridge, and not before it
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
    os._exit(0)  # no thread of the middleware holds up the end


class ZeroPublisher:
    """A publisher of zeros. It is an `Exit` of a velocity topic."""

    def __init__(self, node: Node, interface: Any, topic: str, kind: tuple[str, str]) -> None:
        wanted = {"reliability": kind[0], "durability": kind[1]}
        self.kind = kind
        self._raw = rcl.publisher(node, interface, topic, qos.profile(wanted, max_depth=1))

    def publish_zero(self, data: bytes) -> None:
        """Hand it to the middleware."""
        self._raw.publish_raw(data)

    def matched(self) -> int:
        """The number of subscribers that would get it now."""
        return self._raw.get_subscription_count()

    def has_all_matched(self) -> bool:
        """Is not waited for here."""
        return True

    def acknowledged(self) -> None:
        """Is not asked here."""

    def done(self) -> bool:
        """Whether nobody who acknowledges has still to do so."""
        return rcl.is_acknowledged(self._raw)

    def destroy(self) -> None:
        """End it."""
        self._raw.destroy_when_not_in_use()


class Call:
    """One that is left to be made where bridge and server are dead: it cancels a goal, or makes a vehicle stand."""

    def __init__(self, client: Client, request: Any, server: int) -> None:
        self._client = client
        self._request = request
        self._server = server
        self._is_made = False

    def make(self) -> None:
        """Once, as soon as its service is there and the server is gone: one that lives does it, or goes on."""
        if not self._is_made and _is_gone(self._server) and self._client.service_is_ready():
            self._is_made = True
            self._client.call_async(self._request)


class Stopper:
    """What it was told of each topic, and the zeros that it sends; single-threaded."""

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
        """Take in what the bridge tells, and stop what moves if it falls silent, until it has ended."""
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
        """A silence counts only as far as this process was there to hear it; a stop needs none (SIGSTOP; `t`, in which
        a debugger or profiler holds it for moments, is none).
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
        """The bridge is dead. Zeros now, and for whoever is discovered late, until its successor or another comes."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())  # whoever read it may have died, too
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
        """A call that is left to be made, or no longer. Its client is kept: the next goal of that action needs it."""
        if "service" not in told:
            self._calls.pop(told["call"], None)
            return
        name, type_name = key = told["service"], told["type"]
        interface = interfaces.load(type_name)
        request = rcl.deserialize(bytes.fromhex(told["body"]), interface.Request)
        if meaning(name, type_name).verb != "cancel" and not brakes(name, type_name, request):
            raise OperationError("bad_request", "it is no request that ends something")
        if key not in self._clients:
            self._clients[key] = rcl.client(self._node, interface, name, CALLS)
        self._calls[told["call"]] = Call(self._clients[key], request, told["server"])

    def _heed(self, told: dict[str, Any]) -> None:
        """One line of the bridge: what is to be known of a topic; one without publishers is not driven any more."""
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
        """Tell the bridge, if it still reads."""
        with suppress(OSError):
            os.write(self._told, json.dumps(line).encode() + b"\n")


def _is_gone(process: int) -> bool:
    """Whether a process of this machine has ended, though nobody may have asked for its end yet; of 0 and 1, which are
    no server (a container, a server that had ended before), it is not known.
    """
    return process > 1 and _state(process) in ("", "Z", "X")


def _state(process: int) -> str:
    """The state of a process of this machine, a letter as in proc_pid_stat(5); "" if there is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):  # the second if it ends while it is read
        return ""


def _untold(_topic: str, _frame_id: str) -> None:
    """Nobody here wants to know the frame of a command."""
