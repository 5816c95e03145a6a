"""Read the audit: a client's commands, refusals, and their outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from anyio import to_thread

from ros2_mcp.guard.chain import newest
from ros2_mcp.guard.consent import Auditing
from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.text import counted, named, quoted
from ros2_mcp.ops.results.results import HIDDEN
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session

MOST = 500
"""The most acts in one answer."""
_LINES = 20
"""The most acts in a summary; the values have all."""
_SHOWN = ("act", "waits", "refused", "goal ended")
_MOST_LINES = 100_000
"""The most lines of the audit that are searched for the acts of one client among the acts of others: they are read in a
second.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditedAct:
    """One entry of the audit. `outcome` is empty while the command runs, or if its server ended before the command did.

    `verb` is the kind of command; `goal ended` for the end of a goal, `refused` for a call that was refused before its
    command was known. `program` is the program and its line that gave the command: `program_0f3a9c21, line 3`. `value`
    is the message, request, goal or parameters; other commands, such as a lifecycle transition, are stored under its
    key `value`.
    """

    number: int
    time: str
    tool: str = ""
    verb: str = ""
    name: str = ""
    type: str = ""
    outcome: str = ""
    reason: str = ""
    rule: str = ""
    approval: str = ""
    program: str = ""
    value: Mapping[str, Any] | None = None

    def in_words(self) -> str:
        """Return the result in one line."""
        outcome = quoted(self.outcome or self.reason) if self.outcome or self.reason else "no outcome known"
        return f"{self.number} {self.time} {self.verb} {named(self.name)}: {outcome}"


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditExcerpt:
    """The newest audit entries of the calling client, the oldest first. `head` is the hash at the end of the chain;
    `error` says why the audit cannot be written.
    """

    entries: Sequence[AuditedAct]
    head: str
    error: str
    note: str = ""
    shown: Sequence[str] = field(default=(), metadata=HIDDEN)

    def summary(self) -> list[str]:
        """Return the count, and a line for each of the newest entries."""
        entries = counted(len(self.entries), "audit entry", "audit entries")
        return [f"{entries} for this client; last hash of the chain: {self.head}.", *self.shown]


async def read(robot: Robot, session: Session, limit: int = 50) -> AuditExcerpt:
    """Return the newest acts of the client that asks.

    Raises:
        BadValue: if the limit is out of range.
    """
    bounded("limit", limit, 1, MOST, "acts")
    auditing = robot.guard.audit
    if not isinstance(auditing, Auditing) or auditing.log.path is None:
        return AuditExcerpt(entries=(), head="", error="", note="This server keeps no audit.")
    await auditing.log.written()  # it then has what this client has just done
    acts = await to_thread.run_sync(_acts, auditing.log.path, session.principal.name, limit)
    return AuditExcerpt(
        entries=acts,
        head=auditing.log.head.short,
        error=auditing.log.failed,
        note=f"The audit cannot be written: {auditing.log.failed}." if auditing.log.failed else "",
        shown=[act.in_words() for act in acts[-_LINES:]],
    )


def _acts(folder: Path, principal: str, limit: int) -> list[AuditedAct]:
    outcomes: dict[Any, str] = {}
    found: list[AuditedAct] = []
    for entry in islice(newest(folder), _MOST_LINES):
        kind, number = entry.get("kind"), entry.get("seq")
        if kind == "outcome":
            outcomes[entry.get("of")] = str(entry.get("outcome", ""))
        elif kind in _SHOWN and entry.get("principal") == principal:
            outcome = outcomes.get(number, "") or str(entry.get("outcome", ""))
            found.append(AuditedAct(number=int(number or 0), outcome=outcome, **_fields(entry)))
            if len(found) == limit:
                break
    return found[::-1]


def _fields(entry: Mapping[str, Any]) -> dict[str, Any]:
    names = ("time", "tool", "verb", "name", "type", "reason", "rule", "approval", "program")
    value: Any = entry.get("value")
    has_fields = type(value) in (dict, type(None))
    fields = {name: str(entry.get(name, "")) for name in names}
    fields["verb"] = fields["verb"] or str(entry.get("kind", ""))
    return {**fields, "value": value if has_fields else {"value": value}}
