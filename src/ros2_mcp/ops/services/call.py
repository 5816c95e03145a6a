"""Call a service, as `ros2 service call` does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import ServiceCall
from ros2_mcp.model.errors import BadInput, NotFound, TimedOut
from ros2_mcp.ops.acting import flights
from ros2_mcp.ops.acting.defaults import left_at_default
from ros2_mcp.ops.acting.servers import in_words as in_words_of
from ros2_mcp.ops.acting.servers import servers_of
from ros2_mcp.ops.results.results import SAID, Report, in_words, reporting, silent
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.policy.verbs import only_reads
from ros2_mcp_common.wire.limits import MAX_DURATION_S

_LEAST_TIMEOUT_S = 0.01
"""Ten times the duration of a service call on one machine (0.9 ms at the 99th percentile): a
shorter time-out is a mistake."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceAnswer:
    """The response of a service as an object. `called` is false if request fields are missing (`missing_fields`), or
    several nodes serve it (see `note`).
    """

    service_name: str = field(metadata=SAID)
    service_type: str
    called: bool = field(metadata=SAID)
    result: dict[str, Any] | None = None
    missing_fields: Sequence[str] = ()
    elapsed: float = 0.0
    truncated: Sequence[str] = ()
    note: str = ""

    def summary(self) -> str:
        """Return the result in one line."""
        if not self.called:
            return f"{self.service_name} was not called. {self.note}"
        return f"{self.service_name} answered: {in_words(self.result or {}) or 'nothing'}. {self.note}".rstrip()


async def call(
    robot: Robot,
    session: Session,
    service: str,
    service_type: str,
    request: Mapping[str, Any] | None,
    *,
    force_call: bool = False,
    timeout_s: float = 10.0,
    waits: bool = True,
    report: Report = silent,
) -> ServiceAnswer:
    """Call a service and wait for its answer; if it `waits`, a server that appears within the time-out is used.

    If `request` is None, none was given: then only a request that has no fields is sent, even with `force_call`.

    A service that several nodes serve is called only with `force_call`, unless its type only reads.

    Raises:
        BadInput: if the call is forced, its request has fields, and none was given.
        NotFound: if there is no server (or none appeared), or it left before it answered.
        TypeConflict: if the service has another type.
        TimedOut: if it did not answer in time.
        BadValue: if a value does not fit; it names the path, and nothing is sent.
    """
    bounded("timeout_sec", timeout_s, _LEAST_TIMEOUT_S, MAX_DURATION_S, "s")
    service = names.absolute(service, "service")
    service_type = await robot.types.service(service, service_type)
    if absent := await robot.types.absent_service(service):
        if not waits:
            raise absent
        await report(0.0, timeout_s, f"Waiting for the service {service}. {absent.hint}")
    await robot.values.learn(service_type)
    missing = robot.values.missing_fields(f"{service_type}_Request", request or {})
    if missing and force_call and request is None:
        hint = "Give them in `fields`; {} uses the default of each."
        raise BadInput(f"The request needs fields: {', '.join(missing)}.", hint)
    request = request or {}
    if missing and not force_call:
        # Not an error: models leave fields out by mistake, and a default value may be an unintended command.
        note = (
            f"Missing request fields: {', '.join(missing)}. Give them, or set force_call to true to use defaults. "
            + left_at_default(robot.values.definitions, f"{service_type}_Request", request)
        )
        return ServiceAnswer(
            service_name=service, service_type=service_type, called=False, missing_fields=missing, note=note
        )
    servers = await servers_of(robot, service)
    if servers and not (force_call or only_reads(service_type)):
        note = (
            f"{in_words_of(service, servers)}: each would carry out the call, and the first answer would be shown. End "
            "all but one, or set force_call to true."
        )
        return ServiceAnswer(service_name=service, service_type=service_type, called=False, note=note)
    command = ServiceCall(
        principal=session.principal, name=service, type=service_type, value=request, timeout_s=timeout_s
    )
    sent_ns = robot.now_ns()
    try:
        async with reporting(report, timeout_s, f"waiting for {service}"):
            answer = await robot.do(command, session)
    except NotFound as error:
        robot.types.forget_service(service)
        await robot.types.service(service, service_type)  # raises TypeConflict if it came back with another type
        raise NotFound(error.message, error.hint or await robot.types.near_service(service)) from error
    except TimedOut as error:
        hint = "The server may still be working on it; give a longer timeout_sec."
        raise TimedOut(error.message, error.hint or hint) from error
    shown = await robot.values.render(answer.type, answer.body)
    notes = [f"{in_words_of(service, servers)}: this is the first answer." if servers else ""]
    notes += [left_at_default(robot.values.definitions, f"{service_type}_Request", request)]
    if flights.is_order(service, service_type, request):
        notes.append(await flights.outcome(robot, service, service_type, request, shown.value, sent_ns))
    return ServiceAnswer(
        service_name=service,
        service_type=service_type,
        called=True,
        result=shown.value,
        missing_fields=missing,
        elapsed=answer.elapsed_s,
        truncated=list(shown.truncated),
        note=" ".join(filter(None, notes)),
    )
