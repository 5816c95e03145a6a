"""Carrying out the commands that publish: once, repeatedly, as a relay, or fed from a bag or from this server."""

from __future__ import annotations

import asyncio
from typing import Any

from ros2_mcp.model.commands import Feed, Play, Publish, Relay, Repeat, Sent
from ros2_mcp.model.graph import RelayCounts
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.graph import NO_END_S, REQUEST_S
from ros2_mcp_bridge import protocol


async def publish(core: Core, command: Publish) -> Sent:
    """One message, acknowledged where that is possible."""
    body, destination = await _prepared(core, command)
    reply = await core.graph.query(
        protocol.PublishReply,
        "publish",
        body,
        timeout_s=command.wait_match_s + command.wait_ack_s + REQUEST_S,
        wait_match_s=command.wait_match_s,
        wait_ack_s=command.wait_ack_s,
        **destination,
    )
    return Sent(
        topic=command.name,
        type=command.type,
        choice=command.choice,
        sent=1,
        matched=reply["matched"],
        acked=reply["acked"],
        elapsed_s=reply["waited_s"],
    )


async def repeat(core: Core, command: Repeat) -> Sent:
    """One message at a rate for a time, with a zero at the end of what moves."""
    body, destination = await _prepared(core, command)
    zero = core.failsafes.leave_zero(command.name, command.type, command.choice.qos)
    reply = await core.graph.query(
        protocol.RepeatReply,
        "repeat",
        body + zero,
        timeout_s=command.duration_s + command.wait_match_s + REQUEST_S,
        final_size=len(zero),
        wait_match_s=command.wait_match_s,
        rate_hz=command.rate_hz,
        duration_s=command.duration_s,
        **destination,
    )
    return Sent(
        topic=command.name,
        type=command.type,
        choice=command.choice,
        sent=reply["sent"],
        matched=reply["matched"],
        elapsed_s=reply["elapsed_s"],
        late=reply["late"],
        stopped_with_zero=reply["final_sent"],
        ended_early=bool(reply["ended_by"]),
    )


async def relay(core: Core, command: Relay | Play) -> RelayCounts:
    """A relay in the bridge from its beginning to its end, with a zero at the end of what moves."""
    await core.values.learn(command.type)
    zero = core.failsafes.leave_zero(command.name, command.type, command.qos)
    await asyncio.sleep(0)  # as in `_prepared`
    arguments: dict[str, Any] = {}
    if isinstance(command, Relay) and command.source:
        arguments = {"source": command.source, "duration_s": command.duration_s or 0.0}
        arguments |= {"rate_hz": command.rate_hz} if command.rate_hz else {}
    reply = await core.graph.query(
        protocol.RelayReply,
        "relay",
        zero,
        timeout_s=NO_END_S,
        name=command.relay_id,
        topic=command.name,
        type=command.type,
        qos=command.qos.request(),
        wait_match_s=command.wait_match_s,
        **arguments,
    )
    return RelayCounts(**reply)


async def feed(core: Core, command: Feed) -> int:
    """Messages for a relay that is open: opening it has left its fail-safe, which ends what these begin."""
    body, sizes = b"".join(command.messages), [len(message) for message in command.messages]
    reply = await core.graph.query(protocol.RelayFeedReply, "relay_feed", body, name=command.relay_id, sizes=sizes)
    return reply["passed"]


async def _prepared(core: Core, command: Publish | Repeat) -> tuple[bytes, dict[str, Any]]:
    """The checked and encoded message, with the bridge's arguments for its destination; the fail-safe is in force."""
    body = await core.values.encode(command.type, command.value)
    core.failsafes.leave_zero(command.name, command.type, command.choice.qos)
    await asyncio.sleep(0)  # the fail-safe's task writes first: the stream keeps the order
    return body, {"topic": command.name, "type": command.type, "qos": command.choice.qos.request()}
