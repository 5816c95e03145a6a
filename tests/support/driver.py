"""A raw client that drives: the ways in which this server moves a robot, each begun with one call."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample
from support.agent import Refusal, until
from support.observer import Observer
from support.raw_server import ANSWER_S, MODERN, RawServer
from support.velocities import HUGE, TWIST, speed

MOVING = 0.5
LONG_S = 60
"""Longer than any test lets a motion go on."""
COMES_UP_S = 90.0
"""A bridge may need 40 s on a busy machine, one behind ssh more, and then it has to discover the others."""
BAG = "moves"
BAG_NS = 1_700_000_000_000_000_000


class Driver(RawServer):
    """A server that drives; answers are kept by id, so that a long run costs no more than its last line."""

    def __init__(self, environment: dict[str, str], *options: str, command: list[str] | None = None) -> None:
        self.answers: dict[int | None, dict[str, Any]] = {}
        super().__init__(environment, *(options or ("--tools", "all")), command=command)
        self.begin(MODERN)

    def tool(self, name: str, **arguments: Any) -> int:
        """Begin a call; returns the id of the request."""
        return self.send("tools/call", name=name, arguments=arguments)

    def answer(self, request: int, within_s: float = ANSWER_S) -> dict[str, Any]:
        deadline = time.monotonic() + within_s
        while request not in self.answers:
            left = deadline - time.monotonic()
            assert left > 0 and self.process.poll() is None, f"no answer to request {request} within {within_s} s"
            self._listen(left)
        return self.answers.pop(request)

    def answered(self, request: int) -> bool:
        """Whether the answer to a request is there."""
        while self._listen(0.0):
            pass
        return request in self.answers

    def result(self, request: int, within_s: float = ANSWER_S) -> dict[str, Any]:
        """The structured content of an answer; raises `Refusal` with the text of an error."""
        answer = self.answer(request, within_s)
        if "error" in answer:
            raise Refusal(json.dumps(answer["error"]))
        if answer["result"].get("isError"):
            raise Refusal(answer["result"]["content"][0]["text"])
        return answer["result"]["structuredContent"]

    def do(self, name: str, **arguments: Any) -> dict[str, Any]:
        """A call and its structured content."""
        return self.result(self.tool(name, **arguments))

    def outcome(self, request: int, within_s: float = ANSWER_S) -> str:
        """What an answer says, whether error or not."""
        return json.dumps(self.answer(request, within_s))

    def stop(self) -> tuple[dict[str, Any], int]:
        """`ros2_stop`: its result, and when its answer was read (CLOCK_MONOTONIC, ns)."""
        answer = self.answer(self.tool("ros2_stop"))
        return answer["result"]["structuredContent"], time.monotonic_ns()

    def knows(self, topic: str, subscribers: int) -> None:
        """Wait until it has discovered so many subscribers of a topic."""

        def found() -> bool:
            try:
                return len(self.do("ros2_topic_info", topic_name=topic)["subscribers"]) >= subscribers
            except Refusal:
                return False

        until(found, COMES_UP_S)

    def bridge(self) -> int:
        """The process of its bridge, as soon as it has one."""

        def pid() -> int:
            try:
                return self.do("ros2_status")["bridge_pid"] or 0
            except Refusal:
                return 0

        return until(pid, COMES_UP_S)

    def hear(self) -> None:
        """Take in what it has said by now."""
        self._listen(0.0)

    def _listen(self, seconds: float) -> bool:
        heard = super()._listen(seconds)
        *whole, self.said = self.said.split(b"\n")
        for line in map(json.loads, filter(None, whole)):
            if "method" not in line:
                self.answers[line.get("id")] = line
        return heard

    def _write(self, message: dict[str, Any]) -> None:
        assert self.process.stdin
        self.process.stdin.write(json.dumps(message).replace(f'"{HUGE}"', "1e400").encode() + b"\n")
        self.process.stdin.flush()


def write_bag(folder: Path, messages: list[bytes], kind: str = TWIST, hz: float = 50.0, name: str = BAG) -> None:
    """A bag in which /cmd_vel has these messages, as CDR, at a rate."""
    (folder / name).mkdir(parents=True)
    writer = BagWriter(folder / name, name)
    writer.add_topic(StoredTopic("/cmd_vel", kind, None, "ros2msg", ""))
    for number, data in enumerate(messages):
        at_ns = BAG_NS + int(number * 1e9 / hz)
        writer.write("/cmd_vel", Sample(at_ns, at_ns, None, data))
    writer.close()


def repeat(server: Driver, observer: Observer, topic: str) -> int:
    """One message again and again."""
    return server.tool(
        "ros2_topic_publish",
        topic_name=topic,
        message_type=TWIST,
        data=speed(TWIST, MOVING),
        frequency=50,
        duration=LONG_S,
    )


def once(server: Driver, observer: Observer, topic: str) -> int:
    """One message."""
    return server.tool("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, MOVING))


def relay(server: Driver, observer: Observer, topic: str) -> int:
    """What comes on another topic, moved on by the bridge."""
    source = f"{topic}_source"
    observer.talk(topic=source, kind=TWIST, hz=50.0, value=MOVING)
    given = {"source_topic": source, "destination_topic": topic, "message_type": TWIST, "duration_sec": 0}
    return server.tool("ros2_relay_start", **given)


def feed(server: Driver, observer: Observer, topic: str) -> int:
    """What comes on another topic as another type, moved on by the server."""
    source = f"{topic}_source"
    observer.talk(topic=source, kind="geometry_msgs/msg/Vector3", hz=50.0, value=MOVING)
    given = {"source_topic": source, "destination_topic": topic, "message_type": "geometry_msgs/msg/Vector3"}
    given |= {"destination_type": TWIST, "mapping": {"linear.x": "x"}, "duration_sec": 0}
    return server.tool("ros2_relay_start", **given)


def playback(server: Driver, observer: Observer, topic: str) -> int:
    """The bag, again and again; it must be where the server reads bags."""
    return server.tool("ros2_bag_play", bag=BAG, remaps={"/cmd_vel": topic}, loop=True, force=True, wait_s=0)


def drive(server: Driver, observer: Observer, topic: str) -> int:
    """A motion, closed by an odometry that shows a robot on its way."""
    observer.travel(topic=f"{topic}_odom", hz=25.0, speed=MOVING)
    far = {"distance_m": 100, "speed": MOVING}  # further than any test lets a motion go on
    return server.tool("ros2_drive", topic_name=topic, odometry=f"{topic}_odom", **far)


def going_on(server: Driver, observer: Observer, topic: str, request: int) -> int:
    """Begin the drive of a topic anew as often as it has ended by itself, which it does where its odometry is silent
    for half a second, as on a busy machine. Returns the request that drives.
    """
    while not observer.moving(topic=topic):
        print("the drive ended by itself:", server.outcome(request))
        observer.hush(topic=f"{topic}_odom")
        observer.forget_topic(topic=topic)
        request = drive(server, observer, topic)
        observer.until_driven(topic)
    return request


def until_driven(server: Driver, observer: Observer, way: str, topic: str, request: int, of: int = 1) -> int:
    """Wait until so many subscribers of a topic were driven, and begin a drive anew that has ended by itself before:
    its odometry may be discovered late, or be silent. Returns the request that drives.
    """

    def are_driven() -> bool:
        nonlocal request
        if way == "drive" and server.answered(request):
            print("the drive ended by itself:", server.outcome(request))
            observer.hush(topic=f"{topic}_odom")
            request = drive(server, observer, topic)
        return sum(count >= 1 for count in observer.driven(topic=topic).values()) >= of

    until(are_driven, COMES_UP_S)
    return request


WAYS: dict[str, Callable[[Driver, Observer, str], int]] = {
    "repeat": repeat,
    "once": once,
    "relay": relay,
    "feed": feed,
    "playback": playback,
    "drive": drive,
}
"""The ways in which this server moves a robot; what a relay is fed with, or a motion goes by, goes on until `calm`."""
_numbers = itertools.count(1)


def fresh(name: str) -> str:
    """A name of a topic, service or action that nobody has used before."""
    return f"/{name}_{next(_numbers)}"


def calm(observer: Observer, topic: str) -> None:
    """End the source of a relay onto the topic, or the odometry of a motion, if there is one."""
    for source in (f"{topic}_source", f"{topic}_odom"):
        observer.hush(topic=source)
