"""Services: which there are, and calling them."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import ServiceCall
from ros2_mcp.model.errors import BadName, NotFound, TimedOut, UnknownInterface
from ros2_mcp.ops.results import Report, in_words, reporting, silent
from ros2_mcp.robot import Robot
from ros2_mcp.robot.resolution import is_infrastructure
from ros2_mcp_bridge.limits import MAX_DURATION_S

_STILL_WORKING = "It may still be working on it; a longer timeout_sec waits for longer."


@dataclass(frozen=True, slots=True)
class ServiceEntry:
    """One service; `request_fields` is name → type, `providers` are the nodes that serve it."""

    service_name: str
    service_type: str
    request_fields: dict[str, Any]
    providers: Sequence[str]


@dataclass(frozen=True, slots=True)
class ServiceList:
    """The services of the graph."""

    services: Sequence[ServiceEntry]
    total: int
    settled: bool
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.services)} of {self.total} services. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class ServiceAnswer:
    """The response of a service as an object, or `called` false with the request fields that are missing."""

    service_name: str
    service_type: str
    called: bool
    result: dict[str, Any] | None
    missing_fields: Sequence[str]
    elapsed: float
    truncated: Sequence[str]
    note: str

    def summary(self) -> str:
        """One line."""
        if not self.called:
            return f"{self.service_name} was not called. {self.note}"
        return f"{self.service_name} answered: {in_words(self.result or {}) or 'nothing'}. {self.note}".rstrip()


async def list_services(robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200) -> ServiceList:
    """The services whose names match the pattern. Those that every node has are shown with `include_hidden`."""
    found = await robot.graph.services()
    every = {row.name: row.types for row in found}
    visible = [name for name in sorted(every) if include_hidden or not is_infrastructure(name, every[name])]
    chosen = names.matching(visible, pattern)
    providers, fields = await asyncio.gather(
        _providers(robot), _request_fields(robot, [every[name][0] for name in chosen[:limit]])
    )
    entries = [
        ServiceEntry(name, every[name][0], fields.get(every[name][0], {}), providers.get(name, []))
        for name in chosen[:limit]
    ]
    note = _list_note(len(every) - len(visible), len(chosen), limit, found.settled)
    return ServiceList(entries, len(every), found.settled, note)


async def call(
    robot: Robot,
    service: str,
    service_type: str,
    request: Mapping[str, Any],
    *,
    force_call: bool = False,
    timeout_s: float = 10.0,
    report: Report = silent,
) -> ServiceAnswer:
    """Calls a service and waits for its answer; a server that appears within the time-out is used.

    Raises:
        NotFound: if no server appeared, or it left before it answered.
        TypeConflict: if the service has another type.
        TimedOut: if it did not answer in time.
        BadValue: naming the path of a value that does not fit; nothing is sent.
    """
    bounded("timeout_sec", timeout_s, 0.01, MAX_DURATION_S, "s")
    service = names.absolute(service, "service")
    service_type = await robot.types.service(service, service_type)
    await robot.values.learn(service_type)
    missing = robot.values.missing_fields(f"{service_type}_Request", request)
    if missing and not force_call:
        return _not_called(service, service_type, missing)
    command = ServiceCall(
        principal=robot.principal, name=service, type=service_type, value=request, timeout_s=timeout_s
    )
    try:
        async with reporting(report, timeout_s, f"waiting for {service}"):
            answer = await robot.do(command)
    except NotFound as error:
        robot.types.forget_service(service)
        await robot.types.service(service, service_type)  # it may have come back with another one
        raise NotFound(error.message, error.hint or await robot.types.near_service(service)) from error
    except TimedOut as error:
        raise TimedOut(error.message, error.hint or _STILL_WORKING) from error
    shown = robot.values.render(answer.type, answer.body)
    return ServiceAnswer(service, service_type, True, shown.value, missing, answer.elapsed_s, shown.truncated, "")


def _not_called(service: str, service_type: str, missing: Sequence[str]) -> ServiceAnswer:
    note = (
        f"Missing request fields: {', '.join(missing)}. Give them, or set force_call to true to call with their "
        "default values."
    )
    return ServiceAnswer(service, service_type, False, None, missing, 0.0, (), note)


async def _providers(robot: Robot) -> dict[str, list[str]]:
    """Service → the full names of the nodes that serve it."""
    nodes = [row.name for row in await robot.graph.nodes()]
    answers = await asyncio.gather(*(_served_by(robot, node) for node in nodes))
    providers: dict[str, list[str]] = {}
    for node, services in zip(nodes, answers, strict=True):
        for service in services:
            providers.setdefault(service, []).append(node)
    return providers


async def _served_by(robot: Robot, node: str) -> list[str]:
    """The services of a node; none of one that has gone meanwhile, or that the middleware has no name for."""
    try:
        return [entry.name for entry in (await robot.graph.node(node)).servers]
    except (NotFound, BadName):
        return []


async def _request_fields(robot: Robot, types: Sequence[str]) -> dict[str, dict[str, Any]]:
    fields: dict[str, dict[str, Any]] = {}
    for name in sorted(set(types)):
        try:
            await robot.values.learn(name)
            fields[name] = robot.values.field_types(f"{name}_Request")
        except UnknownInterface:
            fields[name] = {}
    return fields


def _list_note(left_out: int, matching: int, limit: int, settled: bool) -> str:
    notes: list[str] = []
    if left_out:
        notes.append(f"{left_out} that nodes have of themselves (parameters, actions) are left out.")
    if matching > limit:
        notes.append(f"{matching} match, the first {limit} are shown.")
    if not settled:
        notes.append("Discovery had not settled yet: ask again.")
    return " ".join(notes)
