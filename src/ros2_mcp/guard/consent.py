"""The guard's interface to approvals and the audit: turns commands in progress into exact commands."""

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
    """A person's consent: the mode that the operator has set, and the approvals."""

    def __init__(self, approvals: Approvals, modes: Modes, policy: Policy) -> None:
        self.approvals = approvals
        self.modes = modes
        self._policy = policy

    @property
    def mode(self) -> Mode:
        """The mode that the operator has set."""
        return self.modes.now

    async def require(self, act: Act) -> str:
        """Consume the approval for this command, and return its id. Raises `ApprovalNeeded` or `Refused`."""
        ruling = self._policy.ruling(act.command)
        exact = exact_of(act, self._policy.digest, self.approvals.epoch())
        return self.approvals.require(exact, words.bounds(ruling) if ruling else "")

    def is_waiting(self, request_id: str) -> bool:
        """Return whether that request still waits for an answer."""
        return any(one.id == request_id for one in self.approvals.waiting())

    def end_route(self, route_id: str) -> None:
        """End the approval of a list of goals."""
        self.approvals.end_route(route_id)

    def leave(self, principal: Principal) -> None:
        """Withdraw the waiting requests of a client that has disconnected."""
        self.approvals.leave(principal)


class Auditing:
    """The audit of the commands that pass the guard: a line before each command, a line after it, and a line for each
    refusal.

    Single messages of a relay or playback have no lines: the start of the relay or playback has.
    """

    def __init__(self, log: Audit, policy: str, epoch: Callable[[], str]) -> None:
        self.log = log
        self._policy = policy
        self._epoch = epoch

    def note(self, kind: str, **fields: Any) -> None:
        """Queue a line about any other event; do not wait for the write."""
        self.log.note(kind, **fields)

    def close(self) -> None:
        """Write the queued lines, and close the file."""
        self.log.close()

    def refused(self, act: Act, error: Exception) -> None:
        """Record that a command was refused, or waits for a person, and the reason."""
        exact = exact_of(act, self._policy, self._epoch())
        line = exact.line(rule=act.decision.rule, reason=f"{type(error).__name__}: {error}")
        if isinstance(error, ApprovalNeeded):
            self.log.note("waits", approval=error.request_id, **line)
        else:
            self.log.note("refused part" if act.is_part else "refused", **line)

    async def before(self, act: Act) -> None:
        """Record a command that is about to be carried out. A stop does not wait for the write.

        Raises:
            Refused: if the line cannot be written and the audit is required.
        """
        if act.is_part:
            return
        exact = exact_of(act, self._policy, self._epoch())
        line = exact.line(rule=act.decision.rule, decision=act.decision.verdict, approval=act.approval)
        act.line = await self.log.before(line, stops=act.stops)

    def after(self, act: Act, error: BaseException | None) -> None:
        """Record the outcome of a command."""
        if not act.is_part:
            self.log.after(act.line, _outcome(error, act.ended_by))


def exact_of(act: Act, policy: str, epoch: str) -> ExactCommand:
    """Return the exact command that is approved and audited."""
    facts = act.facts
    return ExactCommand.of(act.command, facts.value, policy=policy, epoch=epoch, told=facts.told, route=facts.route)


def _outcome(error: BaseException | None, ended_by: str) -> str:
    if error is None:
        return f"ended before its time: {ended_by}" if ended_by else "done"
    if isinstance(error, CancelledError):
        return "cancelled"
    return f"{'stopped' if isinstance(error, Stopped) else 'failed'}: {type(error).__name__}: {error}"


def with_consent(guard: Guard, folder: StateFolder, epoch: Callable[[], str]) -> Consent:
    """Attach approvals and an audit to a guard, and return the consent.

    Args:
        guard: the guard, with its policy.
        folder: the state folder; it is created at the first write.
        epoch: returns an identifier of the present stop epoch and state of the latch; approvals of another one have
            lapsed.
    """
    policy: Policy = guard.policy
    documents = policy.documents
    log = Audit(
        lambda: audit_folder(folder),
        path=folder.path / AUDIT,
        policy=policy.digest,
        required=any(document.audit.on_failure == "refuse" for document in documents),
        # The largest of the sizes: otherwise adding a policy could delete lines about earlier commands.
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
    """Return the folder of the audit, and create it if necessary. Raises `StateUnusable` or `OSError`."""
    folder = state.make() / AUDIT
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder
