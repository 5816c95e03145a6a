"""The agent's activity: its commands and jobs, driven topics, pending approvals, the latch."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from time import time
from typing import Any

from ros2_mcp.guard.approvals import PENDING_S
from ros2_mcp.guard.consent import AUDIT
from ros2_mcp.guard.servers import Row
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import counted, listed
from ros2_mcp.model.times import iso_time
from ros2_mcp.view.acts import MOST_ACTS, acts_in, presses_as_one, told_as_lapsed
from ros2_mcp.view.look import MOST_NAMED, Content, Look, PageContext, Panel
from ros2_mcp.view.recorded_acts import RecordedActs

_ASKED_EVERY_S = 0.5
"""Seconds between two requests to the servers: a person sees a change within a second."""
_SETTLED_S = 2.0
_MOST_ENDED = 20
"""Ended jobs that are kept while the page is open: the audit has no line for their ends."""


class AgentPanel(Panel):
    """Shows the agent's activity: commands, driven topics, pending approvals, the latch."""

    name = "agent"
    period_s = 0.25

    def __init__(self, page: PageContext, now_s: Callable[[], float] = time) -> None:
        super().__init__(page)
        self._acting = page.acting
        self._recorded = None if page.source.is_live else RecordedActs(page.source)
        self._now_s = now_s
        self._asked_at = 0.0
        self._servers: list[Mapping[str, Any]] = []
        self._waited: dict[str, float] = {}
        """The time at which each request was last seen waiting."""
        self._why = ""
        self._jobs: dict[str, Mapping[str, Any]] = {}
        self._ended: list[Mapping[str, Any]] = []

    async def show(self, look: Look) -> Content | None:
        """Return the state of all acting servers and the newest audit entries (up to the time shown)."""
        if abs(self._now_s() - self._asked_at) > _ASKED_EVERY_S:
            self._asked_at, self._why = self._now_s(), ""
            self._servers = await _or_none(self._acting.servers, self._fail)
            waiting = {one["id"] for server in self._servers for one in server.get("waiting", ())}
            self._waited |= dict.fromkeys(waiting, self._asked_at)
            self._note_ended()
        content = {
            "servers": self._servers,
            "latch": self._acting.latch(),
            "folder": self._acting.at.path.name,
            "why": self._why,
        }
        if self._recorded is None:
            acts = await asyncio.to_thread(self._acting.acts)
            told = sorted([*told_as_lapsed(acts, self._waits_no_longer), *self._ended], key=lambda act: act["time"])
            return {**content, "acts": told[-MOST_ACTS:]}
        entries, origin = await self._recorded.until(look.now_ns, self._acting.at.path / AUDIT)
        valid_since = iso_time(look.now_ns - round(PENDING_S * 1e9))
        acts = told_as_lapsed(presses_as_one([*acts_in(entries)]), lambda act: act["time"] < valid_since)
        return {**content, "acts": acts[-MOST_ACTS:], "origin": origin}

    def _note_ended(self) -> None:
        """Note jobs that no longer run. For a server that hangs this is not known."""
        if self._why:
            return
        running = {job["id"]: job for server in self._servers for job in server.get("jobs", ())}
        if all(server["answers"] for server in self._servers):
            gone = [job for job_id, job in self._jobs.items() if job_id not in running]
            self._ended = [*self._ended, *(_ended(job, self._asked_at) for job in gone)][-_MOST_ENDED:]
            self._jobs = {}
        self._jobs |= running

    def _waits_no_longer(self, act: Mapping[str, Any]) -> bool:
        """Return whether an unanswered call no longer waits: it is too old, a stop ended it, or its server has ended.

        Servers and audit agree only after a moment; for a server that hangs this is not known.
        """
        settled_s = self._now_s() - _SETTLED_S
        is_known = not self._why and all(server["answers"] for server in self._servers)
        is_old = act["time"] < iso_time(round(settled_s * 1e9))
        return is_known and is_old and self._waited.get(act.get("approval", ""), 0.0) < settled_s

    def _fail(self, error: RobotError) -> None:
        self._why = str(error)

    def words(self, content: Content) -> str:
        """Return the content in one line for the model."""
        servers: list[Mapping[str, Any]] = list(content.get("servers") or ())
        moves = sorted({str(name) for server in servers for name in server.get("moves", ())})
        waiting = sum(len(server.get("waiting", ())) for server in servers)
        parts = [counted(len(servers), "server"), f"moves {listed(moves, MOST_NAMED)}" if moves else "nothing moves"]
        if waiting:
            parts.append(f"{waiting} wait for approval")
        if latch := content.get("latch"):
            parts.append(f"LATCHED by {latch.get('by')}: {latch.get('reason')}")
        return ", ".join(parts)


async def _or_none(
    ask: Callable[[], Awaitable[list[Mapping[str, Any]]]], failed: Callable[[RobotError], None]
) -> list[Mapping[str, Any]]:
    try:
        return await ask()
    except RobotError as error:
        failed(error)
        return []


def _ended(job: Row, now_s: float) -> Row:
    """Return the end of a job as an entry, at the time at which it was noticed."""
    fields = {"name": job["id"], "verb": job["kind"], "reason": job.get("doing", ""), "duration_s": job.get("for_s")}
    return {"time": iso_time(round(now_s * 1e9)), "kind": "ended", "who": "", "seq": None, "value": None, **fields}
