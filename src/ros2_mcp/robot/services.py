"""Carry out the commands that are service requests."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.commands import Answer, CancelGoals, ChangeState, SendGoal, ServiceBorne, SetParameters
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp_common.policy.flight import vehicle_of
from ros2_mcp_common.policy.verbs import only_reads


async def call(core: Core, prepared: Prepared[Any]) -> Answer:
    """Send one request and return the response. Raises as a `ServiceBorne`.

    Raises:
        BadValue: with the path of a value that does not fit its definition; nothing is sent.
        Stopped: if a stop came after the session was accepted; nothing was sent.
    """
    command: ServiceBorne = prepared.command
    body, timeout_s, wait_s = await prepared.body(), command.timeout_s, command.wait_s
    arguments: dict[str, Any] = {
        "service": command.service,
        "type": command.service_type,
        "wait_s": timeout_s if wait_s is None else wait_s,
        "timeout_s": timeout_s,
        "within_s": timeout_s if wait_s is None else wait_s + timeout_s,
    }
    if isinstance(command, CancelGoals) or only_reads(command.service_type):
        reply = await core.graph.ask("call", body, **arguments)
    elif isinstance(command, SendGoal):  # it is a job, and will be cancelled whatever the reply
        core.check_stop(prepared.session)
        reply = await core.graph.ask("call", body, epoch=prepared.session.accepted.epoch, **arguments)
    elif isinstance(command, SetParameters | ChangeState) or vehicle_of(command.service, command.service_type):
        # configuration is no motion (decision 21), and a flight is a job
        reply = await core.act(prepared.session, "call", body, **arguments)
    else:
        with core.stops.unknown.sending("service", command.service, command.service_type):
            reply = await core.act(prepared.session, "call", body, **arguments)
    return Answer(f"{command.service_type}_Response", reply.body, reply.ok["elapsed_s"])
