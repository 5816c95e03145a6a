"""The link to a robot that is not there: it notes what is sent to it, and answers as a bridge would. And commands."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from ros2_mcp.link.client import Posted, Reply, Subscription
from ros2_mcp.link.clock import RobotClock
from ros2_mcp.model.commands import (
    LOCAL,
    CancelGoals,
    Command,
    Feed,
    Play,
    Publish,
    Record,
    Relay,
    Repeat,
    SendGoal,
    ServiceCall,
)
from ros2_mcp.model.errors import BridgeRefused
from ros2_mcp.model.qos import Choice, QoS

TWIST = "geometry_msgs/msg/Twist"
STAMPED = "geometry_msgs/msg/TwistStamped"
VALUE = """uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\nstring string_value
byte[] byte_array_value\nbool[] bool_array_value\nint64[] integer_array_value\nfloat64[] double_array_value
string[] string_array_value\n"""
DEFINITIONS = {
    TWIST: ("msg", "Vector3 linear\nVector3 angular\n"),
    "geometry_msgs/msg/Vector3": ("msg", "float64 x\nfloat64 y\nfloat64 z\n"),
    STAMPED: ("msg", "std_msgs/Header header\nTwist twist\n"),
    "std_msgs/msg/Header": ("msg", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    "std_msgs/msg/Int32": ("msg", "int32 data\n"),
    "made/msg/Speed": ("msg", "float32 speed\n"),
    "unique_identifier_msgs/msg/UUID": ("msg", "uint8[16] uuid\n"),
    "action_msgs/msg/GoalInfo": ("msg", "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp\n"),
    "builtin_interfaces/msg/Time": ("msg", "int32 sec\nuint32 nanosec\n"),
    "action_msgs/msg/GoalStatus": ("msg", "GoalInfo goal_info\nint8 status\n"),
    "action_msgs/msg/GoalStatusArray": ("msg", "GoalStatus[] status_list\n"),
    "action_msgs/srv/CancelGoal": ("srv", "GoalInfo goal_info\n---\nint8 return_code\nGoalInfo[] goals_canceling\n"),
    "made/action/Go": ("action", "int32 order\n---\nint32 done\n---\nint32 left\n"),
    "std_srvs/srv/SetBool": ("srv", "bool data\n---\nbool success\nstring message\n"),
    "lifecycle_msgs/msg/Transition": ("msg", "uint8 id\nstring label\n"),
    "lifecycle_msgs/srv/ChangeState": ("srv", "Transition transition\n---\nbool success\n"),
    "rcl_interfaces/msg/ParameterValue": ("msg", VALUE),
    "rcl_interfaces/msg/Parameter": ("msg", "string name\nParameterValue value\n"),
    "rcl_interfaces/msg/SetParametersResult": ("msg", "bool successful\nstring reason\n"),
    "rcl_interfaces/srv/SetParameters": ("srv", "Parameter[] parameters\n---\nSetParametersResult[] results\n"),
}


class Noting:
    """`sent` has the operations in their order, `arguments` those of the last of each; a fail-safe stays in force.

    `answer` is the body of every answer. `may_answer` holds back the answers to what acts, and `refuse` has the kind
    of error with which an operation is answered. `zeros` is what became of them, `subscribers` and `publishers` who is
    in the graph. `listening` has the open subscriptions by topic. `ended_by` is what ends a repeat.
    """

    hello = None
    is_closed = False
    is_remote = False
    silent_s = unheard_s = 0.0

    def __init__(self) -> None:
        self.clock = RobotClock()
        self.sent: list[str] = []
        self.arguments: dict[str, Mapping[str, Any]] = {}
        self.answer = b""
        self.nodes: set[str] = set()
        self.stop_epoch = 0
        self.frame_ids: dict[str, str] = {}
        self.lapsed_at = 0.0
        self.repeats_begun: dict[str, float] = {}
        self.may_answer = asyncio.Event()
        self.may_answer.set()
        self.may_define = asyncio.Event()
        self.may_define.set()
        self.refuse: dict[str, str] = {}
        self.zeros: list[dict[str, Any]] = []
        self.ended_by = ""
        self.failsafes: list[Mapping[str, Any]] = []
        self.subscribers: list[dict[str, Any]] = []
        self.publishers: list[dict[str, Any]] = []
        self.listening: dict[str, Subscription] = {}

    async def subscribe(self, topic: str, *_: Any, **__: Any) -> Subscription:
        async def unsubscribe(_: Subscription) -> None:
            del self.listening[topic]

        self.listening[topic] = Subscription("all", 10, 1000, unsubscribe)
        return self.listening[topic]

    def post(self, op: str, body: bytes = b"", **arguments: Any) -> Posted:
        self.sent.append(op)
        self.arguments[op] = arguments
        self.failsafes.append(arguments)
        return Posted(op, body, arguments)

    async def request(self, op: str, _body: bytes = b"", *, timeout_s: float, **arguments: Any) -> Reply:
        del timeout_s
        if op == "definitions":
            await self.may_define.wait()
            texts = {name: {"format": kind, "text": text} for name, (kind, text) in DEFINITIONS.items()}
            return Reply({"missing": [], "definitions": texts}, b"")
        self.sent.append(op)
        self.arguments[op] = arguments
        await self.may_answer.wait()
        if op in self.refuse:
            raise BridgeRefused(self.refuse[op], "It is refused.")
        if op in ("zero", "stop"):
            return Reply({"repeats": 0, "relays": 0, "dropped": [], "topics": self.zeros}, b"")
        if op == "services":
            return Reply({"services": [], "settled": True}, b"")
        if op == "topics":
            return Reply({"topics": [], "settled": True}, b"")
        if op == "endpoints":
            return Reply({"publishers": self.publishers, "subscribers": self.subscribers, "settled": True}, b"")
        if op == "relay":
            return Reply({"passed": 1, "final_sent": True}, b"")
        told = {
            "passed": 0,
            "matched": 1,
            "ours": 0,
            "acked": True,
            "waited_s": 0.0,
            "sent": 1,
            "elapsed_s": 0.1,
            "late": 0,
        }
        told |= {"limited": 0, "hold_s": 0.0}
        told |= {"stopper_s": 0.0, "unguarded": "", "endpoints": (1, 1)}
        return Reply({**told, "final_sent": True, "ended_by": self.ended_by, **arguments}, self.answer)


CHOICE = Choice(QoS(), "as chosen")
GOAL_ID = "0123456789abcdef" * 2
UUID = list(bytes.fromhex(GOAL_ID))


def on(name: str, /, **more: Any) -> dict[str, Any]:
    return {"principal": LOCAL, "name": name, "type": TWIST, **more}


def goal(**more: Any) -> SendGoal:
    sent: dict[str, Any] = {"value": {"order": 3}, **more}
    return SendGoal(principal=LOCAL, name="/go", type="made/action/Go", goal_id=GOAL_ID, timeout_s=1.0, **sent)


def call(kind: str, service: str, value: object) -> ServiceCall:
    return ServiceCall(principal=LOCAL, name=service, type=kind, value=value, timeout_s=1.0, wait_s=0.5)


EVERY: list[Command[Any]] = [
    Publish(**on("/cmd_vel", value={}, choice=CHOICE, wait_match_s=0.0)),
    Repeat(**on("/cmd_vel", value={}, choice=CHOICE, wait_match_s=0.0)),
    Relay(**on("/cmd_vel", relay_id="r", qos=QoS(), wait_match_s=0.0)),
    Play(**on("/cmd_vel", relay_id="r", qos=QoS(), bag="b", topic="/cmd_vel", wait_match_s=0.0)),
    Feed(**on("/cmd_vel", relay_id="r", messages=[b"\0\1\0\0"])),
    Record(principal=LOCAL, name="bag", topics=[]),
    goal(),
    CancelGoals(principal=LOCAL, name="/go", goal_id=GOAL_ID, timeout_s=1.0),
    call("std_srvs/srv/SetBool", "/switch", {"data": True}),
    call("rcl_interfaces/srv/SetParameters", "/node/set_parameters", {"parameters": []}),
    call("lifecycle_msgs/srv/ChangeState", "/node/change_state", {"transition": {"label": "activate"}}),
]
