"""Commands: every act that may change something, with resolved names, full types and the principal that asks for it.

A command only describes; `Robot.do` decides about it and executes it. Its type parameter is the type of its result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, TypeVar

from ros2_mcp.model.goals import CANCEL_TYPE, cancel_request, goal_id_bytes
from ros2_mcp.model.graph import RelayCounts
from ros2_mcp.model.qos import Choice, QoS
from ros2_mcp_common.wire.protocol import EndedBy

R = TypeVar("R")

Risk = Literal["write", "actuate"]
"""`write` changes software or files, `actuate` may move the robot."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Principal:
    """The origin of a command: one for stdio, one for each session or program over HTTP, and the server itself.

    `transport` is that of MCP (`stdio`, `http` or `socket`), or `server` for the server's own commands. `login` is the
    name of the token over HTTP, and of the user at a Unix socket; several principals may share it. `program` is the id
    of the program through which the command comes: when a program ends, only its own acts end.
    """

    name: str
    transport: str
    login: str = ""
    program: str = ""

    @property
    def counted_as(self) -> str:
        """The name under which limits count it: its login, as a client over HTTP can choose any number of names."""
        return f"{self.transport} {self.login or self.name}"


SERVER = Principal(name="server", transport="server")
"""The server itself, such as for its black box."""
LOCAL = Principal(name="local", transport="stdio")
"""The only client of a server over stdio."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sent:
    """The outcome of a publication; `ours` of the `matched` subscribers are this server's own.

    `acked` is None if not known: best effort and repeats have no acknowledgement. `late` counts missed periods of a
    repeat; a repeat of velocity commands ends with a zero (`stopped_with_zero`). `ended_by` is the reason for an early
    end. Under a policy, `limited` messages were slower than requested because of a ramp, and `hold_s` after the last
    message the bridge sends the zero (0: it does not). `stopper_s` is how long it waited for the stopper, `unguarded`
    the reason why it continued without one. `endpoints` are the numbers of publishers and subscribers of the topic, if
    known.
    """

    topic: str
    type: str
    choice: Choice
    sent: int
    matched: int
    elapsed_s: float
    ours: int = 0
    acked: bool | None = None
    late: int = 0
    stopped_with_zero: bool = False
    ended_by: EndedBy = ""
    limited: int = 0
    hold_s: float = 0.0
    stopper_s: float = 0.0
    unguarded: str = ""
    endpoints: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """The response of a service as CDR bytes of `type`, and its delay."""

    type: str
    body: bytes
    elapsed_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Command(Generic[R]):
    """One act, and the principal that asks for it.

    `name` is the absolute name of the target: a topic, a service, an action, a node, a bag. `type` is its full type;
    `value` the JSON value to send. `rate_hz` and `duration_s` are None for a single act; a duration of 0 has no end.
    """

    principal: Principal
    name: str
    type: str = ""
    value: object = None
    rate_hz: float | None = None
    duration_s: float | None = None
    risk: Risk = "actuate"

    ACT: ClassVar[str]
    """The action, as the beginning of a sentence with the command's fields: `Publishing on {0.name}`."""

    @property
    def act(self) -> str:
        """The action in words: `Publishing on /cmd_vel`."""
        return self.ACT.format(self)


# ── on topics ──────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, kw_only=True, slots=True)
class Publish(Command[Sent]):
    """Publish one message. The result waits, within bounds, for a matching subscriber and its acknowledgement."""

    ACT = "Publishing on {0.name}"

    choice: Choice
    wait_match_s: float
    wait_ack_s: float = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Repeat(Command[Sent]):
    """Publish one message repeatedly; the bridge keeps the rate. The result comes at the end.

    `repeat_id` is its id in the bridge, by which it can be ended.
    """

    ACT = "Publishing on {0.name}"

    repeat_id: str = ""
    choice: Choice
    rate_hz: float = 1.0
    duration_s: float = 5.0
    wait_match_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Moved:
    """The outcome of a motion.

    `sent` is as for a repeat. `outcome` is a word and `why` a sentence for the reason of its end, both empty if
    `sent.ended_by` has it; `report` is the controller's report at the end.
    """

    sent: Sent
    outcome: str
    why: str
    report: Mapping[str, Any]

    @property
    def ended_by(self) -> EndedBy:
        """The reason for an early end."""
        return self.sent.ended_by


