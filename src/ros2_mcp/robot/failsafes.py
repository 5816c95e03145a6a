"""Fail-safes: what the bridge does for us when this process dies, however it dies.

A fail-safe is a request that stays open. The bridge carries it out when the stream ends or its link lease lapses;
withdrawing it cancels the request. Here too is what we have driven, so that it can be stopped.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import math
from collections import Counter
from collections.abc import AsyncGenerator, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import anyio

from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import BridgeLost, Refused, RobotError
from ros2_mcp.model.goals import CANCEL_TYPE, cancel_request
from ros2_mcp.model.qos import QoS
from ros2_mcp.robot.graph import NO_END_S, was_refused
from ros2_mcp_common.policy.flight import BRAKE_MODES, SET_MODE
from ros2_mcp_common.policy.velocity import MOTION_TYPES
from ros2_mcp_common.wire.limits import MAX_FAILSAFES
from ros2_mcp_common.wire.protocol import StoppedTopic, ZeroReply

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph
    from ros2_mcp.robot.values import Values

MATCH_S = 0.2
"""Before a zero: the publisher is there already, as it drove. Only one whose endpoint had expired needs a moment."""
ACKNOWLEDGED_S = 0.5
"""A reliable subscriber acknowledges a zero within milliseconds; what comes later is not confirmed."""
_LOOK_S = 1.0
"""For looking up who subscribes: the bridge knows it at once, unless discovery is still under way."""
ZERO_S = 3.0
"""For the answer about zeros, beyond these two: a bridge that is alive has given it long before."""
_STILL_S = 0.5
"""For the zero on a topic of others: its publisher is new, and subscribers match it within 0.2 s on one host."""
_AGAIN_S = 1.0
"""While no bridge can be started: how often it is asked for again. The link itself pauses between its attempts."""
_logger = logging.getLogger(__name__)


@dataclass(eq=False, slots=True)
class _Held:
    """What keeps one fail-safe in force; `is_needed` is set by each command."""

    qos: QoS
    is_needed: asyncio.Event = field(default_factory=asyncio.Event)
    task: asyncio.Task[None] | None = None


@dataclass(eq=False, slots=True, kw_only=True)
class Driven:
    """A velocity topic that this server has driven, with its fail-safes: one for each reliability and durability that
    it was driven with, as a publisher of one does not reach every subscriber that one of the other does.

    `owner` is who commanded it last, `users` whose commands are under way on it and how many, `commands` counts all.
    It is at rest once every subscriber has acknowledged a zero, or there is none, and nothing was commanded since;
    `has_ended` if the last command on it ended with a zero of which that is not known, or by itself. `joints` are those
    that were commanded, where it is trajectories of joints that it takes. Since the robot was last seen to stand:
    `takers` are the robot's nodes that subscribed when it was commanded, and `was_taken` says that a command reached a
    subscriber.
    """

    topic: str
    type: str
    owner: Principal
    commands: int = 0
    users: Counter[Principal] = field(default_factory=Counter[Principal])
    has_ended: bool = False
    is_at_rest: bool = False
    joints: Sequence[str] = ()
    takers: set[str] = field(default_factory=set[str])
    was_taken: bool = False
    held: dict[tuple[str, str], _Held] = field(default_factory=dict[tuple[str, str], _Held])

    def close(self) -> None:
        """Ends all that keeps its fail-safes in force."""
        for held in self.held.values():
            if held.task:
                held.task.cancel()


class Failsafes:
    """The fail-safes in force: a zero for each topic that is driven, a request to cancel for each goal by its id.

    Of too many goals the oldest one's is withdrawn. Of too many topics the next is refused: a fail-safe is only given
    up for a topic that is at rest.
    """

    def __init__(self, graph: Graph, values: Values) -> None:
        self._graph = graph
        self._values = values
        self._driven: dict[tuple[str, str], Driven] = {}
        self._goals: dict[str, asyncio.Task[None]] = {}
        self._flights: dict[str, list[asyncio.Task[None]]] = {}

    def close(self) -> None:
        """Ends all that keeps them in force; safe to call twice. The bridge has carried them out, or is to."""
        for driven in self.driven:
            driven.close()
        for task in itertools.chain(self._goals.values(), *self._flights.values()):
            task.cancel()
        self._driven.clear()
        self._goals.clear()
        self._flights.clear()

    # ── what is driven ─────────────────────────────────────────────────────────────────────────────────────────

    @property
    def driven(self) -> Sequence[Driven]:
        """Every velocity topic that this server has driven, but those that have given up their place at rest."""
        return list(self._driven.values())

    @property
    def moving(self) -> Sequence[str]:
        """The topics that have got no zero since they were commanded, as far as is known."""
        return sorted({driven.topic for driven in self.driven if not (driven.is_at_rest or driven.has_ended)})

    def owned(self, owner: Principal) -> Sequence[Driven]:
        """Those on which a command of this client is under way, and those that it was the last to command, that have
        got no zero since, and on which no command of another is under way.
        """
        return [
            driven
            for driven in self.driven
            if driven.users[owner]
            or (driven.owner == owner and not driven.users and not (driven.is_at_rest or driven.has_ended))
        ]

    def give_up(self, owner: Principal) -> Sequence[str]:
        """Takes from a client that has gone what it owns. Returns the topics to be zeroed: nobody else uses them."""
        topics: set[str] = set()
        for driven in self.driven:
            others = [user for user in driven.users if user != owner]
            if others and driven.owner == owner:
                driven.owner = others[-1]
            elif not others and driven in self.owned(owner):
                driven.has_ended = True  # what is to be sent now is not sent again and again if nobody acknowledges it
                topics.add(driven.topic)
        return sorted(topics)

    @asynccontextmanager
    async def driving(
        self, topic: str, type_name: str, qos: QoS, owner: Principal, joints: Collection[str] = ()
    ) -> AsyncGenerator[Driven | None, None]:
        """Around a command that publishes: leaves the fail-safe of a velocity topic before it, or of one that moves
        `joints`; no other type needs one.

        Raises:
            Refused: if it would be one topic more than there can be fail-safes, and none of them is at rest.
        """
        if type_name not in MOTION_TYPES:
            yield None
            return
        key = topic, type_name
        if key not in self._driven:
            await self._make_room()
        driven = self._driven.get(key)
        if driven is None:
            driven = self._driven[key] = Driven(topic=topic, type=type_name, owner=owner)
        if (qos.reliability, qos.durability) not in driven.held:
            held = driven.held[qos.reliability, qos.durability] = _Held(qos)
            held.task = asyncio.create_task(self._keep_driven(driven, held))
        driven.owner, driven.is_at_rest, driven.has_ended = owner, False, False
        driven.joints = tuple(dict.fromkeys((*driven.joints, *joints)))
        driven.takers |= {*self._graph.seen.subscribers(topic)}
        driven.commands += 1
        driven.users[owner] += 1
        for held in driven.held.values():
            held.is_needed.set()
        await asyncio.sleep(0)  # the fail-safe's task writes first: the stream keeps the order
        try:
            yield driven
        finally:
            driven.users -= Counter([owner])  # keeps no zeros

    def settled(self, topic: str, type_name: str) -> None:
        """Notes that what was commanded on a topic has come to its end by itself, and was seen there."""
        if driven := self._driven.get((topic, type_name)):
            driven.has_ended = not driven.users

    def stands(self, before: Mapping[tuple[str, str], int]) -> None:
        """Notes that the robot was seen to stand: a subscriber that leaves from now on leaves nothing moving, unless it
        was commanded since `before`.
        """
        for key, driven in self._driven.items():
            if not driven.users and driven.commands == before.get(key):
                driven.takers.clear()
                driven.was_taken = False

    def commands(self) -> Mapping[tuple[str, str], int]:
        """How many commands each topic has had: what `rest` is to be told, taken before zeros are asked for."""
        return {key: driven.commands for key, driven in self._driven.items()}

    async def rest(self, zeros: Sequence[StoppedTopic], before: Mapping[tuple[str, str], int]) -> None:
        """Notes which topics are at rest: those whose zero has arrived at every subscriber in the graph, unless they
        were commanded since `before`.
        """
        arrived = await asyncio.gather(*(self._has_arrived(zero) for zero in zeros))
        for zero in itertools.compress(zeros, arrived):
            key = zero["topic"], zero["type"]
            driven = self._driven.get(key)
            if driven and not driven.users and driven.commands == before.get(key):
                driven.is_at_rest = True

    async def _has_arrived(self, zero: StoppedTopic) -> bool:
        """Whether every subscriber in the graph is known to have got this zero; true where there is none."""
        if zero["matched"] and not zero["acked"]:
            return False
        try:
            present = await self._graph.endpoints(zero["topic"], _LOOK_S)
        except RobotError:
            return False
        return present.settled and zero["matched"] >= present.subscribers_of(zero["type"])

    async def zero(self, topics: Collection[str]) -> Sequence[StoppedTopic]:
        """Publishes the zero on some of these topics, and says what became of each. Raises as `Graph.ask`."""
        before = self.commands()
        reply = await self._graph.query(
            ZeroReply,
            "zero",
            topics=sorted(topics),
            wait_match_s=MATCH_S,
            wait_ack_s=ACKNOWLEDGED_S,
            timeout_s=MATCH_S + ACKNOWLEDGED_S + ZERO_S,
        )
        await self.rest(reply["topics"], before)
        return reply["topics"]

    async def still(self, topic: str, type_name: str) -> str:
        """Publishes the zero on a topic that this server has not driven, as one that another bridge has left moving.

        Returns:
            Why that could not be; empty where it was sent.
        """
        try:
            with anyio.move_on_after(_STILL_S):
                await self._graph.ask(
                    "failsafe_publish",
                    topic=topic,
                    type=type_name,
                    qos=QoS("reliable", "volatile").request(),
                    frame=self._graph.frame_id_of(topic),
                    joints=[],
                    now=True,
                    timeout_s=NO_END_S,
                )
        except RobotError as error:
            return str(error)
        return ""

    async def _make_room(self) -> None:
        """Lets a topic that is at rest give up its place, if there is no other place."""
        has_asked = False
        while len(self._driven) >= MAX_FAILSAFES:
            at_rest = next((driven for driven in self.driven if driven.is_at_rest), None)
            ended = {driven.topic for driven in self.driven if driven.has_ended and not driven.users}
            if at_rest:
                del self._driven[at_rest.topic, at_rest.type]
                at_rest.close()
            elif ended and not has_asked:
                has_asked = True
                await self.zero(ended)
            else:
                raise Refused(
                    f"This server drives {MAX_FAILSAFES} velocity topics already, the most that are stopped if it "
                    "dies. Nothing was sent.",
                    "Call ros2_stop: topics whose zero was acknowledged, or has no receiver, make room.",
                )

    async def _keep_driven(self, driven: Driven, held: _Held) -> None:
        """Keeps a fail-safe in force, in one bridge after the other. What a lost bridge left moving, its successor
        stops at once.
        """
        after_a_loss = is_told = False
        while True:
            held.is_needed.clear()
            try:
                await self._graph.ask(
                    "failsafe_publish",
                    topic=driven.topic,
                    type=driven.type,
                    qos=held.qos.request(),
                    frame=self._graph.frame_id_of(driven.topic),
                    joints=list(driven.joints),
                    now=after_a_loss and not driven.is_at_rest,
                    timeout_s=NO_END_S,
                )
            except BridgeLost:
                after_a_loss, is_told = True, False
            except RobotError as error:
                if self._graph.is_closed:
                    return
                if not is_told:  # of an outage once
                    _logger.warning("the fail-safe of %s is not in force: %s", driven.topic, error)
                is_told = not was_refused(error)
                after_a_loss = after_a_loss or not was_refused(error)
                with anyio.move_on_after(math.inf if was_refused(error) else _AGAIN_S):
                    await held.is_needed.wait()  # until the topic is commanded once more
            else:
                await held.is_needed.wait()

    # ── goals ──────────────────────────────────────────────────────────────────────────────────────────────────

    def leave_cancel(self, goal_id: str, action: str) -> None:
        """Before a goal is sent: leaves the request that cancels it. `CANCEL_TYPE` must have been learnt."""
        if goal_id in self._goals:
            return
        body = self._values.encode_known(f"{CANCEL_TYPE}_Request", cancel_request(goal_id))
        service = {"service": f"{action}/_action/cancel_goal", "type": CANCEL_TYPE}
        if len(self._goals) >= MAX_FAILSAFES:
            self.withdraw(next(iter(self._goals)))
        self._goals[goal_id] = asyncio.create_task(self._keep_cancel(goal_id, body, service))

    def withdraw(self, goal_id: str) -> None:
        """Takes the fail-safe of a goal back; without effect where there is none."""
        if goal_id in self._goals:
            self._goals.pop(goal_id).cancel()

    async def _keep_cancel(self, goal_id: str, body: bytes, service: Mapping[str, Any]) -> None:
        await self._keep_call(f"goal {goal_id}", body, service)
        self._goals.pop(goal_id, None)

    # ── flights ────────────────────────────────────────────────────────────────────────────────────────────────

    def leave_brake(self, vehicle: str) -> None:
        """Before an order to a vehicle: leaves the requests that make it stand. `SET_MODE` must have been learnt.

        All modes are sent, the best one last: an autopilot does not take those that it does not have.
        """
        if vehicle in self._flights:
            return
        service = {"service": f"{vehicle}/set_mode", "type": SET_MODE}
        self._flights[vehicle] = [
            asyncio.create_task(self._keep_call(f"flight {vehicle}", self._brake_body(mode), service))
            for mode in reversed(BRAKE_MODES)
        ]

    def withdraw_brake(self, vehicle: str) -> None:
        """Takes the fail-safe of a vehicle back; without effect where there is none."""
        for task in self._flights.pop(vehicle, ()):
            task.cancel()

    def _brake_body(self, mode: str) -> bytes:
        return self._values.encode_known(f"{SET_MODE}_Request", {"base_mode": 0, "custom_mode": mode})

    async def _keep_call(self, what: str, body: bytes, service: Mapping[str, Any]) -> None:
        """Keeps a request in force, in one bridge after the other."""
        is_told = False
        while True:
            try:
                await self._graph.ask("failsafe_call", body, timeout_s=NO_END_S, **service)
            except BridgeLost:
                is_told = False
                continue
            except RobotError as error:
                if not self._graph.is_closed:
                    if not is_told:  # of an outage once
                        _logger.warning("the fail-safe of %s is not in force: %s", what, error)
                    if not was_refused(error):  # nobody was reached: the next bridge is to have it
                        is_told = True
                        await anyio.sleep(_AGAIN_S)
                        continue
            return
