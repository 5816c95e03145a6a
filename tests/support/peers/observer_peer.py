"""The independent observer: one JSON list per line in, one JSON value per line out.

It subscribes several times on one topic, keeps what every subscriber got and when, and offers what robots offer:
services and actions that may come late, sources of messages, a simulated clock. It knows ROS 2 and nothing of this
project. Times are CLOCK_MONOTONIC in ns, which all processes of a machine share.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import re
import struct
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from test_msgs.action import Fibonacci

from support.demo_robot import interface

DEPTH = 20_000
"""More than any test publishes before the observer takes it: what is lost here would not be judged."""
STEP_S = 0.02
"""How often an action looks whether it is cancelled."""
MOST_APART = 20
"""Where only this machine is searched, rmw_fastrtps asks the first 32 participants of a domain who they are; of two
later ones, neither ever discovers the other. A dozen are left for the servers of a test."""
ROUNDED_NS = 10
"""DDS has the time at which something was written in steps of 2**-32 s."""
NUMBERS = ("float", "double", "int", "uint", "byte", "octet")


@dataclass
class Heard:
    """One message that one subscriber got."""

    by: str
    topic: str
    at: int
    """When it arrived."""
    sent: int
    """When its publisher wrote it, as DDS stamped it."""
    written: int
    """The same by the wall clock (ns since 1970), as DDS has it: it orders messages of several publishers."""
    values: list[float]
    """Every number of the message but those of its header."""
    stamp: int | None
    """Of its header in ns; None where its type has none, or it cannot be decoded."""
    age_s: float | None
    """By how much its subscriber's clock, wall or simulated, was ahead of that stamp when it was written."""
    frame: str | None
    size: int
    """Of the message as it came, in bytes."""
    fault: str = ""
    """Why it could not be decoded."""

    @property
    def moves(self) -> bool:
        return bool(self.fault) or any(value != 0.0 for value in self.values)

    @property
    def is_finite(self) -> bool:
        return not self.fault and all(map(math.isfinite, self.values))


@dataclass
class Goal:
    """One goal that an action server of ours has got."""

    action: str
    asked: int
    ended: int = 0
    status: str = "executing"


class Place:
    """A node in a participant of its own, and the thread that serves it.

    None is destroyed before this process ends: to destroy one while another leaves can deadlock in Fast DDS 2.14
    (`set_listener` spins until a callback ends that waits for its lock), which hung 1 of some thousand rounds.
    """

    def __init__(self, name: str, *, sim_time: bool = False, serves: bool = False) -> None:
        self.sim_time = sim_time
        self.context = rclpy.Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        overrides = [Parameter("use_sim_time", value=True)] if sim_time else []
        self.node = Node(
            re.sub("[^a-z0-9_]", "_", f"observer_{name}"), context=self.context, parameter_overrides=overrides
        )
        threads = {"num_threads": 8} if serves else {}
        self.executor = (MultiThreadedExecutor if serves else SingleThreadedExecutor)(context=self.context, **threads)
        self.executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self.executor.shutdown(timeout_sec=0.5)
        self.context.try_shutdown()
        self._thread.join(1.0)

    def destroy(self) -> None:
        with contextlib.suppress(Exception):
            self.node.destroy_node()

    def _spin(self) -> None:
        while self.context.ok():  # rclpy's executor ends when a subscription that it waits for is destroyed
            with contextlib.suppress(ExternalShutdownException, InvalidHandle):
                self.executor.spin()


