"""The transforms on /tf and /tf_static as a tree of frames, kept from the first query on, so that later queries are
fast.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING

import anyio

from ros2_mcp.model.aside import aside
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.names import UNKNOWN_NODE
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.world.transforms import FrameTree

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge, Subscription
    from ros2_mcp.robot.graph import Graph
    from ros2_mcp.robot.values import Values
    from ros2_mcp.world.frame_edges import Edge

TF, TF_STATIC = "/tf", "/tf_static"
TF_TYPE = "tf2_msgs/msg/TFMessage"
LISTENS = {TF: QoS("reliable", "volatile", depth=100), TF_STATIC: QoS("reliable", "transient_local", depth=100)}
"""The QoS of the robot's own nodes (`tf2_ros::TransformListener`): transforms that do not reach this subscriber do not
reach them either."""
_IDLE_S = 60.0
"""The lifetime of the subscriptions after the last query, in s: an agent queries again within seconds, and /tf has a
cost."""
_TURN_S = 5.0
"""The period of checks whether the subscriptions are still needed, in s, while nothing arrives."""
_MAX_WAITING, _MAX_BYTES = 5_000, 8_000_000
"""Bounds on the waiting messages: ten seconds of the busiest robot."""
_DRAIN_S = 0.01
"""The longest wait of a message in the bridge, in s: poses are not read more often."""
_SEEN_S = 3.0
"""The period of queries for publishers, in s: they rarely change, and a lookup should cost no more than its
arithmetic."""
_ROLES_S = 30.0
"""The period of queries for other topics of these nodes, in s: they change even less."""
_ROLES = {
    "odometry": frozenset({"nav_msgs/msg/Odometry"}),
    "localisation": frozenset({"geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/OccupancyGrid"}),
    "description": frozenset({"std_msgs/msg/String"}),
}
_AGAIN_S = 3.0
"""The time limit for latched messages to reach a new subscription, in s: its publishers are known, and a slow network
takes a second."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Life:
    """The lifetime of a publisher, from repeated queries, in ns of the robot's clock.

    `not_before_ns` is when it was last absent (0: it was present at the first query); `gone_by_ns` is when it was first
    absent again (None: it is present).
    """

    not_before_ns: int = 0
    gone_by_ns: int | None = None


