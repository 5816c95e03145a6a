"""The servers that act on the robot from this machine, their current activity, and the button that stops them all."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.guard.chain import files_of, tail
from ros2_mcp.guard.consent import AUDIT
from ros2_mcp.guard.operators import name_of, own_uid
from ros2_mcp.guard.servers import Row, Server, servers_in
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.robot import Robot
from ros2_mcp.view.acts import MOST_ACTS, acts_in, presses_as_one
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES

_ALIVE_S = 1.0
"""Seconds for the answer of a live server, which looks nothing up. A server that hangs has lost its link lease in a
second."""
_STOPPED_S = 15.0
"""Seconds for the whole answer of a stop, which waits until goals have ended and the robot is observed at rest."""
_LATE_S = 2.0
"""Seconds for the stop's answer of a server that did not answer `list` and may only be slow: its zeros are sent from
here meanwhile."""
_TAIL_BYTES = 96_000
"""Bytes of the audit that are read: some hundred lines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoppedServer:
    """A server that was asked to stop: whether it answered, and its report.

    `is_doubted`: it answered without confirming that the robot is at rest, or its version cannot report this.
    `is_observed_still`: odometry or joint states nevertheless showed the robot at rest.
    """

    name: str
    answered: bool
    said: str
    is_doubted: bool = False
    is_observed_still: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StoppedAll:
    """The outcome of a press of the stop button.

    `zeros` are the topics on which this process sent zeros, because a server did not answer; `problems` are steps that
    failed. `latched`: nothing can act until an operator resets the latch.
    """

    servers: Sequence[StoppedServer]
    zeros: Sequence[str] = ()
    latched: bool
    problems: Sequence[str] = ()
    is_all_well: bool = field(default=False)

    def summary(self) -> str:
        """Say how many servers answered, what was done for the others, and whether the latch is set."""
        answered, doubted = (
            [one for one in self.servers if one.answered],
            [one for one in self.servers if one.is_doubted],
        )
        if doubted and all(one.is_observed_still for one in doubted):
            verdict = "The robot appears to stand still, but this is NOT confirmed"
        elif doubted or len(answered) < len(self.servers):
            verdict = "The robot MAY STILL MOVE: look at it"
        else:
            verdict = "Stopped" if self.servers else "No server acts here"
        told = f". {len(answered)} of {len(self.servers)} servers answered" if self.servers else ""
        zeros = f", zeros were sent from here on {', '.join(self.zeros)}" if self.zeros else ""
        latched = "the latch is set" if self.latched else "the latch is NOT set"
        return f"{verdict}{told}{zeros}; {latched}."


