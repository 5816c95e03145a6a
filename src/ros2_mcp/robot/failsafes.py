"""Fail-safes: actions of the bridge if this process dies.

A fail-safe is a request that stays open and is written before the command that it belongs to. The bridge carries it out
when the stream ends or the link lease lapses; cancelling the request withdraws it. This module also tracks the topics
that this server has driven, so that they can be stopped.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import math
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
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
    from ros2_mcp.link.client import Posted
    from ros2_mcp.robot.graph import Graph
    from ros2_mcp.robot.values import Values

MATCH_S = 0.2
"""The time limit for a zero to match subscribers, in s: its publisher exists, because it published the command. Only a
publisher whose endpoint had expired needs a moment."""
ACKNOWLEDGED_S = 0.5
"""The time limit for acknowledgements, in s. A reliable subscriber acknowledges a zero within milliseconds; later
acknowledgements are not counted."""
_LOOK_S = 1.0
"""The time limit for looking up subscribers, in s: the bridge answers at once, unless discovery is still in
progress."""
ZERO_S = 3.0
"""The time limit for the reply about zeros, in s, beyond the matching and acknowledgement times; a bridge that lives
answers long before."""
_STILL_S = 0.5
"""The duration of the request for a zero on a topic that this server does not drive, in s: its publisher is new, and
subscribers match it within 0.2 s on one host."""
_AGAIN_S = 1.0
"""The period of attempts to post the request again while no bridge can be started, in s. The link has its own pauses
between starts."""
_logger = logging.getLogger(__name__)


class _Kept:
    """One fail-safe, kept in force across restarts of the bridge until it is closed. `what` names it in the log.

    `post` writes its request; its argument says whether a lost bridge may have left something moving.
    """

    def __init__(self, graph: Graph, what: str, post: Callable[[bool], Posted]) -> None:
        self._graph = graph
        self._what = what
        self._post = post
        self._was_lost = False
        self._was_posted_again = asyncio.Event()
        self._posted = post(False)
        self._task = asyncio.create_task(self._keep())

    def renew(self) -> None:
        """Write the request again if no bridge has it. Called before a command, so that the request precedes the
        command.
        """
        if not self._posted.is_open:
            self._post_again()
            self._was_posted_again.set()

    def close(self) -> None:
        """Withdraw the fail-safe, before anything that is sent later."""
        self._task.cancel()
        self._posted.cancel()

    def _post_again(self) -> None:
        error = self._posted.error
        self._was_lost = self._was_lost or (isinstance(error, RobotError) and not was_refused(error))
        self._posted = self._post(self._was_lost)

    async def _keep(self) -> None:
        is_told = False
        while True:
            posted, wait_s = self._posted, math.inf  # after a refusal only the next command posts the request again
            self._was_posted_again.clear()
            try:
                await self._graph.reply_to(posted)
            except BridgeLost:
                is_told, wait_s = False, 0.0
            except RobotError as error:
                if self._graph.is_closed:
                    return
                if not is_told:  # logged once per outage
                    _logger.warning("the fail-safe of %s is not in force: %s", self._what, error)
                if not was_refused(error):  # no bridge was reached: post it to the next one
                    is_told, wait_s = True, _AGAIN_S
            if wait_s:
                with anyio.move_on_after(wait_s):
                    await self._was_posted_again.wait()
            if self._posted is posted:
                self._post_again()


@dataclass(eq=False, slots=True, kw_only=True)
class Driven:
    """A velocity topic that this server has driven, with one fail-safe for each reliability and durability that it was
    driven with: a publisher with other QoS may not reach every subscriber.

    `owner` is the principal of the last command, `users` counts the commands in progress by principal, and `commands`
    counts all commands. `is_at_rest`: every subscriber has acknowledged a zero, or there is none, and no command
    followed. `has_ended`: the last command ended with a zero without such confirmation, or on its own. `joints` are the
    commanded joints, if the topic takes trajectories. `takers` and `was_taken` refer to the time since the robot was
    last observed still: the robot's nodes that subscribed when commands were sent, and whether a command reached a
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
    held: dict[tuple[str, str], _Kept] = field(default_factory=dict[tuple[str, str], _Kept])

    def close(self) -> None:
        """Withdraw the topic's fail-safes."""
        for held in self.held.values():
            held.close()


