"""The topics of the watchdog: passes it the robot's feedback, and stops the robot if it finds something."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ros2_mcp_bridge.loop import Seldom
from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import interfaces, rcl
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.stream import Sample
from ros2_mcp_bridge.topics.relay import FollowedSource
from ros2_mcp_bridge.topics.replayed import NewestOfOld
from ros2_mcp_bridge.topics.subscriptions import RawSubscription
from ros2_mcp_common.latch import Latch
from ros2_mcp_common.policy.feedback import Watchdog, rules_of

if TYPE_CHECKING:
    from rclpy.node import Node

# The period of looks while the robot is driven, and so the longest wait of a message. Part of `feedback.REACTION_S`.
LOOK_S = 0.02
# The period while it rests: often enough to notice that it is driven, and to keep the queues short.
REST_LOOK_S = 0.1
# The longest time for one topic in one look, so that a flood does not hold the ROS thread; the rest is read at the next
# look.
HEARS_AT_MOST_S = 0.01
# The longest wait of a message that is believed; a longer one means that this process was held up, or a clock was set.
WAITED_AT_MOST_S = 1.0
BY = "watchdog"


class Heard(Protocol):
    """An object that names a topic: a rule of the watchdog, or a feed of a motion."""

    @property
    def topic(self) -> str:
        """The full name of the topic."""
        ...

    @property
    def type(self) -> str:
        """The full type of the topic."""
        ...


class _Plan(NamedTuple):
    """The topic of the path that the robot's own software follows."""

    topic: str
    type: str = "nav_msgs/msg/Path"


class Ear:
    """A subscription to one feedback topic: it follows the topic's publishers as they come and go.

    While it passes a message on, `received_at` is when the middleware received it (monotonic, s): it
    may have waited since then. `from_before_s` is its age by its publisher's clock if it was sent before the
    subscription, else None.
    """

    def __init__(self, node: Node, graph: Graph, heard: Heard) -> None:
        request = Request({"op": "watch", "source": heard.topic, "type": heard.type}, b"")
        self._interface = request.interface = interfaces.load(heard.type)
        self._topic = heard.topic
        self._source = FollowedSource(node, graph, request)
        self._has_failed = False
        self.received_at = 0.0
        self.from_before_s: float | None = None
        self._subscription: RawSubscription | None = None
        self._old: NewestOfOld[Sample] | None = None

    def hear(self, take_in: Callable[[Any], None]) -> None:
        """Pass the waiting messages, decoded, to `take_in`; of messages that a latched topic replays, only the newest.

        A message that cannot be decoded or used is ignored: then the topic becomes stale, and the watchdog goes on.
        """
        deadline = time.monotonic() + HEARS_AT_MOST_S

        def decode(sample: Sample, is_old: bool) -> None:
            self.from_before_s = max((time.time_ns() - sample.source_ns) / 1e9, 0.0) if is_old else None
            waited_s = (time.time_ns() - sample.received_ns) / 1e9  # by a clock that may have been set
            self.received_at = time.monotonic() - min(max(waited_s, 0.0), WAITED_AT_MOST_S)
            with suppress(Exception):  # a message may be broken, and its type may lack fields
                take_in(rcl.deserialize(sample.data, self._interface))

        def pass_on(sample: Sample) -> None:
            for one in self._old.passed(sample, time.monotonic()) if self._old else (sample,):
                decode(one, is_old=one is not sample)

        try:
            self._resubscribe()
            if self._subscription is not None:
                self._subscription.drain(pass_on, lambda: time.monotonic() > deadline)
            for one in self._old.due(time.monotonic()) if self._old else ():
                decode(one, is_old=True)
        except rcl.RCLError as error:
            if not self._has_failed:
                sys.stderr.write(f"{self._topic} cannot be heard: {error}\n")  # once
            self._has_failed = True

    @property
    def is_settling(self) -> bool:
        """Whether messages that a latched topic kept may still be about to come."""
        return self._old is not None and self._old.is_settling(time.monotonic())

    def _resubscribe(self) -> None:
        opened_ns = time.time_ns()
        self._source.resubscribe()
        if self._source.subscription is not self._subscription:
            self._subscription = self._source.subscription
            self._old = NewestOfOld(opened_ns, time.monotonic()) if self._source.is_latched else None

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._source.destroy()