@dataclass(frozen=True, kw_only=True, slots=True)
class Move(Command[Moved]):
    """Send velocity commands of a controller in the bridge, which receives feedback, `rate_hz` times a second.

    `controller` are its parameters, with its `kind`; `hears` are the types of the topics to which it subscribes.
    `value` is the fastest command that it may send, by which a policy decides; the bridge checks each command that it
    sends. `duration_s` is the time limit, `motion_id` its id in the bridge. The result comes at the end.
    """

    ACT = "Driving by {0.name}"

    motion_id: str = ""
    choice: Choice
    controller: Mapping[str, Any]
    hears: Sequence[str] = ()
    rate_hz: float = 20.0
    duration_s: float = 60.0
    wait_match_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Relay(Command[RelayCounts]):
    """Publish messages of `source` on `name`. The result comes at the end, after `duration_s` or earlier.

    If it `is_fed` (`Feed`), the bridge does not know its source, rate and end. `relay_id` is its id in the bridge.
    """

    ACT = "Relaying to {0.name}"

    relay_id: str
    qos: QoS
    source: str = ""
    is_fed: bool = False
    wait_match_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Play(Command[RelayCounts]):
    """Publish one recorded topic on `name`, fed (`Feed`) in its recorded rhythm; the result comes at the end.

    `relay_id` is its id in the bridge, `bag` the recording, `part` a description of the played time range, and `topic`
    the topic's name in the recording. With `force` it is played even if the topic has other publishers or moves the
    robot; `speed` is 1 for the recorded speed.
    """

    ACT = "Playing {0.bag} on {0.name}"

    relay_id: str
    qos: QoS
    bag: str
    topic: str
    part: str = ""
    force: bool = False
    speed: float = 1.0
    wait_match_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Feed(Command[int]):
    """Pass messages (CDR of `type`) to a fed relay or playback; the result is how many it has published so far.

    Without messages it checks that the relay runs. Raises `NotFound` if no relay with that id runs.
    """

    ACT = "Publishing on {0.name}"

    relay_id: str
    messages: Sequence[bytes] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Record(Command[None]):
    """Record topics to the bag `name`: the topics in `topics`, and the topics that match one of `patterns`; without
    both, all topics.

    Nothing is sent: a record command is only decided.
    """

    ACT = "Recording"

    topics: Sequence[str]
    patterns: Sequence[str] = ()
    risk: Risk = "write"


# ── through services ───────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, kw_only=True, slots=True)
class ServiceBorne(Command[Answer]):
    """A request to a service. Without `wait_s` the time-out covers waiting for a server as well as its answer.

    Raises, when it is executed:
        NotFound: if no server appeared in time, or it left before answering.
        TimedOut: if it did not answer in time.
    """

    ACT = "Calling {0.service}"

    timeout_s: float
    wait_s: float | None = None

    @property
    def service(self) -> str:
        """The service that is called."""
        return self.name

    @property
    def service_type(self) -> str:
        """The full type of the service."""
        return self.type

    @property
    def request(self) -> object:
        """The request as a JSON value."""
        return self.value


@dataclass(frozen=True, kw_only=True, slots=True)
class ServiceCall(ServiceBorne):
    """Call the service `name`; `value` is the request."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _OfNode(ServiceBorne):
    """A request to the node `name` through the service `through`."""

    through: str

    @property
    def service(self) -> str:
        """The service that is called."""
        return self.through


@dataclass(frozen=True, kw_only=True, slots=True)
class SetParameters(_OfNode):
    """Set parameters of the node `name`; `value` is the request, `parameters` the new values as plain JSON."""

    ACT = "Setting parameters of {0.name}"

    parameters: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class ChangeState(_OfNode):
    """Trigger a transition of the lifecycle node `name`, by its label or id; `value` is the request."""

    ACT = "Changing the state of {0.name}"

    transition: str
    transition_id: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Route:
    """The list of goals to which a goal belongs. A person approves the whole list with its first goal.

    `id` is that of the job that sends them. Only the first goal's command has `goals`, the values of all goals in their
    order, with the number of `loops`, the wait after each goal in s, and whether a missed goal does not end the list
    (`goes_on`).
    """

    id: str
    goals: Sequence[Mapping[str, Any]] = ()
    loops: int = 1
    waits_s: Sequence[float] = ()
    goes_on: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class SendGoal(ServiceBorne):
    """Send a goal to the action `name` of type `type`; `value` is the goal, `goal_id` its 32 hexadecimal digits.

    `route` is the list to which it belongs, if any.
    """

    ACT = "Sending a goal to {0.name}"

    goal_id: str
    route: Route | None = None

    @property
    def service(self) -> str:
        """The service that is called."""
        return f"{self.name}/_action/send_goal"

    @property
    def service_type(self) -> str:
        """The full type of the service."""
        return f"{self.type}_SendGoal"

    @property
    def request(self) -> object:
        """The request as a JSON value."""
        return {"goal_id": {"uuid": goal_id_bytes(self.goal_id)}, "goal": self.value}


@dataclass(frozen=True, kw_only=True, slots=True)
class CancelGoals(ServiceBorne):
    """Cancel one goal of the action `name`; without a `goal_id` all goals accepted up to `stamp`, or all."""

    ACT = "Cancelling goals of {0.name}"

    goal_id: str = ""
    stamp: Mapping[str, int] | None = None
    type: str = CANCEL_TYPE

    @property
    def service(self) -> str:
        """The service that is called."""
        return f"{self.name}/_action/cancel_goal"

    @property
    def request(self) -> object:
        """The request as a JSON value."""
        return cancel_request(self.goal_id, self.stamp)