class Failsafes:
    """The fail-safes in force: a zero for each driven topic, a cancel request for each goal, brakes for each flight.

    Beyond the limit of goals, the oldest goal's fail-safe is withdrawn. Beyond the limit of topics, the next topic is
    refused: a topic loses its fail-safe only when it is at rest.
    """

    def __init__(self, graph: Graph, values: Values) -> None:
        self._graph = graph
        self._values = values
        self._driven: dict[tuple[str, str], Driven] = {}
        self._goals: dict[str, _Kept] = {}
        self._flights: dict[str, list[_Kept]] = {}

    def close(self) -> None:
        """Stop keeping all fail-safes in force. Safe to call twice. The bridge has carried them out by then, or
        will.
        """
        for driven in self.driven:
            driven.close()
        for kept in itertools.chain(self._goals.values(), *self._flights.values()):
            kept.close()
        self._driven.clear()
        self._goals.clear()
        self._flights.clear()

    # ── what is driven ─────────────────────────────────────────────────────────────────────────────────────────

    @property
    def driven(self) -> Sequence[Driven]:
        """The velocity topics that this server has driven, except topics that were dropped at rest to make room."""
        return list(self._driven.values())

    @property
    def moving(self) -> Sequence[str]:
        """The topics without a zero since their last command, as far as is known."""
        return sorted({driven.topic for driven in self.driven if not (driven.is_at_rest or driven.has_ended)})

    def owned(self, owner: Principal) -> Sequence[Driven]:
        """Return the topics that a client keeps moving.

        These are the topics on which one of its commands is in progress, and those whose last command it sent, if they
        got no zero since and no other client's command is in progress on them.
        """
        return [
            driven
            for driven in self.driven
            if driven.users[owner]
            or (driven.owner == owner and not driven.users and not (driven.is_at_rest or driven.has_ended))
        ]

    def give_up(self, owner: Principal) -> Sequence[str]:
        """Release what a disconnected client owns, and return the topics to be zeroed, which no other client uses."""
        topics: set[str] = set()
        for driven in self.driven:
            others = [user for user in driven.users if user != owner]
            if others and driven.owner == owner:
                driven.owner = others[-1]
            elif not others and driven in self.owned(owner):
                driven.has_ended = True  # the zero that is about to be sent is not repeated if it is never acknowledged
                topics.add(driven.topic)
        return sorted(topics)

    @asynccontextmanager
    async def driving(
        self, topic: str, type_name: str, qos: QoS, owner: Principal, joints: Collection[str] = ()
    ) -> AsyncGenerator[Driven | None, None]:
        """A context manager around a command that publishes: the fail-safe of a velocity topic, or of a topic that
        moves `joints`, is written first. Other types need none, and yield None.

        Raises:
            Refused: if the limit of fail-safes is reached, and no driven topic is at rest.
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
        driven.owner, driven.is_at_rest, driven.has_ended = owner, False, False
        driven.joints = tuple(dict.fromkeys((*driven.joints, *joints)))
        driven.takers |= {*self._graph.seen.subscribers(topic)}
        driven.commands += 1
        driven.users[owner] += 1
        for held in driven.held.values():
            held.renew()
        if (qos.reliability, qos.durability) not in driven.held:
            post = partial(self._post_zero, driven, qos)
            driven.held[qos.reliability, qos.durability] = _Kept(self._graph, topic, post)
        try:
            yield driven
        finally:
            driven.users -= Counter([owner])  # also removes entries with count zero

    def settled(self, topic: str, type_name: str) -> None:
        """Record that the motion commanded on a topic was observed to end on its own."""
        if driven := self._driven.get((topic, type_name)):
            driven.has_ended = not driven.users

    def stands(self, before: Mapping[tuple[str, str], int]) -> None:
        """Record that the robot was observed still: a subscriber that disappears later leaves nothing moving, unless
        the topic got a command after `before`.
        """
        for key, driven in self._driven.items():
            if not driven.users and driven.commands == before.get(key):
                driven.takers.clear()
                driven.was_taken = False

    def commands(self) -> Mapping[tuple[str, str], int]:
        """Return the number of commands of each topic so far. Taken before zeros are requested, it is the argument
        `before` of `rest`.
        """
        return {key: driven.commands for key, driven in self._driven.items()}

    async def rest(self, zeros: Sequence[StoppedTopic], before: Mapping[tuple[str, str], int]) -> None:
        """Mark a topic as at rest if its zero has reached every subscriber in the graph, and no command was sent since
        the counts in `before`, by topic and type.
        """
        arrived = await asyncio.gather(*(self._has_arrived(zero) for zero in zeros))
        for zero in itertools.compress(zeros, arrived):
            key = zero["topic"], zero["type"]
            driven = self._driven.get(key)
            if driven and not driven.users and driven.commands == before.get(key):
                driven.is_at_rest = True

    async def _has_arrived(self, zero: StoppedTopic) -> bool:
        """Return whether every subscriber in the graph has received this zero; true if there is none."""
        if zero["matched"] and not zero["acked"]:
            return False
        try:
            present = await self._graph.endpoints(zero["topic"], _LOOK_S)
        except RobotError:
            return False
        return present.settled and zero["matched"] >= present.subscribers_of(zero["type"])

    async def zero(self, topics: Collection[str]) -> Sequence[StoppedTopic]:
        """Publish the zero on these of the driven topics, and return the delivery on each. Raises as `Graph.ask`."""
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
        """Publish the zero on a topic that this server has not driven, such as a topic that another bridge left moving.

        Returns:
            The reason if that failed; "" if the zero was sent.
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
        """Drop a topic that is at rest if the limit is reached."""
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

    def _post_zero(self, driven: Driven, qos: QoS, was_lost: bool) -> Posted:
        """Post the zero of a topic. If a lost bridge left it moving, its successor publishes the zero at once."""
        return self._graph.post(
            "failsafe_publish",
            topic=driven.topic,
            type=driven.type,
            qos=qos.request(),
            frame=self._graph.frame_id_of(driven.topic),
            joints=list(driven.joints),
            now=was_lost and not driven.is_at_rest,
        )

    # ── goals ──────────────────────────────────────────────────────────────────────────────────────────────────

    def leave_cancel(self, goal_id: str, action: str) -> None:
        """Write the request that cancels a goal, before the goal is sent. `CANCEL_TYPE` must have been learnt."""
        if goal_id in self._goals:
            self._goals[goal_id].renew()
            return
        body = self._values.encode_known(f"{CANCEL_TYPE}_Request", cancel_request(goal_id))
        service = {"service": f"{action}/_action/cancel_goal", "type": CANCEL_TYPE}
        if len(self._goals) >= MAX_FAILSAFES:
            self.withdraw(next(iter(self._goals)))
        self._goals[goal_id] = self._kept_call(f"goal {goal_id}", body, service)

    def withdraw(self, goal_id: str) -> None:
        """Withdraw the fail-safe of a goal, if the goal has a fail-safe."""
        if goal_id in self._goals:
            self._goals.pop(goal_id).close()

    # ── flights ────────────────────────────────────────────────────────────────────────────────────────────────

    def leave_brake(self, vehicle: str) -> None:
        """Write the requests that make a vehicle hold its position, before an order to it. `SET_MODE` must have been
        learnt.

        All brake modes are requested, the best one last: an autopilot rejects the modes that it does not have.
        """
        if vehicle in self._flights:
            for kept in self._flights[vehicle]:
                kept.renew()
            return
        service = {"service": f"{vehicle}/set_mode", "type": SET_MODE}
        self._flights[vehicle] = [
            self._kept_call(f"flight {vehicle}", self._brake_body(mode), service) for mode in reversed(BRAKE_MODES)
        ]

    def withdraw_brake(self, vehicle: str) -> None:
        """Withdraw the fail-safe of a vehicle, if the vehicle has a fail-safe."""
        for kept in self._flights.pop(vehicle, ()):
            kept.close()

    def _brake_body(self, mode: str) -> bytes:
        return self._values.encode_known(f"{SET_MODE}_Request", {"base_mode": 0, "custom_mode": mode})

    def _kept_call(self, what: str, body: bytes, service: Mapping[str, Any]) -> _Kept:
        return _Kept(self._graph, what, lambda _: self._graph.post("failsafe_call", body, **service))
