"""Whatever order the event loop runs tasks in, no goal, order or velocity precedes its fail-safe on the stream."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterator, Sequence
from dataclasses import replace
from typing import Any

import pytest

from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import Publish
from ros2_mcp.robot import Robot
from ros2_mcp_common.policy.flight import SET_MODE, vehicle_of
from ros2_mcp_common.wire.packets import Packet
from support.noting_bridge import CHOICE, DEFINITIONS, call, goal, on
from support.random_order import RandomOrder
from support.rounds import FULL
from support.stream_peer import HELLO, Peer
from support.tasks import soon

ARMING = "mavros_msgs/srv/CommandBool"
OF_VEHICLES = {
    SET_MODE: ("srv", "uint8 base_mode\nstring custom_mode\n---\nbool mode_sent\n"),
    ARMING: ("srv", "bool value\n---\nbool success\nuint8 result\n"),
}
SENT = {"matched": 1, "ours": 0, "acked": True, "created": False, "waited_s": 0.0, "limited": 0, "hold_s": 0.0}
SENT |= {"endpoints": (1, 1), "stopper_s": 0.0, "unguarded": "", "elapsed_s": 0.1}
ACCEPTED = b"\0\1\0\0\1" + bytes(11)
"""The response to a goal that is accepted; the one to an order that succeeds is its beginning."""
ACTING = ("failsafe_publish", "failsafe_call", "publish", "call")
MANY = 12
SEEDS = range(200 if FULL else 5)


class Answering(Peer):
    """A bridge in memory that carries everything out at once; `all_heard` keeps the order of what was written."""

    def __init__(self) -> None:
        super().__init__("alive")
        self.all_heard: list[Packet] = []

    def write(self, data: bytes) -> None:
        known = len(self.pings), len(self.heard)
        super().write(data)
        for header in self.pings[known[0] :]:
            self._answer(header, {"ros_idle_s": 0.0, "now_ns": header["sent_ns"], "sent_ns": header["sent_ns"]})
        for packet in self.heard[known[1] :]:
            self.all_heard.append(packet)
            op = packet.header["op"]
            if op == "definitions":
                texts = {name: {"format": kind, "text": text} for name, (kind, text) in ALL_DEFINITIONS.items()}
                self._answer(packet.header, {"missing": [], "definitions": texts})
            elif op == "endpoints":
                self._answer(packet.header, {"publishers": [], "subscribers": [], "settled": True})
            elif op in ("publish", "call"):
                self._answer(packet.header, SENT, ACCEPTED)

    def greet(self) -> None:
        self.say(HELLO)

    def _answer(self, header: Any, ok: dict[str, Any], body: bytes = b"") -> None:
        asyncio.get_running_loop().call_soon(self.say, {"id": header["id"], "ok": ok}, body)


ALL_DEFINITIONS = {**DEFINITIONS, **OF_VEHICLES}


def without_failsafe(heard: Sequence[Packet]) -> Iterator[str]:
    """What moves something, and which no fail-safe precedes that is still in force; checks that something moves."""
    in_force: dict[int, str] = {}
    moving = 0
    for header, body in heard:
        op = header["op"]
        if op == "cancel":
            in_force.pop(header["request"], None)
        elif op in ACTING and (moved := _moved(header, body)):
            if op.startswith("failsafe"):
                in_force[header["id"]] = moved
                continue
            moving += 1
            if moved not in in_force.values():
                yield moved
    assert moving >= 3 * MANY


def _moved(header: Any, body: bytes) -> str:
    if "topic" in header:
        return str(header["topic"])
    service = str(header.get("service", ""))
    if "/_action/" in service:
        return body[4:20].hex()  # the goal's id is the first field of both requests
    return vehicle_of(service, header["type"]) if service else ""


def commands(robot: Robot, first: int = 1) -> list[Coroutine[Any, Any, Any]]:
    """Goals, orders and velocities, as if many clients sent them at once; each velocity topic is driven twice."""
    publish = Publish(**on("/", value={}, choice=CHOICE, wait_match_s=0.0))
    return [
        *(robot.do(replace(goal(), goal_id=f"{number:032x}")) for number in range(first, first + MANY)),
        *(robot.do(call(ARMING, f"/uav{number}/mavros/cmd/arming", {"value": True})) for number in range(MANY)),
        *(robot.do(replace(publish, name=f"/base{number // 2}/cmd_vel")) for number in range(MANY)),
    ]


async def on_a_running_bridge() -> Sequence[Packet]:
    peer = Answering()
    bridge = Bridge(lambda: peer)
    async with bridge:
        await soon(lambda: peer.is_open)
        peer.greet()
        robot = Robot(bridge)
        await asyncio.gather(*commands(robot))
        robot.failsafes.close()
    return peer.all_heard


async def on_the_successor_of_a_lost_bridge() -> Sequence[Packet]:
    """The commands come while the successor begins; some topics were driven before."""
    peers = [Answering(), Answering()]
    waiting = iter(peers)
    bridge = Bridge(lambda: next(waiting))
    async with bridge:
        await soon(lambda: peers[0].is_open)
        peers[0].greet()
        robot = Robot(bridge)
        await asyncio.gather(*commands(robot))
        peers[0].end()
        await soon(lambda: peers[1].is_open)
        sending = asyncio.gather(*commands(robot, first=1 + MANY // 2))  # half of these goals run already
        peers[1].greet()
        await sending
        robot.failsafes.close()
    return peers[1].all_heard


@pytest.mark.parametrize("scene", [on_a_running_bridge, on_the_successor_of_a_lost_bridge])
@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_that_moves_precedes_its_fail_safe_in_whatever_order_tasks_run(scene: Any, seed: int) -> None:
    loop = RandomOrder(seed)
    try:
        heard = loop.run_until_complete(scene())
        left = asyncio.all_tasks(loop)
        for task in left:
            task.cancel()
        loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
    finally:
        loop.close()
    assert list(without_failsafe(heard)) == []