class Talker:
    """Does something at a rate, in a thread of its own, until it is ended."""

    def __init__(self, hz: float, act: Callable[[], None]) -> None:
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(1.0 / hz, act), daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Returns when what it was doing is done: whoever ends it may write what must come last."""
        self._done.set()
        self._thread.join()

    def _run(self, every_s: float, act: Callable[[], None]) -> None:
        while not self._done.wait(every_s):
            act()


@dataclass
class Subscriber:
    """One of them; `apart` if nobody shares its place."""

    handle: Any
    place: Place
    apart: bool
    topic: str
    best_effort: bool


@dataclass
class Observer:
    """Its public methods are the commands."""

    heard: list[Heard] = field(default_factory=list)
    subscribers: dict[str, Subscriber] = field(default_factory=dict)
    places: dict[str, Place] = field(default_factory=dict)
    apart: list[Place] = field(default_factory=list)
    """Places for one subscriber each; who leaves gives his to the next."""
    vacant: list[Place] = field(default_factory=list)
    talkers: dict[str, Talker] = field(default_factory=dict)
    publishers: dict[str, Any] = field(default_factory=dict)
    requests: dict[str, list[int]] = field(default_factory=dict)
    goals: list[Goal] = field(default_factory=list)
    ticks: list[tuple[int, int]] = field(default_factory=list)
    kept: list[Any] = field(default_factory=list)

    def place(self, name: str, **options: bool) -> Place:
        if name not in self.places:
            self.places[name] = Place(name, **options)
        return self.places[name]

    # ── subscribers ────────────────────────────────────────────────────────────────────────────────────────────

    def join(self, by: str, topic: str, kind: str, after_s: float = 0.0, **how: bool) -> None:
        """Subscribe under a name, now or after a while.

        how: `best_effort`; `apart`: in a participant of its own, which others discover as they would another process;
        `sim_time`: its node uses the simulated clock.
        """
        if after_s:
            threading.Timer(after_s, self._join, (by, topic, kind), how).start()
        else:
            self._join(by, topic, kind, **how)

    def leave(self, by: str) -> None:
        """Let a subscriber go; what it got is kept."""
        subscriber = self.subscribers.pop(by)
        subscriber.place.node.destroy_subscription(subscriber.handle)
        if subscriber.apart:
            self.vacant.append(subscriber.place)

    def joined(self) -> list[str]:
        """The names of all that subscribe."""
        return list(self.subscribers)

    def matched(self, by: str) -> int:
        """How many publishers a subscriber has discovered; -1 while it has not joined."""
        return self.subscribers[by].handle.get_publisher_count() if by in self.subscribers else -1

    def forget(self) -> None:
        """Forget what was heard so far, and the requests and goals."""
        self.heard, self.goals, self.requests = [], [], {name: [] for name in self.requests}

    def forget_topic(self, topic: str) -> None:
        """Forget what was heard on one topic."""
        self.heard = [one for one in self.heard if one.topic != topic]

    def messages(self, by: str = "", topic: str = "", after: int = 0) -> list[dict[str, Any]]:
        """What arrived, in order."""
        return [asdict(one) for one in self._found(by, topic) if one.at > after]

    def counts(self, topic: str = "") -> dict[str, int]:
        """How many messages each subscriber has got."""
        found = dict.fromkeys(self.subscribers, 0)
        for one in self._found("", topic):
            found[one.by] = found.get(one.by, 0) + 1
        return found

    def last(self, topic: str = "") -> dict[str, dict[str, Any]]:
        """The last message of each subscriber that got any."""
        return {one.by: asdict(one) for one in self._found("", topic)}

    def moving(self, topic: str = "") -> list[str]:
        """The subscribers whose last message moves the robot."""
        last = {one.by: one for one in self._found("", topic)}
        return sorted(by for by, one in last.items() if one.moves)

    def driven(self, topic: str = "") -> dict[str, int]:
        """How many messages that move the robot each subscriber has got."""
        found = dict.fromkeys(self.subscribers, 0)
        for one in self._found("", topic):
            found[one.by] = found.get(one.by, 0) + one.moves
        return found

    def moved(self, sent_after: int = 0, topic: str = "") -> list[dict[str, Any]]:
        """Messages that move the robot and were written after a time, at most the first hundred."""
        return [asdict(one) for one in self._found("", topic) if one.moves and one.sent > sent_after][:100]

    def unstopped(self, topic: str, since: int) -> list[str]:
        """What is wrong with the end of a motion: of each subscriber that was moved, the zero that it has not got, or
        what moves it and was written after that zero. `since` is a wall clock's (ns); the zero was written later.
        """
        wrong: list[str] = []
        for by in self._of(topic):
            mine = sorted(self._found(by, topic), key=lambda one: one.written)
            zero = next((one for one in mine if one.written > since and not one.moves), None)
            if zero is None:
                wrong += [f"{by}: no zero"] if any(one.moves for one in mine) else []
            else:
                wrong += [f"{by}: after its zero {one!r}" for one in mine if one.moves and one.written > zero.written]
        return wrong

    def behind(self, topic: str, since: int) -> list[str]:
        """The reliable subscribers that have no message yet that was written after that time (wall clock, ns)."""
        reliable = [by for by in self._of(topic) if not self.subscribers[by].best_effort]
        return [by for by in reliable if not any(one.written > since for one in self._found(by, topic))]

    def stamped_wrong(self, topic: str, since: int) -> list[str]:
        """Messages whose stamp is not of the moment in which they were written: after `since` (wall clock, ns), after
        the last motion before them was written, and before they were written themselves. A zero is written several
        times.
        """
        wrong: list[str] = []
        for by in self._of(topic):
            before = since
            for one in sorted(self._found(by, topic), key=lambda one: one.written):
                if one.stamp is None or not before - ROUNDED_NS <= one.stamp <= one.written + ROUNDED_NS:
                    wrong.append(repr(one))
                before = one.written if one.moves else before
        return wrong[:100]

    def untold(self, topic: str) -> list[str]:
        """Messages whose stamp is not what `/clock` had told when they were written, or is before that of the message
        before them.
        """
        wrong: list[str] = []
        for by in self._of(topic):
            before = 0
            for one in self._found(by, topic):
                is_told = any(told == one.stamp and at <= one.sent for at, told in self.ticks)
                wrong += [] if is_told and (one.stamp or 0) >= before else [repr(one)]
                before = one.stamp or 0
        return wrong[:100]

    def told(self) -> int:
        """What `/clock` has told last, in ns."""
        return self.ticks[-1][1]

    def unsound(self, topic: str = "") -> list[str]:
        """Messages that are not finite or cannot be decoded, as texts (JSON has no infinity), at most a hundred."""
        return [repr(one) for one in self._found("", topic) if not one.is_finite][:100]

    def misstamped(self, most_s: float, topic: str = "") -> list[str]:
        """Messages whose stamp is further than that from what the clock of their subscriber's node says."""
        found = (one for one in self._found("", topic) if one.age_s is not None and abs(one.age_s) > most_s)
        return [repr(one) for one in found][:100]

    def _found(self, by: str, topic: str) -> list[Heard]:
        return [one for one in list(self.heard) if by in ("", one.by) and topic in ("", one.topic)]

    def _of(self, topic: str) -> list[str]:
        return [by for by, one in list(self.subscribers.items()) if one.topic == topic]

    def _join(self, by: str, topic: str, kind: str, **how: bool) -> None:
        sim_time, apart = how.get("sim_time", False), how.get("apart", False)
        if apart:
            place = self._place_apart(sim_time)
        else:
            place = self.place("sim", sim_time=True) if sim_time else self.place("main")
        cls, node = interface(kind), place.node

        def hear(data: bytes, info: Any) -> None:
            self._hear(by, topic, node, cls, data, info)

        handle = node.create_subscription(cls, topic, hear, _profile(how.get("best_effort", False)), raw=True)
        self.subscribers[by] = Subscriber(handle, place, apart, topic, how.get("best_effort", False))

    def _place_apart(self, sim_time: bool) -> Place:
        for place in self.vacant:
            if place.sim_time == sim_time:
                self.vacant.remove(place)
                return place
        if len(self.apart) == MOST_APART:
            raise ValueError(f"{MOST_APART} subscribers are apart already, more would not be discovered")
        self.apart.append(Place(f"apart_{len(self.apart)}", sim_time=sim_time))
        return self.apart[-1]

    def _hear(self, by: str, topic: str, node: Node, cls: type, data: bytes, info: dict[str, int]) -> None:
        at, unix_ns, robot_ns = time.monotonic_ns(), time.time_ns(), node.get_clock().now().nanoseconds
        sent = at - (unix_ns - info["source_timestamp"]) if info["source_timestamp"] else at
        one = Heard(by, topic, at, sent, info["source_timestamp"], [], None, None, None, len(data))
        try:
            message = deserialize_message(data, cls)
        except Exception as error:  # noqa: BLE001 - rclpy raises what it likes
            one.fault = repr(error)
        else:
            one.values = _numbers(message)
            if hasattr(message, "header"):
                stamp = message.header.stamp
                one.stamp, one.frame = stamp.sec * 10**9 + stamp.nanosec, message.header.frame_id
                # By the time at which it was written, where that can be compared: a machine that is busy delivers late.
                if not node.get_parameter("use_sim_time").value and info["source_timestamp"]:
                    robot_ns = info["source_timestamp"]
                elif robot_ns:  # a node that has not heard the clock is at 0
                    robot_ns = next((told for at, told in reversed(self.ticks) if at <= sent), robot_ns)
                one.age_s = (robot_ns - one.stamp) / 1e9
        self.heard.append(one)

    # ── what a robot offers ────────────────────────────────────────────────────────────────────────────────────

    def serve(self, service: str, kind: str, after_s: float = 0.0, delay_s: float = 0.0) -> None:
        """Offer a service, now or after a while, which answers with defaults after a delay."""
        self.requests.setdefault(service, [])
        if after_s:
            threading.Timer(after_s, self._serve, (service, kind, delay_s)).start()
        else:
            self._serve(service, kind, delay_s)

    def asked(self, service: str) -> list[int]:
        """When each request came to a service."""
        return self.requests[service]

    def act(self, action: str, think_s: float = 0.0, accepts: bool = True, cancels: bool = True) -> None:
        """Offer a Fibonacci action: a goal is judged for `think_s` and lasts `order` / 10 s."""
        place = self.place("servers", serves=True)

        def judge(_request: Any) -> GoalResponse:
            self.goals.append(Goal(action, time.monotonic_ns()))
            time.sleep(think_s)
            return GoalResponse.ACCEPT if accepts else GoalResponse.REJECT

        def execute(handle: Any) -> Any:
            goal = next(one for one in self.goals if one.action == action and one.status == "executing")
            goal.status = "running"
            end = time.monotonic() + handle.request.order / 10
            while time.monotonic() < end and not handle.is_cancel_requested:
                time.sleep(STEP_S)
            cancelled = handle.is_cancel_requested
            handle.canceled() if cancelled else handle.succeed()
            goal.status, goal.ended = "canceled" if cancelled else "succeeded", time.monotonic_ns()
            return Fibonacci.Result()

        def cancel(_handle: Any) -> CancelResponse:
            return CancelResponse.ACCEPT if cancels else CancelResponse.REJECT

        server = ActionServer(
            place.node,
            Fibonacci,
            action,
            execute,
            goal_callback=judge,
            cancel_callback=cancel,
            callback_group=ReentrantCallbackGroup(),
        )
        self.kept.append(server)

    def goals_of(self, action: str) -> list[dict[str, Any]]:
        """The goals that came to an action."""
        return [asdict(goal) for goal in self.goals if goal.action == action]

    def talk(self, topic: str, kind: str, hz: float, value: float = 0.5) -> None:
        """Publish a message at a rate, all of whose numbers are the value, until `hush`."""
        publisher, message = self._publisher(topic, kind), interface(kind)()
        _fill(message, value)
        self.talkers[topic] = Talker(hz, lambda: publisher.publish(message))

    def travel(self, topic: str, hz: float, speed: float) -> None:
        """Tell the odometry of a robot that drives along x at that speed (m/s), whatever it is told, until `hush`."""
        publisher = self._publisher(topic, "nav_msgs/msg/Odometry")
        message, began = interface("nav_msgs/msg/Odometry")(), time.monotonic()

        def tell() -> None:
            message.pose.pose.position.x = speed * (time.monotonic() - began)
            publisher.publish(message)

        self.talkers[topic] = Talker(hz, tell)

    def hush(self, topic: str) -> None:
        """End what publishes at a rate, if anything does; nothing of it is written after that."""
        if talker := self.talkers.pop(topic, None):
            talker.end()

    def pictures(self, topic: str, size: int, hz: float) -> None:
        """Publish images of a size in bytes at a rate, until `hush`."""
        cls = interface("sensor_msgs/msg/Image")
        message = cls(height=size // 1000, width=1000, step=1000, encoding="mono8", data=bytes(size))
        self._repeat(topic, "sensor_msgs/msg/Image", [message], hz)

    def large(self, poses: str, cloud: str, grid: str, hz: float) -> None:
        """Publish 20,000 poses of which one changes each time (1.1 MB), a cloud of as many points, and a map of a
        million cells, on these topics at a rate, until `hush`.
        """
        array, points = interface("geometry_msgs/msg/PoseArray"), interface("sensor_msgs/msg/PointCloud2")
        pose, field = interface("geometry_msgs/msg/Pose"), interface("sensor_msgs/msg/PointField")
        several = [array(poses=[pose()] * 20_000), array(poses=[pose()] * 20_000)]
        several[1].header.frame_id = "other"
        axes = [field(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
        made = struct.pack("<60000f", *(math.sin(at) for at in range(60_000)))
        seen = points(height=1, width=20_000, fields=axes, point_step=12, row_step=240_000, data=made)
        cells = interface("nav_msgs/msg/OccupancyGrid")()
        cells.info.resolution, cells.info.width, cells.info.height, cells.data = 0.05, 1000, 1000, [0] * 1_000_000
        self._repeat(poses, "geometry_msgs/msg/PoseArray", several, hz)
        self._repeat(cloud, "sensor_msgs/msg/PointCloud2", [seen], hz)
        self._repeat(grid, "nav_msgs/msg/OccupancyGrid", [cells], hz)

    def offer(self, topic: str, kind: str) -> None:
        """Have a publisher that says nothing yet."""
        self._publisher(topic, kind)

    def listeners(self, topic: str) -> int:
        """How many subscribers a publisher of ours has."""
        return self.publishers[topic].get_subscription_count()

    def say(self, topic: str, kind: str, bodies: list[str], gap_s: float = 0.0) -> None:
        """Publish messages that are given as CDR in hexadecimal digits, whatever is in them."""
        publisher = self._publisher(topic, kind)
        for body in bodies:
            with contextlib.suppress(RCLError):  # even the middleware refuses some
                publisher.publish(bytes.fromhex(body))
            time.sleep(gap_s)

    def clock(self, factor: float, hz: float = 200.0, start_s: float = 1000.0) -> None:
        """Publish `/clock`, which runs so many times as fast as the machine's, until the factor is 0."""
        self.hush("/clock")
        if not factor:
            return
        publisher, began = self._publisher("/clock", "rosgraph_msgs/msg/Clock"), time.monotonic_ns()

        def tick() -> None:
            now = time.monotonic_ns()
            told = int(start_s * 1e9 + (now - began) * factor)
            self.ticks.append((now, told))
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(told, 10**9)
            publisher.publish(message)

        self.talkers["/clock"] = Talker(hz, tick)

    def _repeat(self, topic: str, kind: str, messages: list[Any], hz: float) -> None:
        """Publish these in turn at a rate, until `hush`."""
        publisher = self._publisher(topic, kind)
        bodies = itertools.cycle([serialize_message(message) for message in messages])
        self.talkers[topic] = Talker(hz, lambda: publisher.publish(next(bodies)))

    def _publisher(self, topic: str, kind: str) -> Any:
        if topic not in self.publishers:
            node = self.place("main").node
            self.publishers[topic] = node.create_publisher(interface(kind), topic, _profile(False))
        return self.publishers[topic]

    def _serve(self, service: str, kind: str, delay_s: float) -> None:
        def answer(_request: Any, response: Any) -> Any:
            self.requests[service].append(time.monotonic_ns())
            time.sleep(delay_s)
            return response

        place = self.place("servers", serves=True)
        cls = interface(kind)
        every_call = QoSProfile(depth=500, reliability=QoSReliabilityPolicy.RELIABLE)  # of 200; 10 lose some
        group = ReentrantCallbackGroup()
        self.kept.append(place.node.create_service(cls, service, answer, qos_profile=every_call, callback_group=group))

    def close(self) -> None:
        for topic in list(self.talkers):
            self.hush(topic)
        places = (*self.apart, *self.places.values())
        for place in places:
            place.close()
        for place in places:
            place.destroy()


def _numbers(message: Any) -> list[float]:
    found: list[float] = []
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if name == "header":
            continue
        if hasattr(value, "get_fields_and_field_types"):
            found += _numbers(value)
        elif kind.startswith(NUMBERS) and not hasattr(value, "__len__"):
            found.append(float(value))
    return found


def _fill(message: Any, value: float) -> None:
    for name, kind in message.get_fields_and_field_types().items():
        inner = getattr(message, name)
        if name != "header" and hasattr(inner, "get_fields_and_field_types"):
            _fill(inner, value)
        elif kind in ("float", "double"):
            setattr(message, name, value)


def _profile(best_effort: bool) -> QoSProfile:
    return QoSProfile(
        depth=DEPTH,
        reliability=QoSReliabilityPolicy.BEST_EFFORT if best_effort else QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.VOLATILE,
    )


def cdr(kind: str, value: float) -> str:
    """A message all of whose numbers are the value, as hexadecimal digits."""
    message = interface(kind)()
    _fill(message, value)
    return serialize_message(message).hex()


def main() -> None:
    observer = Observer()
    lines = sys.stdout
    print('"ready"', file=lines, flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(observer, command)(**arguments)), file=lines, flush=True)
    observer.close()


if __name__ == "__main__":
    main()
