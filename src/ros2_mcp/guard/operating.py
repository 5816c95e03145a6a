"""The operator's access to a server: a socket in the state folder, with one line of JSON per request and answer.

`operators.py` decides who is an operator. An agent can only reach the socket through a shell of the same user; in that
case the server reports its policy as advisory.
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import socket
from collections.abc import AsyncGenerator, Awaitable, Callable, Collection, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

from ros2_mcp.guard.approvals import Approvals, Grant, Request
from ros2_mcp.guard.audit import Audit
from ros2_mcp.guard.exact import word
from ros2_mcp.guard.modes import Modes
from ros2_mcp.guard.operators import SHOWN_S, OperatorSocket, is_left_behind, listen_at, may_operate, name_of
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp_common.latch import Latch, ResetRefused

RESET = "The latch is reset: what acts may act again. Nothing was started."
_PREFIX, _SUFFIX = "operate-", ".sock"
_LINE_BYTES = 65_536
"""The longest request, in bytes; ours have some hundred."""
_MOST_CLIENTS = 16
"""The most connections at a time: an operator has one or two terminals or scripts."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class StopAnswer:
    """The observed result of a stop, in words.

    `is_doubted`: not everything that this server moves is confirmed to be stopped. `is_observed_still`: the robot's own
    sensors reported afterwards that it is stationary.
    """

    done: str
    is_doubted: bool
    is_observed_still: bool = False


@dataclass(frozen=True, kw_only=True)
class Operated:
    """The parts of a server that an operator works on. `stop` stops the robot on behalf of a name, and returns the
    result.

    `status` returns further entries of the list: `moves`, the topics and actions by which this server moves the robot
    now, and `jobs`, the running work that is no command, such as a recording.
    """

    robot: str
    policy: Policy
    approvals: Approvals
    modes: Modes
    audit: Audit
    latch: Latch
    stop: Callable[[str], Awaitable[StopAnswer]]
    status: Callable[[], Mapping[str, Any]] = field(default=dict[str, Any])


@asynccontextmanager
async def operating(
    folder: StateFolder, operated: Operated, usual: StateFolder | None = None
) -> AsyncGenerator[None, None]:
    """A context manager in which operators can connect. If the socket cannot be opened, this is logged, and the robot
    works without.

    `usual` is the folder in which an operator looks who names no policy: a link to the socket is put there as well.
    """
    path: Path | None = None
    link: Path | None = None
    server: asyncio.Server | None = None
    clients: _Clients | None = None
    try:
        path = folder.make() / f"{_PREFIX}{secrets.token_hex(4)}{_SUFFIX}"
        at = listen_at(path, _logger.warning)
        clients = _Clients(operated, at)
        server = await asyncio.start_server(clients.serve, sock=at.listener, limit=_LINE_BYTES)
        link = _linked(path, usual) if usual and usual != folder else None
        await asyncio.to_thread(_clear, {path, link}, {folder.path, (usual or folder).path})
    except (OSError, RobotError) as error:
        _logger.warning("no operator can connect: %s", error)
    try:
        yield
    finally:
        if server and clients:
            server.close()
            await clients.end()
        for made in filter(None, (link, path)):
            made.unlink(missing_ok=True)


def _linked(path: Path, usual: StateFolder) -> Path | None:
    """Create a link to the socket in the usual folder; None, with a log entry, if that fails."""
    try:
        link = usual.make() / path.name
        link.symlink_to(path.absolute())
    except (OSError, RobotError) as error:
        _logger.warning("operators have to name the policy or its state folder: %s", error)
        return None
    return link


def sockets_of(folder: Path) -> list[Path]:
    """Return the paths of operator sockets in a folder, and of links to the sockets of robots with a state folder of
    their own.
    """
    return sorted(folder.glob(f"{_PREFIX}*{_SUFFIX}"))


def _clear(own: Collection[Path | None], folders: Collection[Path]) -> None:
    """Remove sockets whose server was killed, and links to them; keep sockets in use."""
    for path in (each for folder in folders for each in sockets_of(folder) if each not in own):
        if is_left_behind(path):
            with suppress(OSError):  # another user's, or another server has just removed it
                path.unlink()


