"""Carrying out the commands that publish: once, repeatedly, as a relay, or fed from a bag or from this server."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.commands import Feed, Play, Publish, Relay, Repeat, Sent
from ros2_mcp.model.graph import RelayCounts
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.graph import REQUEST_S

_FOREVER_S = 1e9
"""A relay ends by its own duration or when it is told to; the stream's protocol wants a number."""


async def publish(core: Core, command: Publish) -> Sent:
    """One message, acknowledged where that is possible."""
    body, destination = await _prepared(core, command)
    reply = await core.graph.ask(
        "publish",
        body,
        timeout_s=command.wait_match_s + command.wait_ack_s + REQUEST_S,
        wait_match_s=command.wait_match_s,
        wait_ack_s=command.wait_ack_s,
        **destination,
    )
    ok = reply.ok
    return Sent(command.name, command.type, command.choice, 1, ok["matched"], ok["acked"], ok["waited_s"])


async def repeat(core: Core, command: Repeat) -> Sent:
    """One message at a rate for a time, with a zero at the end of what moves."""
    body, destination = await _prepared(core, command)
    zero = core.failsafes.leave_zero(command.name, command.type, command.choice.qos)
    reply = await core.graph.ask(
        "repeat",
        body + zero,
        timeout_s=command.duration_s + command.wait_match_s + REQUEST_S,
        final_size=len(zero),
        wait_match_s=command.wait_match_s,
        rate_hz=command.rate_hz,
        duration_s=command.duration_s,
        **destination,
    )
    ok = reply.ok
    return Sent(
        command.name,
        command.type,
        command.choice,
        ok["sent"],
        ok["matched"],
        None,
        ok["elapsed_s"],
        ok["late"],
        ok["final_sent"],
        ok["cancelled"],
    )


async def relay(core: Core, command: Relay | Play) -> RelayCounts:
    """A relay in the bridge from its beginning to its end, with a zero at the end of what moves."""
    await core.values.learn(command.type)
    zero = core.failsafes.leave_zero(command.name, command.type, command.qos)
    arguments: dict[str, Any] = {}
    if isinstance(command, Relay) and command.source:
        arguments = {"source": command.source, "duration_s": command.duration_s or 0.0}
        arguments |= {"rate_hz": command.rate_hz} if command.rate_hz else {}
    reply = await core.graph.ask(
        "relay",
        zero,
        timeout_s=_FOREVER_S,
        name=command.relay_id,
        topic=command.name,
        type=command.type,
        qos=command.qos.request(),
        wait_match_s=command.wait_match_s,
        **arguments,
    )
    return RelayCounts(**reply.ok)


async def feed(core: Core, command: Feed) -> int:
    """Messages for a relay that is open: opening it has left its fail-safe, which ends what these begin."""
    sizes = [len(message) for message in command.messages]
    reply = await core.graph.ask("relay_feed", b"".join(command.messages), name=command.relay_id, sizes=sizes)
    return int(reply.ok.get("passed", 0))


async def _prepared(core: Core, command: Publish | Repeat) -> tuple[bytes, dict[str, Any]]:
    """The checked and encoded message, with the bridge's arguments for its destination; the fail-safe is in force."""
    body = await core.values.encode(command.type, command.value)
    core.failsafes.leave_zero(command.name, command.type, command.choice.qos)
    return body, {"topic": command.name, "type": command.type, "qos": command.choice.qos.request()}
