"""Carry out commands that publish: a single message, a repeat, a motion, a relay, or messages for a relay."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, cast

from ros2_mcp.model.commands import Command, Feed, Move, Moved, Play, Publish, Relay, Repeat, Sent
from ros2_mcp.model.graph import RelayCounts
from ros2_mcp.model.qos import QoS
from ros2_mcp.robot import flights
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.failsafes import Driven
from ros2_mcp.robot.graph import NO_END_S, REQUEST_S
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp_common.policy.velocity import HOLD_TYPES, MOTION_TYPES
from ros2_mcp_common.wire import protocol

_HEARD_S = 6.0
"""The time limit for the first messages that a motion receives, in s; the bridge waits 5 s (`motion.FIRST_HEARD_S`)."""


async def publish(core: Core, prepared: Prepared[Publish]) -> Sent:
    """Publish one message, and wait for acknowledgement where that is possible."""
    command, body = prepared.command, await prepared.body()
    async with _sending(core, prepared, command.choice.qos) as driven:
        answer = await core.act(
            prepared.session,
            "publish",
            body,
            timeout_s=command.wait_match_s + command.wait_ack_s + REQUEST_S,
            wait_match_s=command.wait_match_s,
            wait_ack_s=command.wait_ack_s,
            **_destination(command, command.choice.qos),
        )
    reply = cast("protocol.PublishReply", answer.ok)
    _note_taken(driven, reply["matched"] - reply["ours"])
    return Sent(
        topic=command.name,
        type=command.type,
        choice=command.choice,
        sent=1,
        matched=reply["matched"],
        ours=reply["ours"],
        acked=reply["acked"],
        elapsed_s=reply["waited_s"],
        limited=reply["limited"],
        hold_s=reply["hold_s"],
        stopper_s=reply["stopper_s"],
        unguarded=reply["unguarded"],
        endpoints=(reply["endpoints"][0], reply["endpoints"][1]),
    )


async def repeat(core: Core, prepared: Prepared[Repeat]) -> Sent:
    """Publish one message at a rate for a time, with a zero at the end for types that move."""
    command, body = prepared.command, await prepared.body()
    async with _sending(core, prepared, command.choice.qos) as driven:
        number = driven.commands if driven else 0
        answer = await core.act(
            prepared.session,
            "repeat",
            body,
            timeout_s=command.duration_s + command.wait_match_s + REQUEST_S,
            name=command.repeat_id,
            wait_match_s=command.wait_match_s,
            rate_hz=command.rate_hz,
            duration_s=command.duration_s,
            **_destination(command, command.choice.qos),
        )
        reply = cast("protocol.RepeatReply", answer.ok)
        _note_taken(driven, reply["matched"] - reply["ours"])
        _note_end(driven, number, reply["final_sent"])
    return _sent(command, reply)


async def move(core: Core, prepared: Prepared[Move]) -> Moved:
    """Run a motion by feedback in the bridge from its start to its final zero."""
    command = prepared.command
    await prepared.body()  # checks the fastest command; the bridge generates the commands itself
    async with _sending(core, prepared, command.choice.qos) as driven:
        number = driven.commands if driven else 0
        answer = await core.act(
            prepared.session,
            "move",
            json.dumps(command.controller).encode(),
            timeout_s=command.duration_s + command.wait_match_s + _HEARD_S + REQUEST_S,
            name=command.motion_id,
            wait_match_s=command.wait_match_s,
            rate_hz=command.rate_hz,
            duration_s=command.duration_s,
            hears=list(command.hears),
            frame=_frame_id_of(command.value),
            **_destination(command, command.choice.qos),
        )
        reply = cast("protocol.MotionReply", answer.ok)
        _note_taken(driven, reply["matched"] - reply["ours"])
        _note_end(driven, number, reply["final_sent"])
    return Moved(sent=_sent(command, reply), outcome=reply["outcome"], why=reply["why"], report=reply["report"])


def _sent(command: Repeat | Move, reply: protocol.RepeatReply) -> Sent:
    return Sent(
        topic=command.name,
        type=command.type,
        choice=command.choice,
        sent=reply["sent"],
        matched=reply["matched"],
        ours=reply["ours"],
        elapsed_s=reply["elapsed_s"],
        late=reply["late"],
        stopped_with_zero=reply["final_sent"],
        ended_by=reply["ended_by"],
        limited=reply["limited"],
        stopper_s=reply["stopper_s"],
        unguarded=reply["unguarded"],
    )


async def relay(core: Core, prepared: Prepared[Relay | Play]) -> RelayCounts:
    """Run a relay in the bridge from its start to its end, with a final zero for types that move."""
    command = prepared.command
    await core.values.learn(command.type)
    arguments: dict[str, Any] = {}
    if isinstance(command, Relay) and command.source and not command.is_fed:
        arguments = {"source": command.source, "duration_s": command.duration_s or 0.0}
        arguments |= {"rate_hz": command.rate_hz} if command.rate_hz else {}
    async with _sending(core, prepared, command.qos) as driven:
        number = driven.commands if driven else 0
        answer = await core.act(
            prepared.session,
            "relay",
            timeout_s=NO_END_S,
            name=command.relay_id,
            wait_match_s=command.wait_match_s,
            **_destination(command, command.qos),
            **arguments,
        )
        counts = RelayCounts(**answer.ok)
        _note_taken(driven, counts.matched if counts.passed else 0)
        _note_end(driven, number, counts.final_sent)
    return counts


async def feed(core: Core, prepared: Prepared[Feed]) -> int:
    """Send messages for an open relay, and return how many it published. The relay's fail-safe covers them."""
    command = prepared.command
    body, sizes = b"".join(command.messages), [len(message) for message in command.messages]
    answer = await core.act(
        prepared.session, "relay_feed", body, timeout_s=REQUEST_S, name=command.relay_id, sizes=sizes
    )
    return answer.ok["passed"]