class Acting:
    """The acting servers of one robot, found through its state folder `at`."""

    def __init__(self, at: StateFolder) -> None:
        self.at = at
        self._moves: dict[str, Sequence[str]] = {}
        self._audit: tuple[tuple[object, ...], list[Mapping[str, Any]]] = ((), [])

    async def servers(self) -> list[Mapping[str, Any]]:
        """Return what each server reports of itself; a server that hangs has a row that says so."""
        found = await self._all(lambda server: server.do("list"), _ALIVE_S)
        rows: list[Mapping[str, Any]] = []
        for name, answer in found:
            if isinstance(answer, RobotError):
                rows.append({"name": name, "answers": False, "why": str(answer), "moves": self._moves.get(name, ())})
                continue
            self._moves[name] = answer.get("moves", ())
            rows.append(
                {
                    "name": name,
                    "answers": True,
                    "mode": answer["mode"],
                    "moves": answer.get("moves", ()),
                    "jobs": answer.get("jobs", ()),
                    "waiting": [_waiting(one) for one in answer["waiting"]],
                    "grants": [{"what": one["what"], "left_s": round(one["left_s"])} for one in answer["grants"]],
                    "audit_failed": answer["audit"]["failed"],
                }
            )
        self._moves = {name: moves for name, moves in self._moves.items() if name in {one for one, _ in found}}
        return rows

    def latch(self) -> Mapping[str, Any] | None:
        """Return when, by whom and why the latch was set; None if it is not set."""
        state = self.at.latch().look()
        return {"by": state.by, "reason": state.reason, "since_s": state.since} if state.is_set else None

    def acts(self) -> list[Mapping[str, Any]]:
        """Return the newest audit entries of all servers, the oldest first, each with its outcome."""
        folder = self.at.path / AUDIT
        files = files_of(folder)[-1:] if folder.is_dir() else []
        seen = tuple((path.name, path.stat().st_size) for path in files)
        if seen != self._audit[0]:
            self._audit = seen, presses_as_one([*acts_in(tail(folder, _TAIL_BYTES))])[-MOST_ACTS:]
        return self._audit[1]

    async def stop(self, robot: Robot) -> StoppedAll:
        """Stop every server, send zeros for servers that do not answer, and make sure that the latch is set."""
        answers, (zeros, problems) = await asyncio.gather(
            self._all(_stop_of, _STOPPED_S, of_one=False), self._instead(robot)
        )
        if not self.at.latch().look().is_set:
            problems = [*problems, *await self._latch()]
        servers = [
            StoppedServer(
                name=name,
                answered=not isinstance(answer, RobotError),
                said=str(answer) if isinstance(answer, RobotError) else str(answer.get("done", "")),
                # Earlier versions of the server do not report this; then it is not known.
                is_doubted=not isinstance(answer, RobotError) and answer.get("is_doubted") is not False,
                is_observed_still=not isinstance(answer, RobotError) and answer.get("is_observed_still") is True,
            )
            for name, answer in answers
        ]
        is_latched = self.at.latch().look().is_set
        is_all_well = is_latched and not problems and all(one.answered and not one.is_doubted for one in servers)
        return StoppedAll(servers=servers, zeros=zeros, latched=is_latched, problems=problems, is_all_well=is_all_well)

    async def _instead(self, robot: Robot) -> tuple[Sequence[str], list[str]]:
        """Latch and send zeros in place of servers that do not answer.

        Return the topics with zeros, and the failures.
        """
        alive = await self._all(lambda server: server.do("list"), _ALIVE_S, of_one=False)
        silent = [name for name, answer in alive if isinstance(answer, RobotError)]
        if not silent:
            return (), []
        problems = await self._latch()  # first: the bridges of these servers see the latch and end their repeats
        zeros, failed = await self._zeros(robot, silent)
        return zeros, [*problems, *failed]

    async def _all(
        self, ask: Callable[[Server], Row], patience_s: float, *, of_one: bool = True
    ) -> list[tuple[str, Row | RobotError]]:
        """Return for each server its answer or the error; all are asked at the same time, each in a thread."""
        try:
            servers = await asyncio.to_thread(servers_in, self.at.path, patience_s, of_one=of_one)
        except NotFound:
            return []
        self.at = StateFolder(servers[0].folder)  # a robot named in the policy has a folder of its own

        def answer(server: Server) -> Row | RobotError:
            try:
                return ask(server)
            except RobotError as error:
                return error
            finally:
                server.close()

        answers = await asyncio.gather(*(asyncio.to_thread(answer, server) for server in servers))
        return [(server.path.stem, found) for server, found in zip(servers, answers, strict=True)]

    async def _latch(self) -> list[str]:
        latch = self.at.latch()

        def hold() -> str:
            self.at.make()
            return latch.set(by=f"operator {name_of(own_uid())}", reason="a person stopped the robot on the page")

        try:
            unwritten = await asyncio.to_thread(hold)
        except RobotError as error:
            unwritten = str(error)
        return [f"The latch could not be written: {unwritten}."] if unwritten else []

    async def _zeros(self, robot: Robot, silent: Sequence[str]) -> tuple[Sequence[str], list[str]]:
        """Send zeros on the topics that these servers last reported as moving.

        For a server that never reported, zeros are sent on all velocity topics. Return the topics, and the failures.
        """
        try:
            topics = {
                row.name: kind for row in await robot.graph.topics(1.0) for kind in row.types if kind in VELOCITY_TYPES
            }
        except RobotError as error:
            return (), [f"No zeros could be sent from here: {error}"]
        known = [moved for name in silent for moved in self._moves.get(name, topics)]
        chosen = {name: kind for name, kind in topics.items() if name in known}
        failed = await robot.still(chosen)
        return sorted(chosen.keys() - failed.keys()), [f"No zero on {name}: {why}" for name, why in failed.items()]


def _waiting(request: Row) -> Row:
    """Return what a person sees of a request. Whoever has its nonce can answer it, so the nonce stays here."""
    times = {name: round(request[name]) for name in ("age_s", "left_s")}
    return {"id": request["id"], **times, "summary": request["summary"]}


def _stop_of(server: Server) -> Row:
    """Stop one server, and wait for its answer as long as it is alive. Raises `RobotError`."""
    server.tell("stop")
    try:
        check = Server(server.path, _ALIVE_S)
    except OSError as error:
        raise RobotError(f"The server cannot be reached: {error.strerror or error}.") from error
    try:
        check.do("list")
    except RobotError:
        return server.answer(_LATE_S)
    finally:
        check.close()
    return server.answer()
