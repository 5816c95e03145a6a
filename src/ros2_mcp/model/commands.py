"""Every act that may change something: frozen, with resolved names, full types and the principal who asks for it.

A command says what shall happen; `Robot.do` decides about it and carries it out. Its type parameter is its result.
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
    """Who asks: one for stdio, one for each session or program over HTTP, and the server itself.

    `transport` is that of MCP by which it came: `stdio`, `http` or `socket`; `server` for what the server does of its
    own. `login` is the name of the token over HTTP, and of the user at a Unix socket; several principals may share it.
    `program` is the id of the program through which it asks: what one program does ends with it, and nothing else does.
    """

    name: str
    transport: str
    login: str = ""
    program: str = ""

    @property
    def counted_as(self) -> str:
        """Whom limits count it for: its login, since a client over HTTP can give itself as many names as it likes."""
        return f"{self.transport} {self.login or self.name}"


SERVER = Principal(name="server", transport="server")
"""The server itself, such as for its black box."""
LOCAL = Principal(name="local", transport="stdio")
"""The one client of a server over stdio."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sent:
    """What became of a publication; `ours` of the matched subscribers are this server's own.

    `acked` is None where it is not known: best effort and repetitions have no acknowledgement. `late` counts missed
    periods of a repetition, which ends with a zero command (`stopped_with_zero`) where its type is a velocity command;
    `ended_by` is what ended it before its time. Under a policy, `limited` messages left slower than was asked for, as a
    ramp lets them, and after `hold_s` without another one the bridge sends the zero (0: it does not). `stopper_s` is
    how long it waited for the stopper, `unguarded` why it went on without one, in words. `endpoints` is how many
    publishers and subscribers the topic has, where that is known.
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
    """The response of a service as CDR bytes of `type`, and how long it took."""

    type: str
    body: bytes
    elapsed_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Command(Generic[R]):
    """One act, and who asks for it.

    `name` is the absolute name of what is acted on: a topic, a service, an action, a node, a bag. `type` is its full
    type; `value` the JSON value that is sent. `rate_hz` and `duration_s` are None for what happens once; a duration of
    0 has no end.
    """

    principal: Principal
    name: str
    type: str = ""
    value: object = None
    rate_hz: float | None = None
    duration_s: float | None = None
    risk: Risk = "actuate"

    ACT: ClassVar[str]
    """What is done, in words that begin a sentence, with the fields of the command: `Publishing on {0.name}`."""

    @property
    def act(self) -> str:
        """What is done: `Publishing on /cmd_vel`."""
        return self.ACT.format(self)


# ── on topics ──────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, kw_only=True, slots=True)
class Publish(Command[Sent]):
    """One message. The result waits, within bounds, for a subscriber to match and for its acknowledgement."""

    ACT = "Publishing on {0.name}"

    choice: Choice
    wait_match_s: float
    wait_ack_s: float = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Repeat(Command[Sent]):
    """One message again and again; the rhythm is kept inside the bridge. The result comes at its end.

    `repeat_id` is its name in the bridge, where it may have to be ended by it.
    """

    ACT = "Publishing on {0.name}"

    repeat_id: str = ""
    choice: Choice
    rate_hz: float = 1.0
    duration_s: float = 5.0
    wait_match_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Moved:
    """What became of a motion.

    `sent` is as of a repetition. `outcome` is a word for what ended it and `why` a sentence, both empty where
    `sent.ended_by` says it; `report` is what its controller told of it at the end.
    """

    sent: Sent
    outcome: str
    why: str
    report: Mapping[str, Any]

    @property
    def ended_by(self) -> EndedBy:
        """What ended it before its time."""
        return self.sent.ended_by


@dataclass(frozen=True, kw_only=True, slots=True)
class Move(Command[Moved]):
    """Velocity commands that follow from what is heard: a controller in the bridge decides them, `rate_hz` a second.

    `controller` is what it is made of, with its `kind`; `hears` are the types of the topics that it hears. `value` is
    the fastest command that it may send, by which a policy decides; the bridge judges each that leaves. `duration_s` is
    its time limit, `motion_id` its name in the bridge. The result comes at its end.
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
    """What comes on `source` is published on `name`. The result comes when it ends, after `duration_s` or before.

    Where it `is_fed` (`Feed`), the bridge knows neither its source, its rate nor its end. `relay_id` is its name there.
    """

    ACT = "Relaying to {0.name}"

    relay_id: str
    qos: QoS
    source: str = ""
    is_fed: bool = False
    wait_match_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Play(Command[RelayCounts]):
    """One recorded topic is published again on `name`, fed (`Feed`) in its rhythm; the result comes at its end.

    `relay_id` is its name in the bridge, `bag` the recording, `part` the times of it that are played, in words, and
    `topic` what the topic is called there. With `force`
    it is played though somebody publishes there, or is moved by it; `speed` is 1 for that of the recording.
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
    """Messages (CDR of `type`) for a relay or playback that is fed; the result is how many it has passed on so far.

    Without messages: whether it runs. Raises `NotFound` where no relay of that id does.
    """

    ACT = "Publishing on {0.name}"

    relay_id: str
    messages: Sequence[bytes] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Record(Command[None]):
    """Topics are written to the bag `name`: those of `topics`, and those that fit one of `patterns`; without both, all.

    Nothing is sent: it is decided, no more.
    """

    ACT = "Recording"

    topics: Sequence[str]
    patterns: Sequence[str] = ()
    risk: Risk = "write"


# ── through services ───────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, kw_only=True, slots=True)
class ServiceBorne(Command[Answer]):
    """A request to a service. Without `wait_s` the time-out holds for waiting for a server and for its answer together.

    Raises, when it is done:
        NotFound: if no server appeared in time, or it left before it answered.
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
        """Its full type."""
        return self.type

    @property
    def request(self) -> object:
        """The request as a JSON value."""
        return self.value


@dataclass(frozen=True, kw_only=True, slots=True)
class ServiceCall(ServiceBorne):
    """A request to the service `name`; `value` is the request."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _OfNode(ServiceBorne):
    """A request to a node `name` through a service of it."""

    through: str

    @property
    def service(self) -> str:
        """The service that is called."""
        return self.through


@dataclass(frozen=True, kw_only=True, slots=True)
class SetParameters(_OfNode):
    """Parameters of the node `name`; `value` is the request, `parameters` what they become as plain JSON values."""

    ACT = "Setting parameters of {0.name}"

    parameters: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class ChangeState(_OfNode):
    """A transition of the lifecycle node `name`, by its label or its id; `value` is the request."""

    ACT = "Changing the state of {0.name}"

    transition: str
    transition_id: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class SendGoal(ServiceBorne):
    """A goal for the action `name` of type `type`; `value` is the goal, `goal_id` its 32 hexadecimal digits."""

    ACT = "Sending a goal to {0.name}"

    goal_id: str

    @property
    def service(self) -> str:
        """The service that is called."""
        return f"{self.name}/_action/send_goal"

    @property
    def service_type(self) -> str:
        """Its full type."""
        return f"{self.type}_SendGoal"

    @property
    def request(self) -> object:
        """The request as a JSON value."""
        return {"goal_id": {"uuid": goal_id_bytes(self.goal_id)}, "goal": self.value}


@dataclass(frozen=True, kw_only=True, slots=True)
class CancelGoals(ServiceBorne):
    """Cancels one goal of the action `name`; without a `goal_id` all that were accepted up to `stamp`, or all."""

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