@asynccontextmanager
async def _sending(core: Core, prepared: Prepared[Any], qos: QoS) -> AsyncGenerator[Driven | None, None]:
    """A context manager around a request that publishes: its fail-safe is in force, or it is recorded that no stop is
    known.

    Raises:
        Stopped: if a stop came after the session was accepted.
        Refused: if too many velocity topics are driven.
    """
    core.check_stop(prepared.session)
    command = prepared.command
    if command.type not in MOTION_TYPES and flights.takes_setpoints(core, command.name):
        yield None  # the brake of that flight stops it
        return
    if command.type not in MOTION_TYPES:
        with core.stops.unknown.sending("topic", command.name, command.type):
            yield None
        return
    if frame_id := _frame_id_of(command.value):
        core.graph.note_frame_id(command.name, frame_id)
    joints = _joints_of(command.value) if command.type in HOLD_TYPES else ()
    async with core.failsafes.driving(command.name, command.type, qos, command.principal, joints) as driven:
        yield driven


def _note_taken(driven: Driven | None, matched: int) -> None:
    """Record whether a command reached a subscriber other than this server."""
    if driven and matched > 0:
        driven.was_taken = True


def _note_end(driven: Driven | None, number: int, has_final: bool) -> None:
    """Record whether a topic got its final zero, unless a later command than `number` was sent on it."""
    if driven and driven.commands == number:
        driven.has_ended = has_final


def _destination(command: Command[Any], qos: QoS) -> dict[str, Any]:
    """Return topic, type and QoS as arguments for the bridge."""
    return {"topic": command.name, "type": command.type, "qos": qos.request()}


def _frame_id_of(value: object) -> str:
    """Return the `header.frame_id` of a value that has been encoded; "" if it has none."""
    header = cast("Mapping[str, Any]", value).get("header") if isinstance(value, Mapping) else None
    return str(header.get("frame_id", "")) if header else ""


def _joints_of(value: object) -> Sequence[str]:
    """Return the joints of a trajectory that has been encoded."""
    names = cast("Mapping[str, Any]", value).get("joint_names", ()) if isinstance(value, Mapping) else ()
    return [str(name) for name in names]
