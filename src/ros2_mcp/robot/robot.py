"""The robot: reading by name and value, and `do`, the only way to act."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.guard import Guard
from ros2_mcp.guard.policy import Policy
from ros2_mcp.model import commands, names, qos
from ros2_mcp.model.commands import SERVER, Answer, Command, Principal, R
from ros2_mcp.model.errors import Refused, Rehearsed, RobotError
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.text import named
from ros2_mcp.robot import flights, goals, publishing, services
from ros2_mcp.robot.beginnings import Beginnings
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.facts import facts_of
from ros2_mcp.robot.failsafes import ACKNOWLEDGED_S, MATCH_S, ZERO_S
from ros2_mcp.robot.graph import Graph
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.joints import MOST_DESCRIPTION_BYTES, TEXT, RobotJoints
from ros2_mcp.robot.kept import Kept, KeptByRooms
from ros2_mcp.robot.listening import Listening, subscribed_while
from ros2_mcp.robot.log import LogRing
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp.robot.session import Session
from ros2_mcp.robot.transforms import TransformListener
from ros2_mcp.robot.translation import as_meant
from ros2_mcp.robot.values import Values
from ros2_mcp_common.policy.verbs import only_reads
from ros2_mcp_common.wire.protocol import Keep, StoppedTopic, StopReply

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge, Subscription
    from ros2_mcp.model.qos import Choice

MAX_WAITING = 20_000
MAX_WAITING_BYTES = 64_000_000
"""Bounds on the waiting samples of one subscription: 20 s of a topic at 1,000 Hz, or a second of raw camera images.
Beyond, the oldest samples are dropped and counted."""
_BACKLOG_BYTES = 1_000_000
"""Bound on the samples that wait in the bridge if a network lies between: 1.6 s at 5 Mbit/s. Of larger images only the
newest one waits."""
_DEPTH = 1000
"""The queue of the middleware covers the time between two turns of the bridge (docs/decisions/0007)."""
_MOST_REMEMBERED = 256
"""The most topics whose last subscription is remembered: more than are read repeatedly."""


async def _nothing(_core: Core, _prepared: Prepared[Any]) -> None:
    """Do nothing: a recording needs a decision only, and sends nothing to the robot."""


_EXECUTORS: Mapping[type[Command[Any]], Callable[[Core, Prepared[Any]], Awaitable[Any]]] = {
    commands.Publish: publishing.publish,
    commands.Repeat: publishing.repeat,
    commands.Move: publishing.move,
    commands.Relay: publishing.relay,
    commands.Play: publishing.relay,
    commands.Feed: publishing.feed,
    commands.Record: _nothing,
    commands.ServiceCall: flights.call,
    commands.SetParameters: services.call,
    commands.ChangeState: services.call,
    commands.SendGoal: goals.send,
    commands.CancelGoals: services.call,
}
"""The function that carries out each command once it is allowed: it establishes the fail-safe, and sends the bytes."""
_PUBLISHING = (commands.Publish, commands.Repeat, commands.Relay, commands.Play)
_NEVER_STOPPED = (commands.CancelGoals, commands.Record)
"""Commands that no stop holds back: the first command stops; the second writes files and sends nothing."""
_logger = logging.getLogger(__name__)


def _ends_own_goal(core: Core, command: Command[Any]) -> bool:
    """Return whether a command cancels one goal that this server sent, and no other: such a command is never
    held back.
    """
    if not isinstance(command, commands.CancelGoals) or any((command.stamp or {}).values()):
        return False  # with a time, all goals that were accepted before it are cancelled as well
    own = core.jobs.get(goals.Goal, command.goal_id)
    return own is not None and own.action == command.name


def _check_room(core: Core, command: Command[Any]) -> None:
    """Raise `Refused` if a motion by feedback has sole use of the topic: other messages between its commands would
    bypass its guard distance.
    """
    if not isinstance(command, _PUBLISHING):
        return
    for job in core.jobs.running(Job):
        if job.has_its_topics_alone and command.name in job.moves:
            raise Refused(
                f"{job.id} has sole use of {named(command.name)} until it ends: nothing was sent.",
                "Wait until it ends, or end it with ros2_stop.",
            )


def _check_action_topic(command: Command[Any]) -> None:
    """Raise `Refused` for topics that only an action server may publish. A stop relies on the status of goals: a forged
    status would make it forget a goal that still moves the robot.
    """
    if isinstance(command, _PUBLISHING) and names.is_of_action(command.name):
        raise Refused(
            f"{named(command.name)} is published by the server of an action: nothing was sent.",
            "ros2_send_action_goal and ros2_cancel_action_goal speak to that server.",
        )


class Robot(Core):
    """One robot, shared by all callers: its graph, its definitions, its topics, services and actions.

    `kept` has the objects that rooms keep for the robot. Everything that acts belongs to a `Session`.
    """

    def __init__(
        self,
        bridge: Bridge,
        guard: Guard | None = None,
        keeps: Iterable[Kept] = (),
        *,
        graph: Graph | None = None,
        values: Values | None = None,
    ) -> None:
        super().__init__(bridge, graph, values)
        self.guard = guard or Guard()
        self.log = LogRing(bridge)
        self.transforms = TransformListener(bridge, self.graph, self.values)
        self._joints = RobotJoints(
            lambda topic: self.listen(topic, TEXT, keep="latest", max_bytes=MOST_DESCRIPTION_BYTES),
            self.graph,
            self.values,
        )
        self.kept = KeptByRooms([self._joints, *keeps])
        self._beginnings = Beginnings()
        self._listened: dict[tuple[str, str, str, bool], tuple[str, Choice]] = {}

    @property
    def policy(self) -> Policy:
        """The policy of this server."""
        return self.guard.policy

    # ── acting ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def do(self, command: Command[R], session: Session | None = None) -> R:
        """Decide about a command and carry it out. Before the decision nothing is registered, prepared in the bridge,
        or sent.

        Without a session the command is accepted at the time of this call, for its own principal.

        Raises:
            Refused: if the policy of this server forbids it, or a limit is reached.
            BadValue: with the path of a value that does not fit its definition; nothing is sent.
            Stopped: if a stop came after it was accepted; nothing was sent, unless the error says so.
            RobotError: the errors of the command itself.
        """
        session = session or self.session(command.principal)
        prepared = await as_meant(Prepared(self.values, session, command))
        prepared = await self._beginnings.settle(prepared, self.now_ns)
        meant = prepared.command
        find_facts = partial(facts_of, self, prepared, self._joints)
        if session.rehearsed is not None:
            decision = await self.guard.foresee(meant, find_facts)
            said = {"refused": f"would be refused: {decision.reason}", "consent": "would wait for a person's approval"}
            session.rehearsed.append(f"{meant.act}: {said.get(decision.verdict, 'would be done')}")
            raise Rehearsed(session.rehearsed[-1])
        async with self.guard.acting(meant, find_facts, stops=_ends_own_goal(self, meant)) as act:
            session.notes.extend(act.notes)
            if not isinstance(meant, _NEVER_STOPPED):
                self.check_stop(session)
            _check_room(self, meant)
            _check_action_topic(meant)
            result = await _EXECUTORS[type(meant)](self, prepared)
            act.ended_by = getattr(result, "ended_by", "")
            if isinstance(meant, commands.SendGoal):
                self._audit_end(meant)
            return result

    def _audit_end(self, command: commands.SendGoal) -> None:
        """Write a line in the audit when an accepted goal ends."""
        goal, audit = self.jobs.get(goals.Goal, command.goal_id), self.guard.audit
        if not goal or not goal.is_accepted or not audit:
            return

        def tell(goal: goals.Goal) -> None:
            who = command.principal.name
            audit.note("goal ended", principal=who, name=goal.action, goal_id=goal.id, outcome=goal.ended_as)

        goal.at_end = tell
        if not goal.is_running:
            tell(goal)

    # Stopping is never refused: it does not pass the policy, and no later stop holds it back.

    def raise_stop_epoch(self) -> None:
        """Begin a stop of everything: from now on this server sends nothing that was accepted before."""
        self.stops.raise_epoch()

    async def stop_bridge(self) -> StopReply:
        """End the requests in the bridge that were accepted before the last `raise_stop_epoch`, and publish the zero on
        every driven velocity topic. Raises as `Graph.ask`.
        """
        before = self.failsafes.commands()
        reply = await self.graph.query(
            StopReply,
            "stop",
            epoch=self.stops.epoch,
            wait_match_s=MATCH_S,
            wait_ack_s=ACKNOWLEDGED_S,
            timeout_s=MATCH_S + ACKNOWLEDGED_S + ZERO_S,
        )
        await self.failsafes.rest(reply["topics"], before)
        return reply

    async def zero(self, topics: Sequence[str]) -> Sequence[StoppedTopic]:
        """Publish the zero on some of the driven velocity topics. Raises as `Graph.ask`."""
        return await self.failsafes.zero(topics)

    async def still(self, topics: Mapping[str, str]) -> Mapping[str, str]:
        """Publish the zero on topics (by name, with types) that another server left moving, for half a second, so that
        subscribers can match. Return the reasons of failures, by topic.
        """
        said = await asyncio.gather(*(self.failsafes.still(*topic) for topic in topics.items()))
        return {topic: why for topic, why in zip(topics, said, strict=True) if why}

    def moves_for(self, principal: Principal) -> bool:
        """Return whether this client may keep something moving: by a job, a goal, a velocity topic that it drives, or a
        request that acts and was not answered.
        """
        running = self.jobs.running(Job)
        return (
            any(job.owner == principal and job.moves for job in running)
            or self.stops.is_leaving(principal)
            or bool(self.failsafes.owned(principal))
        )

    async def stop_owned(self, principal: Principal, reason: str = "") -> Sequence[str]:
        """End everything that a disconnected client has in motion. The work of other clients continues.

        Its unanswered requests are ended, its jobs that move something are stopped with this reason, its goals are
        cancelled, and the zero is published on every velocity topic that only it drives. Never raises a `RobotError`:
        failures are logged.

        Returns: What was ended, in words: `repeat repeat_0f3a9c21`, `zero on /cmd_vel`.
        """
        self.stops.end_of(principal)
        if self.guard.approvals:
            self.guard.approvals.leave(principal)
        topics = self.failsafes.give_up(principal)
        ended, _ = await asyncio.gather(self.jobs.stop_owned(principal, reason), self._zero(topics))
        return [*(f"{job.kind} {job.id}" for job in ended), *(f"zero on {topic}" for topic in topics)]

    async def _zero(self, topics: Sequence[str]) -> None:
        """Publish the zero on these topics, if there are any. The bridge ends repeats with a zero as well."""
        if not topics:
            return
        try:
            zeros = await self.zero(topics)
        except RobotError as error:
            _logger.warning("no zero could be sent on %s: %s", ", ".join(topics), error)
            return
        for zero in zeros:
            if zero["matched"] and not zero["acked"]:
                _logger.warning("the zero on %s has not been acknowledged", zero["topic"])

    async def end_repeat(self, repeat_id: str) -> None:
        """End one repeat in the bridge; the reply to the repeat then has its counts. No effect if there is none."""
        await self.graph.ask("repeat_stop", name=repeat_id)

    async def end_relay(self, relay_id: str) -> None:
        """End one relay or playback in the bridge. No effect if there is none."""
        await self.graph.ask("relay_stop", name=relay_id)

    async def cancel_when(self, asked: goals.CancelWhen, name: str) -> goals.WhenMet:
        """Have the bridge cancel a goal as soon as a condition holds, and return then. `name` identifies this request.

        `graph.repeat_begun_at(name)` is when the condition began to be evaluated. Raises as `Graph.ask`.
        """
        return await goals.cancel_when(self, asked, name)

    def goal_ended(self, action: str, goal_id: str, how: str = "") -> None:
        """Record that a goal of this action has ended or was not accepted, and how, if this server sent it."""
        goals.ended(self, action, goal_id, how)

    # ── reading ────────────────────────────────────────────────────────────────────────────────────────────────

    @asynccontextmanager
    async def listen(
        self,
        topic: str,
        type_name: str = "",
        *,
        wait_s: float = 0.0,
        absent: Callable[[TopicEndpoints], Awaitable[None]] | None = None,
        keep: Keep = "all",
        max_samples: int = MAX_WAITING,
        max_bytes: int | None = None,
        head_bytes: int = 0,
        every_n: int = 1,
        newest_of_old: bool = False,
        drain_s: float | None = None,
        is_volatile: bool = False,
    ) -> AsyncGenerator[Listening, None]:
        """A context manager of a subscription with QoS that match every publisher.

        Args:
            topic: its name; it may appear later.
            type_name: needed only if the topic has several types or none yet.
            wait_s: how long to wait for a first publisher, in s.
            absent: called first if the topic does not exist; may raise.
            keep: `all` waiting samples, or only the `latest`.
            max_samples: bound on the waiting samples; the oldest are dropped and counted.
            max_bytes: bound on their bytes. Without it, 64 MB here and, over a network, 1 MB in the bridge, so that
                samples arrive fresh; with it, the same bound in the bridge.
            head_bytes: only this many of the first bytes of each sample are transferred (0: all).
            every_n: only every n-th sample is transferred; the others stay on the robot, and count as received.
            newest_of_old: of the samples that a latched topic replays, only the newest is transferred.
            drain_s: how long a sample may wait in the bridge, in s; None is the default of the link.
            is_volatile: receive nothing that was published before, even from a latched topic.

        Raises:
            NotFound: if the topic does not exist and no type is given.
            TypeConflict: if it has several types and none is given, or not the given one.
        """
        topic, asked_at = names.absolute(topic), monotonic()
        key, depth = (topic, type_name, keep, is_volatile), 1 if keep == "latest" else _DEPTH

        def subscribed(full_type: str, choice: Choice) -> Coroutine[Any, Any, Subscription]:
            qos_request = choice.qos.request()
            return self._bridge.subscribe(
                topic,
                full_type,
                qos_request,
                keep=keep,
                max_samples=max_samples,
                max_bytes=MAX_WAITING_BYTES if max_bytes is None else max_bytes,
                backlog_bytes=_BACKLOG_BYTES if max_bytes is None else None,
                head_bytes=head_bytes,
                every_n=every_n,
                newest_of_old=newest_of_old and choice.qos.durability == "transient_local",
                **({} if drain_s is None else {"drain_s": drain_s}),
            )

        subscription: Subscription | None = None
        former = self._listened.pop(key, None)  # stored again if it was right: a wrong guess fails only once
        if former:  # subscribe as last time while the graph is queried whether that is still right: one round trip
            subscription, present = await subscribed_while(subscribed(*former), self.graph.endpoints(topic))
        else:
            present = await self.graph.endpoints(topic)
        try:
            if absent and not present.types:
                await absent(present)
            present = await self.graph.wait_for(topic, publishers=1, timeout_s=wait_s, present=present)
            full_type = await self.types.topic(present, type_name)
            publishers = [publisher for publisher in present.publishers if publisher.type == full_type]
            choice = qos.for_subscribing(publishers, depth=depth, is_volatile=is_volatile)
            if subscription is None or former is None or (former[0], former[1].qos) != (full_type, choice.qos):
                if subscription:
                    await subscription.close()
                subscription, _ = await subscribed_while(subscribed(full_type, choice), self.values.learn(full_type))
            self._remember(key, (full_type, choice))
            opened_ns = self.now_ns() - round((monotonic() - asked_at) * 1e9)  # its clock is known only now
            yield Listening(topic, full_type, choice, publishers, subscription, opened_ns)
        finally:
            if subscription:
                await subscription.close()

    def _remember(self, key: tuple[str, str, str, bool], how: tuple[str, Choice]) -> None:
        """Remember the subscription of a topic for the next time; forget the topic that was read longest ago."""
        self._listened.pop(key, None)
        self._listened[key] = how
        if len(self._listened) > _MOST_REMEMBERED:
            del self._listened[next(iter(self._listened))]

    @asynccontextmanager
    async def listen_again(self, former: Listening, *, max_bytes: int) -> AsyncGenerator[Listening, None]:
        """Repeat a former subscription without querying the graph: a new bridge has not discovered anything yet."""
        request = former.choice.qos.request()
        async with await self._bridge.subscribe(
            former.topic, former.type, request, keep="all", max_samples=MAX_WAITING, max_bytes=max_bytes
        ) as subscription:
            yield Listening(former.topic, former.type, former.choice, former.publishers, subscription)

    async def ask_service(
        self,
        service: str,
        service_type: str,
        request: Mapping[str, Any],
        *,
        timeout_s: float,
        wait_s: float | None = None,
    ) -> Answer:
        """Call a service that only reads, such as `get_parameters`; any other service needs a command.

        Without `wait_s`, the time-out covers the wait for a server and for its answer together.

        Raises:
            ValueError: for a type that is not known to be read-only.
            NotFound: if no server appeared in time, or it left before it answered.
            TimedOut: if it did not answer in time.
        """
        if not only_reads(service_type):
            raise ValueError(f"{service_type} may change something: calling {service} needs a command.")
        # In the form of a command, but without a decision: reading is always allowed.
        asking = commands.ServiceCall(
            principal=SERVER, name=service, type=service_type, value=request, timeout_s=timeout_s, wait_s=wait_s
        )
        return await services.call(self, Prepared(self.values, self.session(SERVER), asking))

    async def attach(self) -> None:
        """Connect to the robot's bridge, and start it unless it is starting already. Returns at once."""
        await self._bridge.attach()

    async def leave(self) -> None:
        """End all work on the robot: jobs first, while the bridge can still stop what they move; the bridge last.

        If no bridge can receive the end of the jobs, the link is closed first, so that no job waits for an unreachable
        robot: this server has nothing in motion there, or the lease of the remote bridge ends it.
        """
        if not self.graph.was_reached or (self.graph.is_remote and not self.graph.is_connected):
            await self._bridge.close()
        try:
            await self.jobs.close()
        finally:
            try:
                await self.transforms.close()
                await self.kept.close()
            finally:
                await self._bridge.close()
                self.failsafes.close()
                if self.guard.audit:
                    self.guard.audit.close()

    async def fields_of(self, answer: Answer) -> dict[str, Any]:
        """Return the response of a service in full, for this program and not for display."""
        return await self.values.in_full(answer.type, answer.body)
