"""Fail-safes: what the bridge does for us when this process dies, however it dies.

A fail-safe is a request that stays open, and that is written before the command it is for. The bridge carries it out
when the stream ends or its link lease lapses; withdrawing it cancels the request. Here too is what we have driven, so
that it can be stopped.
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


class _Kept:
    """One fail-safe, kept in force in one bridge after the other until it is closed. `what` is its name in the log.

    `post` writes its request; it is told whether a bridge was lost that may have left something moving.
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
        """Before a command: writes the request again where no bridge has it, so that it precedes the command."""
        if not self._posted.is_open:
            self._post_again()
            self._was_posted_again.set()

    def close(self) -> None:
        """Withdraws it, before anything that is sent later."""
        self._task.cancel()
        self._posted.cancel()

    def _post_again(self) -> None:
        error = self._posted.error
        self._was_lost = self._was_lost or (isinstance(error, RobotError) and not was_refused(error))
        self._posted = self._post(self._was_lost)

    async def _keep(self) -> None:
        is_told = False
        while True:
            posted, wait_s = self._posted, math.inf  # what was refused is asked for again by the next command only
            self._was_posted_again.clear()
            try:
                await self._graph.reply_to(posted)
            except BridgeLost:
                is_told, wait_s = False, 0.0
            except RobotError as error:
                if self._graph.is_closed:
                    return
                if not is_told:  # of an outage once
                    _logger.warning("the fail-safe of %s is not in force: %s", self._what, error)
                if not was_refused(error):  # nobody was reached: the next bridge is to have it
                    is_told, wait_s = True, _AGAIN_S
            if wait_s:
                with anyio.move_on_after(wait_s):
                    await self._was_posted_again.wait()
            if self._posted is posted:
                self._post_again()


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
    held: dict[tuple[str, str], _Kept] = field(default_factory=dict[tuple[str, str], _Kept])

    def close(self) -> None:
        """Withdraws its fail-safes."""
        for held in self.held.values():
            held.close()


class Failsafes:
    """The fail-safes in force: a zero for each topic that is driven, a request to cancel for each goal by its id.

    Of too many goals the oldest one's is withdrawn. Of too many topics the next is refused: a fail-safe is only given
    up for a topic that is at rest.
    """

    def __init__(self, graph: Graph, values: Values) -> None:
        self._graph = graph
        self._values = values
        self._driven: dict[tuple[str, str], Driven] = {}
        self._goals: dict[str, _Kept] = {}
        self._flights: dict[str, list[_Kept]] = {}

    def close(self) -> None:
        """Ends all that keeps them in force; safe to call twice. The bridge has carried them out, or is to."""
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
        """Around a command that publishes: writes the fail-safe of a velocity topic, or of one that moves `joints`,
        before it; no other type needs one.

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

    def _post_zero(self, driven: Driven, qos: QoS, was_lost: bool) -> Posted:
        """What a lost bridge left moving, its successor stops at once."""
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
        """Before a goal is sent: writes the request that cancels it. `CANCEL_TYPE` must have been learnt."""
        if goal_id in self._goals:
            self._goals[goal_id].renew()
            return
        body = self._values.encode_known(f"{CANCEL_TYPE}_Request", cancel_request(goal_id))
        service = {"service": f"{action}/_action/cancel_goal", "type": CANCEL_TYPE}
        if len(self._goals) >= MAX_FAILSAFES:
            self.withdraw(next(iter(self._goals)))
        self._goals[goal_id] = self._kept_call(f"goal {goal_id}", body, service)

    def withdraw(self, goal_id: str) -> None:
        """Takes the fail-safe of a goal back; without effect where there is none."""
        if goal_id in self._goals:
            self._goals.pop(goal_id).close()

    # ── flights ────────────────────────────────────────────────────────────────────────────────────────────────

    def leave_brake(self, vehicle: str) -> None:
        """Before an order to a vehicle: writes the requests that make it stand. `SET_MODE` must have been learnt.

        All modes are sent, the best one last: an autopilot does not take those that it does not have.
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
        """Takes the fail-safe of a vehicle back; without effect where there is none."""
        for kept in self._flights.pop(vehicle, ()):
            kept.close()

    def _brake_body(self, mode: str) -> bytes:
        return self._values.encode_known(f"{SET_MODE}_Request", {"base_mode": 0, "custom_mode": mode})

    def _kept_call(self, what: str, body: bytes, service: Mapping[str, Any]) -> _Kept:
        return _Kept(self._graph, what, lambda _: self._graph.post("failsafe_call", body, **service))
