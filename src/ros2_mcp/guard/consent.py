"""What the guard asks of approvals and of the audit: acts on their way, as exact commands."""

from __future__ import annotations

from asyncio import CancelledError
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ros2_mcp.guard import words
from ros2_mcp.guard.approvals import MOST_GRANT_S, VALID_S, Approvals
from ros2_mcp.guard.audit import Audit
from ros2_mcp.guard.audit_file import KEEP_BYTES
from ros2_mcp.guard.document import Mode
from ros2_mcp.guard.exact import ExactCommand
from ros2_mcp.guard.guard import Act, Guard
from ros2_mcp.guard.modes import Modes
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import ApprovalNeeded, Stopped

AUDIT = "audit"
"""The folder of the audit within the state folder."""


class Consent:
    """A person's consent: the mode that the operator has chosen, and what was approved."""

    def __init__(self, approvals: Approvals, modes: Modes, policy: Policy) -> None:
        self.approvals = approvals
        self.modes = modes
        self._policy = policy

    @property
    def mode(self) -> Mode:
        """What the operator has chosen."""
        return self.modes.now

    async def require(self, act: Act) -> str:
        """The id of the approval that fits, used up now. Raises `ApprovalNeeded` or `Refused`."""
        ruling = self._policy.ruling(act.command)
        exact = exact_of(act, self._policy.digest, self.approvals.epoch())
        return self.approvals.require(exact, words.bounds(ruling) if ruling else "")

    def is_waiting(self, request_id: str) -> bool:
        """Whether nobody has answered that request yet."""
        return any(one.id == request_id for one in self.approvals.waiting())

    def leave(self, principal: Principal) -> None:
        """Nobody is asked any more for a client that has gone."""
        self.approvals.leave(principal)


class Auditing:
    """The audit of what passes the guard: a line before each act, one after it, and one for each refusal.

    Messages of a relay or playback have no lines of their own: it was written down when it began.
    """

    def __init__(self, log: Audit, policy: str, epoch: Callable[[], str]) -> None:
        self.log = log
        self._policy = policy
        self._epoch = epoch

    def note(self, kind: str, **fields: Any) -> None:
        """Something else has happened; does not wait for it to be written."""
        self.log.note(kind, **fields)

    def close(self) -> None:
        """Writes what is left, and closes the file."""
        self.log.close()

    def refused(self, act: Act, error: Exception) -> None:
        """It does not happen, and why not, or waits for a person."""
        exact = exact_of(act, self._policy, self._epoch())
        line = exact.line(rule=act.decision.rule, reason=f"{type(error).__name__}: {error}")
        if isinstance(error, ApprovalNeeded):
            self.log.note("waits", approval=error.request_id, **line)
        else:
            self.log.note("refused part" if act.is_part else "refused", **line)

    async def before(self, act: Act) -> None:
        """It is about to happen. Raises `Refused` where it cannot be written and must be; what stops does not wait."""
        if act.is_part:
            return
        exact = exact_of(act, self._policy, self._epoch())
        line = exact.line(rule=act.decision.rule, decision=act.decision.verdict, approval=act.approval)
        act.line = await self.log.before(line, stops=act.stops)

    def after(self, act: Act, error: BaseException | None) -> None:
        """It has happened, or failed."""
        if not act.is_part:
            self.log.after(act.line, _outcome(error, act.ended_by))


def exact_of(act: Act, policy: str, epoch: str) -> ExactCommand:
    """The exact command of an act."""
    return ExactCommand.of(act.command, act.facts.value, policy=policy, epoch=epoch, told=act.facts.told)


def _outcome(error: BaseException | None, ended_by: str) -> str:
    if error is None:
        return f"ended before its time: {ended_by}" if ended_by else "done"
    if isinstance(error, CancelledError):
        return "cancelled"
    return f"{'stopped' if isinstance(error, Stopped) else 'failed'}: {type(error).__name__}: {error}"


def with_consent(guard: Guard, folder: StateFolder, epoch: Callable[[], str]) -> Consent:
    """Gives a guard its approvals and its audit.

    Args:
        guard: with its policy.
        folder: the state folder; it is made when something is first written.
        epoch: in which stop epoch and at which latch the robot is: what was approved in another one has lapsed.
    """
    policy: Policy = guard.policy
    documents = policy.documents
    log = Audit(
        lambda: audit_folder(folder),
        path=folder.path / AUDIT,
        policy=policy.digest,
        required=any(document.audit.on_failure == "refuse" for document in documents),
        # The most that one of them wants: who adds a policy must not make room for what was done by dropping it.
        keep_bytes=max((kept for document in documents if (kept := document.audit.keep_bytes)), default=KEEP_BYTES),
    )
    approvals = Approvals(
        valid_s=min((document.consent.valid_s for document in documents), default=VALID_S),
        most_grant_s=min((document.consent.grants_s for document in documents), default=MOST_GRANT_S),
        epoch=epoch,
        changed=lambda kind, fields: log.note(kind, **fields),
    )
    consent = Consent(approvals, Modes(folder, most=policy.mode, policy=policy.digest), policy)
    guard.approvals = consent
    guard.audit = Auditing(log, policy.digest, epoch)
    return consent


def audit_folder(state: StateFolder) -> Path:
    """The folder of the audit, made if it was not there. Raises `StateUnusable` or `OSError`."""
    folder = state.make() / AUDIT
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder
