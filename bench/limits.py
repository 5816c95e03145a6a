"""The cost of a policy's limits: at the bridge's exit for one Twist, in a whole publish, and at the start."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from typing import Any

from .processes import ENVIRONMENT, ours
from .report import Row, p50, p99

TWIST, TOPIC = "geometry_msgs/msg/Twist", "/bench/cmd_vel"
QOS = {"reliability": "reliable", "durability": "volatile", "history": "keep_last", "depth": 1}


def rules() -> bytes:
    """Return rules like the profile `teleop-slow`: two norms, four zeros, ramps and a hold time, for any `cmd_vel`."""
    from ros2_mcp_common.policy.checks import Checks
    from ros2_mcp_common.policy.rules import Allowance, Limit, Ramp, Rules, RuleSet

    limit = Limit(
        rule="limits.slow",
        types=(TWIST, "geometry_msgs/msg/TwistStamped"),
        checks=Checks(norm={"linear": 0.2, "angular": 0.5}, zero=("linear.y", "linear.z", "angular.x", "angular.y")),
        ramp={"linear": Ramp(0.3, 1.0), "angular": Ramp(1.0, 2.0)},
        hold_s=0.5,
    )
    allowed = Allowance("allow[0]", "publish", ("/**/cmd_vel",), limit.types)
    return json.dumps(Rules("bench", (RuleSet("bench", (allowed,), (), (limit,)),)).as_json()).encode()


class _Middleware:
    """A middleware that discards what is published."""

    def publish_raw(self, data: bytes) -> None: ...

    def get_subscription_count(self) -> int:
        return 1


def _exit_seconds(count: int, *, limited: bool) -> list[float]:
    """Return the thread's CPU time in s for decoding, judging, stamping and serializing each of `count` Twists."""
    from ros2_mcp_bridge.exit.limiter import Limiter
    from ros2_mcp_bridge.exit.velocities import Velocities
    from ros2_mcp_bridge.request import Request
    from ros2_mcp_bridge.ros import interfaces, rcl
    from ros2_mcp_bridge.topics.publishers import Publisher

    limiter, nothing = Limiter(limited), _Middleware()
    if limited:
        limiter.take(rules())
    rcl.publisher = lambda *_: nothing
    request = Request({"id": 1, "op": "publish", "topic": TOPIC, "type": TWIST, "qos": {}}, b"")
    request.interface = interfaces.load(TWIST)
    given: Any = {"node": None, "graph": None, "velocities": Velocities(None, print), "limiter": limiter}  # type: ignore[arg-type]
    publisher = Publisher(**given, request=request)
    assert publisher.velocity
    publisher.velocity.holders[request] = None
    message = request.interface()
    message.linear.x, message.angular.z = 0.15, 0.3
    data, found = rcl.serialize(message), list[float]()
    for _ in range(count):
        started = time.thread_time()
        publisher.publish(publisher.outgoing(data, request), request)
        found.append(time.thread_time() - started)
    return found


def at_the_exit(count: int) -> list[Row]:
    """Measure the target of issue 12: at most 0.1 ms for 99 of 100 Twists, with all work at the exit."""
    limited = _exit_seconds(count, limited=True)
    free = _exit_seconds(count, limited=False)
    return [
        Row("a Twist at the exit under a policy, p99", p99(limited), "ms", 0.1, note=f"without: {p99(free):.3f} ms"),
        Row("a Twist at the exit under a policy, p50", p50(limited), "ms", note=f"without: {p50(free):.3f} ms"),
    ]


class _Bridge:
    """A bridge on a raw stream; use as a context manager."""

    def __init__(self, *options: str) -> None:
        from ros2_mcp_common.wire.packets import PacketReader

        command = [sys.executable, "-m", "ros2_mcp_bridge", *options]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, env=ENVIRONMENT, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
        self._reader, self._number = PacketReader(), 0

    def __enter__(self) -> _Bridge:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait(timeout=10)

    def send(self, op: str, body: bytes = b"", **arguments: Any) -> int:
        from ros2_mcp_common.wire.packets import pack

        assert self._process.stdin
        self._number += 1
        self._process.stdin.write(pack({"id": self._number, "op": op, **arguments}, body))
        self._process.stdin.flush()
        return self._number

    def answer(self, number: int) -> dict[str, Any]:
        assert self._process.stdout
        while True:
            for packet in self._reader.feed(os.read(self._process.stdout.fileno(), 1 << 20)):
                if packet.header.get("id") == number:
                    return packet.header["ok"]

    def drive(self, data: bytes) -> dict[str, Any]:
        return self.answer(self.send("publish", data, topic=TOPIC, type=TWIST, qos=QOS, epoch=0))


def publishes(rounds: int) -> list[Row]:
    """Measure the target of issue 12: at most 0.3 ms more for a publish, from the request to the bridge's answer."""
    from geometry_msgs.msg import Twist
    from rclpy.serialization import serialize_message

    message = Twist()
    message.linear.x = 0.15
    data, seconds = serialize_message(message), dict[str, list[float]](limited=[], free=[])
    with _Bridge("--under-policy") as limited, _Bridge() as free:
        limited.send("policy", rules())
        for bridge in (limited, free):
            bridge.send("failsafe_publish", topic=TOPIC, type=TWIST, qos=QOS)
            bridge.drive(data)
        turns = [("limited", limited), ("free", free)]
        for _ in range(rounds):
            turns.reverse()  # alternate the order: the second one finds the processor awake
            for name, bridge in turns:
                started = time.perf_counter()
                bridge.drive(data)
                seconds[name].append(time.perf_counter() - started)
    # The difference within each turn, so that other load on the machine affects both.
    more = p50([ruled - other for ruled, other in zip(seconds["limited"], seconds["free"], strict=True)])
    return [
        Row("publish of a Twist: more under a policy, p50", more, "ms", 0.3, note=f"of {p50(seconds['free']):.2f} ms")
    ]


async def initialize(rounds: int) -> Row:
    """Measure the target of issue 12: at most 30 ms more from the start of the server to the answer to `initialize`."""
    differences, free_s = list[float](), list[float]()
    options: tuple[tuple[str, ...], ...] = ((), ("--policy", "teleop-slow"))
    for _ in range(rounds + 1):
        seconds = dict[tuple[str, ...], float]()
        options = options[::-1]  # alternate the order: the second one finds the processor awake
        for chosen in options:
            client, started = ours(*chosen), time.perf_counter()
            async with client:
                await client.initialize()
                seconds[chosen] = time.perf_counter() - started
        free_s.append(seconds[()])
        differences.append(sum(seconds.values()) - 2 * seconds[()])
    note = f"of {p50(free_s[1:]):.0f} ms"  # the first round compiles modules
    return Row("initialize: more under a policy, p50", p50(differences[1:]), "ms", 30, note=note)


async def cost(full: bool) -> list[Row]:
    """Run all three measurements."""
    at_start = await initialize(20 if full else 5)
    return [*publishes(3000 if full else 500), *at_the_exit(100_000 if full else 10_000), at_start]