class Watching:
    """The watchdog of one bridge: receives feedback, judges it, and if it finds something stops the
    robot and sets the latch.

    Before a keep-out zone `keep_out` is called instead, which ends what drives the robot, without the latch. `began`
    gets the watchdog when it begins. `cancel_others` is called when others drive the robot towards such a zone.
    """

    def __init__(
        self,
        node: Node,
        graph: Graph,
        *,
        latch: Latch,
        stop: Callable[[], object],
        keep_out: Callable[[str], object] = lambda _: None,
        began: Callable[[Watchdog], object] = lambda _: None,
        cancel_others: Callable[[str], object] = lambda _: None,
    ) -> None:
        self._node = node
        self._graph = graph
        self._latch = latch
        self._stop = stop
        self._keep_out = keep_out
        self._began = began
        self._cancel_others = cancel_others

    def watch(
        self,
        rules: Callable[[], Mapping[str, Any] | None],
        is_driven: Callable[[], bool],
        by_goal: Callable[[], bool],
    ) -> Steps[None]:
        """Steps that watch for ever, once the policy's rules have come, if these require it."""
        while (given := rules()) is None:
            yield Seldom(REST_LOOK_S)
        speed, pose = rules_of(given)
        if speed is None and pose is None:
            return
        watchdog = Watchdog(speed, pose)
        self._began(watchdog)
        plans = {keep_out.plan for keep_out in pose.keep_out if keep_out.plan} if pose else set[str]()
        sources = [(speed, _speed_to), (pose, _pose_to), *((_Plan(topic), _plan_to) for topic in sorted(plans))]
        try:
            ears = [(Ear(self._node, self._graph, rule), take(watchdog)) for rule, take in sources if rule]
        except OperationError as error:  # without its type nothing is received, so that nothing can drive for long
            sys.stderr.write(f"the watchdog hears nothing: {error}\n")
            ears = []

        def hear() -> None:
            for ear, take in ears:
                ear.hear(take)

        def end(found: str) -> None:
            (self._end if watchdog.latches else self._keep_out)(found)

        yield from rounds(watchdog, hear, is_driven, end, by_goal=by_goal, cancel_others=self._cancel_others)

    def _end(self, found: str) -> None:
        """Send zeros, then set the latch: in memory at once, in its file on another thread, because writing
        takes as long as the disk.
        """
        self._stop()
        if (state := self._latch.look()).is_set and state.by == BY:
            return  # setting it again would raise its count, so that no reset would succeed
        self._latch.hold(by=BY, reason=found)
        sys.stderr.write(f"the watchdog stops the robot: {found}\n")
        threading.Thread(target=self._latch.write_at_last, daemon=True).start()


def rounds(
    watchdog: Watchdog,
    hear: Callable[[], None],
    is_driven: Callable[[], bool],
    end: Callable[[str], None],
    now: Callable[[], float] = time.monotonic,
    by_goal: Callable[[], bool] = lambda: False,
    cancel_others: Callable[[str], object] = lambda _: None,
) -> Steps[None]:
    """Steps that run the watchdog for ever: report to it whether the robot is driven, pass it the received messages,
    and call `end` on a finding, or `cancel_others` on a finding about motion that others cause.
    """
    while True:
        watchdog.told(is_driven(), now(), by_goal=by_goal())
        hear()
        if found := watchdog.look(now()):
            end(found)
        elif others := watchdog.look_at_others(now()):
            cancel_others(others)
        yield LOOK_S if watchdog.is_busy or watchdog.is_moved_by_others else REST_LOOK_S


def _speed_to(watchdog: Watchdog) -> Callable[[Any], None]:
    return lambda message: watchdog.heard_speed(message, time.monotonic())


def _pose_to(watchdog: Watchdog) -> Callable[[Any], None]:
    def take(message: Any) -> None:
        header = getattr(message, "header", None)  # without a header, the pose is in no frame
        watchdog.heard_pose(message, getattr(header, "frame_id", ""), time.monotonic())

    return take


def _plan_to(watchdog: Watchdog) -> Callable[[Any], None]:
    return watchdog.heard_plan
