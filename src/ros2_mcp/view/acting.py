"""Who acts on the robot from this machine, what they do now, and the button that stops them all."""

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
"""For the answer of a server that is alive: it looks nothing up. One that hangs has lost its link lease in a second."""
_STOPPED_S = 15.0
"""For the whole answer of a stop, which waits some seconds for goals to end and to see that the robot stands."""
_LATE_S = 2.0
"""For that of a server that was found silent, and may only have been slow: all is done in its place meanwhile."""
_TAIL_BYTES = 96_000
"""Of the audit: some hundred lines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoppedServer:
    """One server that was told to stop: whether it has answered, and what it says was observed.

    `is_doubted`: it has answered that it is not confirmed that the robot stands; `is_observed_still`: but odometry or
    joint states told that it does.
    """

    name: str
    answered: bool
    said: str
    is_doubted: bool = False
    is_observed_still: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StoppedAll:
    """What became of a press of the button.

    `zeros` are the topics on which zeros were sent from here, as a server did not answer; `problems` what could not be
    done. `latched`: nothing acts any more until an operator resets it.
    """

    servers: Sequence[StoppedServer]
    zeros: Sequence[str] = ()
    latched: bool
    problems: Sequence[str] = ()
    is_all_well: bool = field(default=False)

    def summary(self) -> str:
        """One line: how many answered, what was done for those that did not, and whether it is latched."""
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
    """The acting servers of one robot, as its state folder has them. `at` is that folder."""

    def __init__(self, at: StateFolder) -> None:
        self.at = at
        self._moves: dict[str, Sequence[str]] = {}
        self._audit: tuple[tuple[object, ...], list[Mapping[str, Any]]] = ((), [])

    async def servers(self) -> list[Mapping[str, Any]]:
        """What each server says of itself now; one that hangs is told as such."""
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
        """By whom and why the latch is set; None while it is not."""
        state = self.at.latch().look()
        return {"by": state.by, "reason": state.reason, "since_s": state.since} if state.is_set else None

    def acts(self) -> list[Mapping[str, Any]]:
        """The newest acts of all servers, the oldest first, each with what became of it."""
        folder = self.at.path / AUDIT
        files = files_of(folder)[-1:] if folder.is_dir() else []
        seen = tuple((path.name, path.stat().st_size) for path in files)
        if seen != self._audit[0]:
            self._audit = seen, presses_as_one([*acts_in(tail(folder, _TAIL_BYTES))])[-MOST_ACTS:]
        return self._audit[1]

    async def stop(self, robot: Robot) -> StoppedAll:
        """Stops every server, sends the zeros for those that do not answer, and sees to it that the latch is set."""
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
                # Of a server that does not say, as of an earlier version, it is not known.
                is_doubted=not isinstance(answer, RobotError) and answer.get("is_doubted") is not False,
                is_observed_still=not isinstance(answer, RobotError) and answer.get("is_observed_still") is True,
            )
            for name, answer in answers
        ]
        is_latched = self.at.latch().look().is_set
        is_all_well = is_latched and not problems and all(one.answered and not one.is_doubted for one in servers)
        return StoppedAll(servers=servers, zeros=zeros, latched=is_latched, problems=problems, is_all_well=is_all_well)

    async def _instead(self, robot: Robot) -> tuple[Sequence[str], list[str]]:
        """Does for servers that do not answer what they were told: the topics that got zeros, and what failed."""
        alive = await self._all(lambda server: server.do("list"), _ALIVE_S, of_one=False)
        silent = [name for name, answer in alive if isinstance(answer, RobotError)]
        if not silent:
            return (), []
        problems = await self._latch()  # first: their bridges look at it, and end what they repeat
        zeros, failed = await self._zeros(robot, silent)
        return zeros, [*problems, *failed]

    async def _all(
        self, ask: Callable[[Server], Row], patience_s: float, *, of_one: bool = True
    ) -> list[tuple[str, Row | RobotError]]:
        """The answer of each server, or why it has given none, all asked at the same time, each in a thread."""
        try:
            servers = await asyncio.to_thread(servers_in, self.at.path, patience_s, of_one=of_one)
        except NotFound:
            return []
        self.at = StateFolder(servers[0].folder)  # a robot that its policy names has a folder of its own

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
        """Sends zeros on what those servers moved when they last said; of one that never did, on all velocities."""
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
    """What a person sees of a request; it is answered by who has its nonce, which stays here."""
    times = {name: round(request[name]) for name in ("age_s", "left_s")}
    return {"id": request["id"], **times, "summary": request["summary"]}


def _stop_of(server: Server) -> Row:
    """Stops one, and waits for its answer as long as it is alive. Raises `RobotError`."""
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