class _Clients:
    """The connected operators, and the answers to their requests."""

    def __init__(self, operated: Operated, at: OperatorSocket) -> None:
        self._operated = operated
        self._socket = at
        self._serving: dict[asyncio.Task[None], asyncio.StreamWriter] = {}

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until it is closed."""
        peer: socket.socket = writer.get_extra_info("socket")
        task = cast("asyncio.Task[None]", asyncio.current_task())
        self._serving[task] = writer
        try:
            uid = await self._socket.user(reader, peer)
            if not may_operate(uid):
                with suppress(asyncio.TimeoutError):  # closing a socket with an unread request discards the answer
                    await asyncio.wait_for(reader.readline(), SHOWN_S)
                self._operated.audit.note("operator refused", by=name_of(uid), uid=uid)
                await _send(writer, {"ok": False, "error": f"{name_of(uid)} is not an operator of this robot."})
            elif len(self._serving) > _MOST_CLIENTS:
                await _send(writer, {"ok": False, "error": "Too many operators are connected."})
            else:
                await self._answer_all(reader, writer, f"operator {name_of(uid)}")
        except (ConnectionError, ValueError, asyncio.LimitOverrunError):
            pass
        finally:
            del self._serving[task]
            writer.close()

    async def end(self) -> None:
        """Close all connections."""
        tasks = [*self._serving]
        for writer in self._serving.values():
            writer.close()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _answer_all(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, by: str) -> None:
        while line := await reader.readline():
            try:
                answer = {"ok": True, **await self._answer(json.loads(line), by)}
            except (RobotError, ResetRefused) as error:
                answer = {"ok": False, "error": str(error)}
            except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
                answer = {"ok": False, "error": f"this request cannot be read: {type(error).__name__}: {error}"}
            await _send(writer, answer)

    async def _answer(self, request: Mapping[str, Any], by: str) -> Mapping[str, Any]:
        approvals, what = self._operated.approvals, request["do"]
        if what == "list":
            return self._listed()
        if what == "show":
            found = approvals.find(str(request["id"]))
            return {"request": self._request(found), "value": found.exact.value, "more": found.exact.line()}
        nonce = str(request.get("nonce", ""))
        if what == "approve":
            return {"done": f"{approvals.approve(str(request['id']), nonce, by=by).id} is approved, once."}
        if what == "deny":
            return {"done": f"{approvals.deny(str(request['id']), nonce, by=by).id} is denied."}
        if what == "grant":
            bounds = {str(path): float(most) for path, most in dict(request.get("most") or {}).items()}
            for_s = float(request["for_s"])
            grant = approvals.grant(str(request["id"]), for_s, bounds, nonce=nonce, by=by)
            return {"done": f"{grant.id} is granted for {for_s:g} s: {grant.in_words()}."}
        if what == "revoke":
            return {"done": f"The grant {approvals.revoke(str(request['id']), by=by).id} has ended."}
        return await self._change(request, by)

    async def _change(self, request: Mapping[str, Any], by: str) -> Mapping[str, Any]:
        """Carry out a request about the whole robot: mode, stop or reset."""
        operated, what = self._operated, request["do"]
        if what == "mode":
            before = operated.modes.set(str(request["mode"]))
            operated.audit.note("mode", by=by, before=before, now=operated.modes.now)
            return {"done": f"The mode is {operated.modes.now}; it was {before}."}
        if what == "stop":
            operated.audit.note("stop", by=by)
            stopped = await operated.stop(by)
            return asdict(stopped)
        if what == "reset":
            state = operated.latch.look()
            if not state.is_set:
                return {"done": "The latch is not set."}
            await asyncio.to_thread(operated.latch.reset, by=by, seen=int(request.get("seen", state.count)))
            operated.audit.note("reset", by=by, was=state.reason, count=state.count)
            return {"done": RESET}
        raise BadInput(f"There is nothing called {word(str(what))} to do.")

    def _listed(self) -> Mapping[str, Any]:
        operated = self._operated
        latch = operated.latch.look()
        return {
            "robot": operated.robot,
            "mode": operated.modes.now if operated.policy.in_force else "",
            "policy": operated.policy.digest,
            "latch": {"by": latch.by, "reason": latch.reason, "since": latch.since, "count": latch.count}
            if latch.is_set
            else None,
            "audit": {"head": operated.audit.head.short, "failed": operated.audit.failed},
            "waiting": [self._request(request) for request in operated.approvals.waiting()],
            "grants": [self._grant(grant) for grant in operated.approvals.grants()],
            **operated.status(),
        }

    def _request(self, request: Request) -> Mapping[str, Any]:
        approvals = self._operated.approvals
        return {
            "id": request.id,
            "nonce": request.nonce,
            "age_s": round(approvals.age_s(request), 1),
            "left_s": round(approvals.seconds_left(request), 1),
            "summary": request.summary(),
        }

    def _grant(self, grant: Grant) -> Mapping[str, Any]:
        left_s = round(self._operated.approvals.seconds_left(grant), 1)
        return {"id": grant.id, "left_s": left_s, "by": grant.by, "what": grant.in_words()}


async def _send(writer: asyncio.StreamWriter, answer: Mapping[str, Any]) -> None:
    writer.write(json.dumps(answer, default=str).encode() + b"\n")
    await writer.drain()