class TransformListener:
    """The current frames of a robot.

    It subscribes at the first query, and unsubscribes after `idle_s` seconds without a query, or if the bridge is lost;
    the next query subscribes again and replaces `tree`. `since` is the time of subscription (monotonic, in s; None
    while not subscribed).
    """

    idle_s = _IDLE_S

    def __init__(self, bridge: Bridge, graph: Graph, values: Values) -> None:
        self._bridge, self._graph, self._values = bridge, graph, values
        self.tree = FrameTree()
        self.namespace = ""
        self.since: float | None = None
        self._work: asyncio.Task[None] | None = None
        self._begun = asyncio.Event()
        self._news = asyncio.Event()
        self._asked_at = 0.0
        self._failure: RobotError | None = None
        self._publishers: dict[str, tuple[float, Sequence[Endpoint]]] = {}
        self._lives: dict[str, dict[str, Life]] = {}
        self._looked_ns: dict[str, int] = {}
        self._clock: tuple[float, Sequence[str]] = (-_SEEN_S, ())
        self._also: tuple[float, tuple[str, ...], Mapping[str, Sequence[str]]] = (0.0, (), {})

    async def listening(self) -> FrameTree:
        """Return the tree, as soon as it is subscribed.

        Raises:
            UnknownInterface: if the robot has no tf2_msgs.
            LinkError: if there is no bridge.
        """
        self._asked_at = monotonic()
        if self._work is None or self._work.done():
            self._failure = None
            self._begun.clear()
            self._work = asyncio.create_task(self._listen())
        await self._begun.wait()
        if self._failure:
            raise self._failure.again()
        return self.tree

    async def news(self, timeout_s: float) -> bool:
        """Wait for the next transforms; return whether they came in time."""
        with anyio.move_on_after(max(timeout_s, 0.0)):
            await self._news.wait()
            return True
        return False

    @property
    def listened_s(self) -> float:
        """The duration of the subscription so far, in s; 0 while not subscribed."""
        return 0.0 if self.since is None else monotonic() - self.since

    def now_ns(self) -> int:
        """Return the present time of the robot's clock, in ns of Unix time."""
        return self._bridge.clock.now_ns()

    async def publishers(self, topic: str) -> Sequence[Endpoint]:
        """Return the publishers of /tf or /tf_static, at most seconds old. Raises as `Graph.endpoints`."""
        seen_at, seen = self._publishers.get(topic, (0.0, ()))
        if not seen or monotonic() - seen_at > 2 * _SEEN_S:
            seen = (await self._graph.endpoints(self.namespace + topic)).publishers
            self._publishers[topic] = monotonic(), seen
            self._see(topic, {one.who for one in seen if one.node != UNKNOWN_NODE})
        return seen

    def _see(self, topic: str, names: set[str]) -> None:
        """Record when publishers came and went, as far as the queries show."""
        now_ns, lives = self.now_ns(), self._lives.setdefault(topic, {})
        for name in names:
            before = lives.get(name, Life(self._looked_ns.get(topic, 0)))
            lives[name] = Life(before.not_before_ns)
        for name, life in lives.items():
            if name not in names and life.gone_by_ns is None:
                lives[name] = Life(life.not_before_ns, now_ns)
        self._looked_ns[topic] = now_ns

    def lives(self, topic: str) -> Mapping[str, Life]:
        """Return the nodes that have published on the topic since it was subscribed, including nodes that have gone."""
        return self._lives.get(topic, {})

    async def clock_publishers(self) -> Sequence[str]:
        """Return the nodes that publish simulated time, at most seconds old. Raises as `Graph.endpoints`."""
        seen_at, names = self._clock
        if monotonic() - seen_at > _SEEN_S:
            names = sorted({one.who for one in (await self._graph.endpoints("/clock")).publishers})
            self._clock = monotonic(), names
        return names

    async def also_publish(self, nodes: Sequence[str]) -> Mapping[str, Sequence[str]]:
        """Return which of these nodes also publish odometry, a localisation (a pose or a map) and a description, by
        role.

        The answer is at most half a minute old, unless the nodes are others. Raises as `Graph.topics`.
        """
        seen_at, asked, also = self._also
        if asked != tuple(nodes) or monotonic() - seen_at > _ROLES_S:
            found = {role: set[str]() for role in _ROLES}
            for row in await self._graph.topics():
                for role, types in _ROLES.items():
                    is_other = role == "description" and not row.name.endswith("/robot_description")
                    if types.isdisjoint(row.types) or is_other or not row.publishers:
                        continue
                    found[role] |= {one.who for one in (await self._graph.endpoints(row.name)).publishers}
            also = {role: sorted(names.intersection(nodes)) for role, names in found.items()}
            self._also = monotonic(), tuple(nodes), also
        return also

    async def other_topics(self) -> Sequence[str]:
        """Return topics of the same type with other names, such as /robot1/tf. Raises as `Graph.topics`."""
        rows = await self._graph.topics()
        return [row.name for row in rows if TF_TYPE in row.types and row.name not in LISTENS]

    async def moved(self) -> bool:
        """Switch to the topics of the only namespace with published frames, if /tf and /tf_static have no publisher.

        Returns:
            Whether it switched. Raises as `Graph.topics`.
        """
        if self.namespace:
            return False
        for topic in LISTENS:
            if (await self._graph.endpoints(topic)).publishers:
                return False
        rows = await self._graph.topics()
        found = {
            row.name.removesuffix(topic)
            for row in rows
            for topic in LISTENS
            if TF_TYPE in row.types and row.publishers and row.name.endswith(topic) and row.name != topic
        }
        if len(found) != 1:
            return False
        await self.close()
        self.namespace = found.pop()
        self._publishers.clear()
        return True

    async def close(self) -> None:
        """Unsubscribe."""
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait({self._work})
            self._work = None

    async def _listen(self) -> None:
        tree = self.tree = FrameTree()
        tree.namespace = self.namespace
        try:
            await self._values.learn(TF_TYPE)
            async with await self._subscribe(TF_STATIC) as static, await self._subscribe(TF) as moving:
                self.since = monotonic()
                self._begun.set()
                await asyncio.gather(
                    self._follow(tree, static, TF_STATIC), self._follow(tree, moving, TF), self._watch_publishers(tree)
                )
        except RobotError as error:
            self._failure = error
            _logger.info("the frames of the robot are not kept: %s", error)
        finally:
            self.since = None
            self._begun.set()
            self._tell()

    async def _subscribe(self, topic: str) -> Subscription:
        return await self._bridge.subscribe(
            self.namespace + topic,
            TF_TYPE,
            LISTENS[topic].request(),
            keep="all",
            max_samples=_MAX_WAITING,
            max_bytes=_MAX_BYTES,
            drain_s=_DRAIN_S,
        )

    async def _follow(self, tree: FrameTree, subscription: Subscription, topic: str) -> None:
        while monotonic() - self._asked_at < self.idle_s:
            samples = await subscription.take(_TURN_S)
            if samples:
                size = sum(len(sample.data) for sample in samples)
                messages = await aside(size, tree.decoded, self._values.codec, samples)
                tree.take_in(messages, is_static=topic == TF_STATIC)
                self._tell()

    async def _watch_publishers(self, tree: FrameTree) -> None:
        """Keep the publishers up to date: a publisher that disappears must be known to have existed, and a lookup needs
        no query.
        """
        self._lives.clear()
        self._looked_ns.clear()
        gone, asked_for = frozenset[str](), 0
        while monotonic() - self._asked_at < self.idle_s:
            with suppress(RobotError):
                for topic in LISTENS:
                    self._publishers.pop(topic, None)
                    await self.publishers(topic)
            before, gone = gone, frozenset(who for who, life in self.lives(TF_STATIC).items() if life.gone_by_ns)
            with suppress(RobotError):
                # More publishers were received than exist: one came and went between two queries.
                heard = tree.publishers(is_static=True)
                if gone - before or heard > max(asked_for, len(await self.publishers(TF_STATIC))):
                    asked_for = heard
                    await self._find_left(tree)
            if self.namespace and (await self._graph.endpoints(TF)).publishers:
                self.namespace = ""
                self._publishers.clear()
                raise RobotError(f"{TF} itself is published now: the next call uses it")
            await asyncio.sleep(_SEEN_S)

    async def _find_left(self, tree: FrameTree) -> None:
        """Mark the static transforms whose publisher has disappeared: a new subscription does not receive them."""
        asked_ns = self.now_ns()
        left = {edge.child for edge in tree.edges.values() if edge.static and _static_ns(edge) < asked_ns}
        again = FrameTree()
        async with await self._subscribe(TF_STATIC) as subscription:
            deadline = monotonic() + _AGAIN_S
            while left - again.edges.keys() and (wait_s := deadline - monotonic()) > 0:
                again.take_in(again.decoded(self._values.codec, await subscription.take(wait_s)), is_static=True)
        is_heard = again.edges or not await self.publishers(TF_STATIC)
        for child in left if is_heard else ():  # an empty replay shows nothing
            edge = tree.edges[child]
            edge.is_left = child not in again.edges and _static_ns(edge) < asked_ns

    def _tell(self) -> None:
        """Wake all tasks that wait for new transforms."""
        news, self._news = self._news, asyncio.Event()
        news.set()


def _static_ns(edge: Edge) -> int:
    """Return when the transform was last received as static; the same frame may also be published as moving."""
    return max((told.received_ns for told in edge.static.values()), default=0)
