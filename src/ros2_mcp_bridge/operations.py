"""The operations that need ROS: a row of the table for each, and how each request gets its one answer."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ros2_mcp_bridge.epoch import Overtaken, StopEpoch
from ros2_mcp_bridge.exit.failsafes import FailSafes
from ros2_mcp_bridge.exit.lifeline import Lifeline
from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.exit.speed_limit import SpeedLimits
from ros2_mcp_bridge.exit.trajectories import topic_of
from ros2_mcp_bridge.exit.velocities import Velocities, VelocityTopic
from ros2_mcp_bridge.loop import Loop, Seldom, log_failure
from ros2_mcp_bridge.motion.cancelling import Cancelling
from ros2_mcp_bridge.motion.controller import Make
from ros2_mcp_bridge.motion.drive import Drive
from ros2_mcp_bridge.motion.motion import Motions
from ros2_mcp_bridge.motion.until import Until
from ros2_mcp_bridge.motion.watching import Watching
from ros2_mcp_bridge.request import Answer, Cancelled, OperationError, Request, Steps
from ros2_mcp_bridge.ros import interfaces, shared_memory
from ros2_mcp_bridge.ros.clock import CLOCK_TYPE, RobotClock
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.ros.joint_states import JointStates
from ros2_mcp_bridge.stream import Outbox
from ros2_mcp_bridge.topics.clients import Clients
from ros2_mcp_bridge.topics.publishers import Publisher, Publishers
from ros2_mcp_bridge.topics.relay import Relay, Relays
from ros2_mcp_bridge.topics.subscriptions import Subscriptions
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES
from ros2_mcp_common.policy.verbs import CANCEL_GOAL
from ros2_mcp_common.wire.protocol import (
    Empty,
    KeptOut,
    LatchSet,
    RelayStopReply,
    ServicesReply,
    StatsReply,
    StopReply,
    ZeroReply,
)

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node

# Operations that act until they are ended.
LASTING = ("repeat", "relay", "move")
# The controllers of motions, by kind.
MOTIONS: Mapping[str, Make] = {"drive": Drive, "until": Until.of}
# Operations that act once, as soon as they can, each with the argument that names what it acts on.
LEAVING = {"publish": "topic", "call": "service", "relay_feed": "name"}

Operation = Callable[[Request], "Answer | Steps[Answer]"]

# Often enough for entities that are destroyed after a minute without use.
EXPIRE_EVERY_S = 5.0
# The period of this check. A loss is permanent, and rare; a check reads the list of all mapped files, which takes 2 ms.
SHARED_MEMORY_CHECKED_EVERY_S = 2.0
# The longest wait for acknowledgements of what is sent last. It fits into the end of the process, which is enforced
# after 1 s (GIVE_UP_AFTER_S). With 0.3 s, one of 64 topics had no zero in 2 of 3 whole runs of the tests, under load.
ARRIVAL_S = 0.6
ARRIVAL_POLL_S = 0.005
# The period at which the latch is looked at: it is a file that other processes may set, which then ends what moves
# here. Each published message checks it besides. A look costs 5 µs. At rest, only the report to the server is later.
LATCH_LOOKED_AT_EVERY_S = 0.05
# The period at which zeros are repeated until they are acknowledged: ten times the usual delay.
ARRIVAL_AGAIN_S = 0.1


def load_types() -> None:
    """Import the types that every command and every stop needs, in advance, so that none of
    them waits for the imports.
    """
    for type_name in (*VELOCITY_TYPES, CLOCK_TYPE, CANCEL_GOAL):
        with suppress(OperationError):  # a robot need not have all of them
            interfaces.load(type_name)


class Operations:
    """Everything that needs ROS; used on the ROS thread. `node` is the bridge's own node.

    `table` is the table of operations, to which it adds its own; `lifeline` leads to the stoppers.
    """

    def __init__(
        self,
        *,
        node: Node,
        loop: Loop,
        outbox: Outbox,
        stops: StopEpoch,
        limiter: Limiter,
        table: dict[str, Operation],
        lifeline: Lifeline,
    ) -> None:
        limiter.start = partial(loop.start, finished=log_failure)
        loop.is_at_rest = self.is_at_rest
        self._node = node
        self._loop = loop
        self._outbox = outbox
        self._started = self._driven_asked_at = time.monotonic()
        self._requests: dict[int | None, Request] = {}
        self._stops = stops
        self._told_latch: tuple[str, str, float] | None = None
        self._kept_out = ""
        self._graph = Graph(node)
        self._clock = RobotClock(node, self._graph)
        self._lifeline = lifeline
        self._joint_states = JointStates(node)
        make = partial(topic_of, joint_states=self._joint_states)
        self._velocities = Velocities(self._clock, outbox.send, self._lifeline, make)
        self._limiter = limiter
        limiter.look_at_joints = self._joint_states.known
        self.failsafes = FailSafes(self.send_zeros)
        self._subscriptions = Subscriptions(node, self._graph, loop, outbox)
        self._speed_limits = SpeedLimits(node, self._graph, limiter)
        self._clients = Clients(node, self.failsafes, limiter, lifeline, self._speed_limits)
        loop.after_turn = self._clients.look
        self._joint_states.relied_on = self._velocities.moving_joints
        limits = {"limiter": limiter, "joint_states": self._joint_states}
        create = partial(Publisher, node=node, graph=self._graph, velocities=self._velocities, **limits)
        self._publishers = Publishers(self._velocities, create, outbox.send)
        motions = Motions(
            node=node,
            graph=self._graph,
            velocities=self._velocities,
            use=self._publishers.use,
            send_event=outbox.send,
            kinds=MOTIONS,
        )
        cancelling = Cancelling(node=node, graph=self._graph, clients=self._clients, send_event=outbox.send)
        self._relays = Relays(self._velocities, partial(Relay, node=node, graph=self._graph, loop=loop, create=create))
        self._table = table
        table.update(self._operations(motions, cancelling))
        for steps in (
            self._graph.settle(),
            self._expire(),
            self._obey_latch(),
            self._watch(),
            self._velocities.watch(),
            self._leave_when_shared_memory_is_lost(),
        ):
            loop.start(steps, log_failure)

    def _operations(self, motions: Motions, cancelling: Cancelling) -> dict[str, Operation]:
        """The operations that the server may request, by the name in a request."""
        return {
            "cancel": self._cancel,
            "topics": self._graph.topics,
            "counted": self._graph.counted,
            "services": self._services,
            "servers": self._graph.servers,
            "nodes": self._graph.nodes,
            "node": self._graph.node,
            "endpoints": self._graph.endpoints,
            "wait_endpoints": self._graph.wait_endpoints,
            "subscribe": self._subscriptions.subscribe,
            "unsubscribe": self._subscriptions.unsubscribe,
            "counts": self._subscriptions.counts_of,
            "publish": self._publishers.publish,
            "repeat": self._publishers.repeat,
            "repeat_stop": self._repeat_stop,
            "move": motions.move,
            "relay": self._relays.relay,
            "relay_feed": self._relays.feed,
            "relay_stop": self._relay_stop,
            "relays": self._relays.counts,
            "call": self._clients.call,
            "cancel_when": cancelling.cancel_when,
            "joint_states": self._joint_states.wait,
            "failsafe_publish": self._publishers.failsafe,
            "failsafe_call": self._clients.failsafe,
            "stop": self._stop,
            "zero": self._zero,
            "stats": self._stats,
        }

    def is_at_rest(self) -> bool:
        """Return whether no request is in progress and there are no velocity topics. Thread-safe."""
        return not (self._requests or self._velocities.has_topics)

    def send_zeros(self) -> None:
        """Send zeros on all driven topics, and wherever a command is in its hold time. Thread-safe."""
        self._velocities.send_zeros()
        self._limiter.end_held()

    def start(self, request: Request) -> None:
        """Start to work on a request; it is answered when the work is done."""
        was_coming = request in self._stops.coming
        self._stops.coming.pop(request, None)
        try:
            if request.op not in self._table:
                raise OperationError("bad_request", f"There is no operation {request.op!r}.")
            request.check_accepted()
            result = self._table[request.op](request)
        except Exception as error:  # noqa: BLE001 - whatever it is, it answers this request
            if was_coming and isinstance(error, Cancelled) and error.ended_by == "stop":
                self._stops.overtaken.append(request)
            self._finish(request, None, error)
            return
        if isinstance(result, Generator):
            self._loop.end_rest()
            self._requests[request.id] = request
            request.task = self._loop.start(result, partial(self._finish, request))
        else:
            self._finish(request, result, None)

    def end(self, executor: Executor) -> None:
        """Stop everything, and send what must be sent last."""
        pending = [*self.failsafes.carry_out(), *self._publishers.pool.entities().values(), *self._relays.publishers()]
        again_at = time.monotonic() + ARRIVAL_AGAIN_S
        deadline = time.monotonic() + ARRIVAL_S
        while time.monotonic() < deadline and not all(arrival.done() for arrival in pending):
            executor.spin_once(timeout_sec=ARRIVAL_POLL_S)
            if time.monotonic() >= again_at:
                self._velocities.send_missed_zeros()
                again_at = time.monotonic() + ARRIVAL_AGAIN_S
        self._velocities.look_for_rest()  # topics that have not come to rest are left to the stoppers
        self._lifeline.end()
        for kind in (
            self._publishers.pool,
            self._relays,
            self._subscriptions,
            self._clients.pool,
            self._speed_limits,
            self._clock,
            self._joint_states,
        ):
            kind.clear()
        self._lifeline.wait_end()

    def lapse(self) -> None:
        """End what the server moves, after the fail-safes: it was silent for longer than its link lease."""
        for acting in self._acting():
            acting.end("lease")

    def _watch(self) -> Steps[None]:
        """Return the steps of the watchdog."""
        watching = Watching(
            self._node,
            self._graph,
            latch=self._stops.latch,
            stop=self.failsafes.carry_out,
            keep_out=self._keep_out,
            began=self._limiter.watched_by,
            cancel_others=self._cancel_others,
        )
        return watching.watch(lambda: self._limiter.watch, self._is_driven, lambda: self.failsafes.has_goals)

    def _keep_out(self, reason: str) -> None:
        """End what drives the robot, because it is about to enter a keep-out zone. Later commands may drive it away."""
        self.failsafes.carry_out()
        for acting in self._acting():
            acting.end("keep_out")
        if reason != self._kept_out:
            sys.stderr.write(f"the watchdog ends what drives the robot: {reason}\n")
        self._outbox.send(KeptOut(event="kept_out", reason=reason))
        self._kept_out = reason

    def _cancel_others(self, reason: str) -> None:
        """Cancel goals of other clients that drive the robot towards a keep-out zone, if the policy allows it."""
        cancelled = [name for name in self._graph.moving_actions() if self._limiter.may_cancel(name)]
        for name in cancelled:
            self._loop.start(self._clients.cancel_all(name), log_failure)
        if cancelled and reason != self._kept_out:
            sys.stderr.write(f"the watchdog cancels the goals of {', '.join(cancelled)}: {reason}\n")
            self._outbox.send(KeptOut(event="kept_out", reason=reason))
        self._kept_out = reason

    def end_lasting(self) -> None:
        """End repeats, relays and motions, after the zeros, because a stopper has died.

        The next command starts a new stopper.
        """
        for lasting in [request for request in self._requests.values() if request.op in LASTING]:
            lasting.end("stopper")

    def _finish(self, request: Request, result: Answer, error: Exception | None) -> None:
        self._requests.pop(request.id, None)
        if _was_latched(result, error):
            self._tell_latch()  # before the answer: then the server knows who has set it, and why
        if error is not None:
            self._outbox.reply_error(request.id, error)
        elif isinstance(result, tuple):
            self._outbox.reply(request.id, *result)
        elif result is not None:  # None: the queue of samples sends this answer after them
            self._outbox.reply(request.id, result)

    def _services(self, request: Request) -> Steps[ServicesReply]:
        """Return the services, except services that are in the graph only because of a client of this bridge."""
        found, unserved = (yield from self._graph.services(request)), self._clients.unserved()
        served = [
            (name, [type_name for type_name in types if (name, type_name) not in unserved])
            for name, types in found["services"]
        ]
        return {"services": [(name, types) for name, types in served if types], "settled": found["settled"]}

    def _cancel(self, request: Request) -> Empty:
        target = self._requests.get(int(request.number("request")))
        if target is not None and target.op != "unsubscribe":
            target.end("cancel")
        return {}

    def _acting(self) -> list[Request]:
        """Return the requests that publish until they are ended, or that act and have not been sent yet."""
        return [
            request
            for request in self._requests.values()
            if request.op in LASTING or (request.acceptance and request.op in LEAVING and not request.has_left)
        ]

    def _stop(self, request: Request) -> Steps[StopReply]:
        """End all requests that were accepted before and have not been sent, then send zeros on every driven topic."""
        overtaken = self._stops.take_overtaken()
        ended = list(dict.fromkeys([*overtaken, *(acting for acting in self._acting() if acting.end("stop"))]))
        return self._stop_topics(request, ended)

    def _stop_topics(self, request: Request, ended: list[Overtaken]) -> Steps[StopReply]:
        ops = [found.op for found in ended]
        wait_match_s, wait_ack_s = request.number("wait_match_s", 0.0), request.number("wait_ack_s", 0.0)
        topics = yield from self._velocities.stop(self._velocities.driven(), wait_match_s, wait_ack_s)
        return {
            "repeats": ops.count("repeat"),
            "relays": ops.count("relay"),
            "dropped": [
                (found.op, found.text(LEAVING[found.op], default="?")) for found in ended if found.op in LEAVING
            ],
            "topics": topics,
        }

    def _zero(self, request: Request) -> Steps[ZeroReply]:
        """Send zeros on the named topics that are driven."""
        chosen = self._chosen(request)
        wait_match_s, wait_ack_s = request.number("wait_match_s", 0.0), request.number("wait_ack_s", 0.0)
        return {"topics": (yield from self._velocities.stop(chosen, wait_match_s, wait_ack_s))}

    def _chosen(self, request: Request) -> list[VelocityTopic]:
        names = request.texts("topics")
        return [topic for topic in self._velocities.driven() if topic.name in names and topic.needs_zero]

    def end_at_once(self, request: Request) -> None:
        """Carry out a request that ends something, without waiting for the imports that other requests need.

        It is carried out again, and answered, in its turn. It then also ends requests that were accepted before it but
        begin only then.
        """
        with suppress(OperationError):  # the error is answered in its turn
            if request.op == "zero":
                for topic in self._chosen(request):
                    topic.send_zero()
            else:
                self._table[request.op](request)

    def _repeat_stop(self, request: Request) -> Empty:
        """End one repeat or motion by its name."""
        name = request.text("name")
        for found in list(self._requests.values()):
            if found.op in ("repeat", "move") and found.has("name") and found.text("name") == name:
                found.end("cancel")
        return {}

    def _relay_stop(self, request: Request) -> RelayStopReply:
        """End one relay by its name."""
        name = request.text("name")
        relays = [found for found in self._requests.values() if found.op == "relay" and found.text("name") == name]
        request.ended += sum(relay.end("cancel") for relay in relays)
        return {"relays": request.ended}

    def _stats(self, _request: Request) -> StatsReply:
        return {
            "publishers": len(self._publishers.pool),
            "subscriptions": len(self._subscriptions),
            "clients": len(self._clients.pool),
            "threads": _count("/proc/self/task"),
            "open_files": _count("/proc/self/fd") - 1,
            "rss_bytes": int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"),
            "repeats": sum(found.op == "repeat" and found.has_left for found in self._requests.values()),
            "uptime_s": round(time.monotonic() - self._started, 3),
        }

    def _expire(self) -> Steps[None]:
        while True:
            yield Seldom(EXPIRE_EVERY_S)
            self._publishers.pool.expire()
            self._clients.pool.expire()

    def _is_driven(self) -> bool:
        """Return whether a command or goal of this server moves the robot, or has moved it since the last call."""
        since, self._driven_asked_at = self._driven_asked_at, time.monotonic()
        return self._velocities.have_moved(since) or self.failsafes.has_goals

    def _obey_latch(self) -> Steps[None]:
        """Steps that end all motion here when the latch is set: zeros first, then the rest.

        They do so even if the latch was reset before this check. Requests accepted after the reset continue.
        """
        latch, before = self._stops.latch, None
        while True:
            state = latch.look()
            seen = state.is_set, state.count  # an unreadable latch is set, with the count that it had
            if seen != before and (state.is_set or (before and state.count != before[1])):
                self.failsafes.carry_out()
                self._tell_latch()
                for acting in self._acting():
                    if acting.acceptance is None or acting.acceptance.overtaken_by():
                        acting.end("latch")
            before = seen
            yield Seldom(LATCH_LOOKED_AT_EVERY_S)

    def _tell_latch(self) -> None:
        """Report who set the latch and why, once: while it is set, it keeps its first cause."""
        state = self._stops.latch.look()
        if (cause := (state.by, state.reason, state.since)) != self._told_latch:
            # After a reset, the file does not say any more who had set it.
            by, reason = cause[:2] if state.is_set else ("somebody", f"it was reset at once, by {state.by}")
            self._outbox.send(LatchSet(event="latched", by=by, reason=reason, own=self._stops.latch.is_own))
        self._told_latch = cause

    def _leave_when_shared_memory_is_lost(self) -> Steps[None]:
        """Steps that end this process if its shared memory is lost; the server then starts another
        bridge, which receives again.
        """
        looked_at, domain_id = None, self._node.context.get_domain_id()
        while True:
            changed = shared_memory.newest_change()
            if (changed is None or changed != looked_at) and shared_memory.is_lost(domain_id):
                break
            looked_at = changed
            yield Seldom(SHARED_MEMORY_CHECKED_EVERY_S)
        sys.stderr.write("Other processes have replaced the shared memory that this bridge receives through.\n")
        os.kill(os.getpid(), signal.SIGTERM)


def _was_latched(result: Answer, error: Exception | None) -> bool:
    """Return whether the latch has ended or refused the request that is answered so."""
    if error is not None:
        return isinstance(error, Cancelled) and error.ended_by == "latch"
    return isinstance(result, Mapping) and result.get("ended_by") == "latch"


def _count(folder: str) -> int:
    return sum(1 for _ in Path(folder).iterdir())
