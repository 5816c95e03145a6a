"""The guard that every command passes before it is carried out. Only `Robot.do` calls it."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

from ros2_mcp.guard.budgets import Budgets
from ros2_mcp.guard.document import Mode
from ros2_mcp.guard.policy import ALLOWED, NO_FACTS, Decision, Facts, Policy, strictest, verb_of
from ros2_mcp.guard.state import RobotLatch, ServerLock
from ros2_mcp.guard.strength import Strength
from ros2_mcp.model.commands import CancelGoals, Command, Feed, Move, Principal, Record, Relay, Repeat
from ros2_mcp.model.errors import ApprovalNeeded, Refused
from ros2_mcp_common.policy.rules import Ruling

FindFacts = Callable[[Ruling | None, bool], Awaitable[Facts]]


@dataclass(slots=True, kw_only=True)
class Act:
    """One command in the guard. `ruling` is the part of the policy's ruling that does not depend on the value.

    `stops` marks a command that ends something that this server began: it is audited and never held back. `approval` is
    the id of the approval that was consumed, `line` the command's line in the audit, `notes` are sentences for the
    result, and `ended_by` is the reason if the command ended early.
    """

    command: Command[Any]
    ruling: Ruling | None = None
    stops: bool = False
    facts: Facts = NO_FACTS
    decision: Decision = ALLOWED
    approval: str = ""
    line: Any = None
    ended_by: str = ""
    notes: list[str] = field(default_factory=list[str])

    @property
    def is_part(self) -> bool:
        """Whether the command, messages for an open relay, belongs to a command that was decided, approved and audited
        before.
        """
        return isinstance(self.command, Feed)


class Approvals(Protocol):
    """A person's approvals, as the guard uses them."""

    @property
    def mode(self) -> Mode:
        """The mode that the operator has set; it can only be stricter than the policy's own."""
        ...

    async def require(self, act: Act) -> str:
        """Consume the approval for this command, and return its id; raises `ApprovalNeeded` if there is none."""
        ...

    def is_waiting(self, request_id: str) -> bool:
        """Return whether that request still waits for an answer."""
        ...

    def end_route(self, route_id: str) -> None:
        """End the approval of a list of goals: its job has ended."""
        ...

    def leave(self, principal: Principal) -> None:
        """Withdraw the waiting requests of a client that has disconnected."""
        ...


class Audit(Protocol):
    """The audit of requests, decisions and outcomes, as the guard uses it."""

    def note(self, kind: str, **fields: Any) -> None:
        """Record any other event, such as a stop; do not wait for the write."""
        ...

    def refused(self, act: Act, error: Exception) -> None:
        """Record that a command was refused; do not wait for the write."""
        ...

    async def before(self, act: Act) -> None:
        """Record a command that is about to be carried out.

        Raises:
            Refused: if the line cannot be written and the policy requires it.
        """
        ...

    def after(self, act: Act, error: BaseException | None) -> None:
        """Record that a command has ended or failed; do not wait for the write."""
        ...

    def close(self) -> None:
        """Write the queued lines, and close the file."""
        ...


class Guard:
    """The policy and everything else that can hold a command back. A part that is None holds nothing back.

    The parts are set where the guard is made (`compose/robot.py`). Without a state folder the latch is kept in memory,
    and other servers are not looked for.
    """

    def __init__(
        self,
        policy: Policy | None = None,
        *,
        latch: RobotLatch | None = None,
        server_lock: ServerLock | None = None,
        strength: Strength = "advisory",
    ) -> None:
        self.policy = policy or Policy()
        self.strength: Strength = strength
        self.latch = latch or RobotLatch()
        self.server_lock = server_lock or ServerLock()
        self.budgets = Budgets()
        self.approvals: Approvals | None = None
        self.audit: Audit | None = None

    @asynccontextmanager
    async def acting(
        self,
        command: Command[Any],
        find_facts: FindFacts | None = None,
        *,
        stops: bool = False,
    ) -> AsyncGenerator[Act, None]:
        """A context manager around the execution of a command. A command that stops something is only audited; a
        command that only reads passes unchecked.

        Args:
            command: the command in its resolved meaning.
            find_facts: called once the command may be allowed and the decision depends on facts. Its arguments are the
                ruling, and whether the value is needed in any case, because an approval covers it.
            stops: whether the command ends something that this server began.

        Raises:
            Refused: if the policy forbids the command, it needs an approval, the latch is set, or a budget is used up.
            BadValue: if the value does not fit its definition.
        """
        act = Act(command=command, ruling=self.policy.ruling(command), stops=stops)
        if verb_of(command) == "read" and not self.policy.read_only:
            yield act
            return
        with ExitStack() as held:
            try:
                if not stops:
                    self._check_state(act)
                    held.enter_context(self.budgets.work(command.principal, _rate_hz(command)))
                    await self._decide(act, find_facts)
                if self.audit:
                    await self.audit.before(act)
            except Exception as error:
                if self.audit:
                    self.audit.refused(act, error)
                raise
            try:
                yield act
            except BaseException as error:
                self._after(act, error)
                raise
            self._after(act, None)

    async def foresee(self, command: Command[Any], find_facts: FindFacts) -> Decision:
        """Return the decision about a command now, without asking a person, consuming an approval or writing a line.

        Raises:
            Refused: if the latch or another server would hold the command back.
            BadValue: if the value does not fit its definition.
        """
        act = Act(command=command, ruling=self.policy.ruling(command))
        self._check_state(act)
        await self._rule(act, find_facts)
        return act.decision

    def check_keeping(self, what: str) -> None:
        """Check whether something, such as a place or a program, may be saved on this machine. Saving moves nothing,
        and a later use is decided then, so only the mode matters.

        Raises:
            Refused: in the mode observe.
        """
        if self.mode != "observe":
            return
        reason = f"Keeping {what} is refused by the policy: the mode is observe: only reading and stopping are allowed."
        if self.audit:
            self.audit.note("refused", reason=reason)
        raise Refused(reason, "ros2_policy shows what is allowed.")

    @property
    def mode(self) -> Mode:
        """The mode in force: the stricter of the policy's mode and the operator's."""
        chosen = self.approvals.mode if self.approvals else self.policy.mode
        return strictest(self.policy.mode, chosen)

    def _check_state(self, act: Act) -> None:
        """Raise `Latched` or `Refused` if the latch or another server holds the command back. A recording sends nothing
        and passes.
        """
        if isinstance(act.command, Record):
            return
        if not isinstance(act.command, CancelGoals):  # a cancellation passes the latch, whoever sent the goal
            self.latch.check(act.command)
        if note := self.server_lock.check():
            act.notes.append(note)

    async def _decide(self, act: Act, find_facts: FindFacts | None) -> None:
        """Raise `Refused` unless the policy allows the command, and `ApprovalNeeded` if it lacks an approval."""
        command = act.command
        waits = await self._rule(act, find_facts)
        if act.decision.verdict == "refused":
            raise Refused(act.decision.reason, act.decision.instead)
        if waits:
            if self.approvals is None:
                raise ApprovalNeeded(f"{command.act} needs an operator's approval, and nobody can give it here.")
            act.approval = await self.approvals.require(act)

    async def _rule(self, act: Act, find_facts: FindFacts | None) -> bool:
        """Set the decision of the policy, with the facts that it needs; return whether the command needs an
        approval.
        """
        ruling = act.ruling
        matter = ruling is not None and not act.is_part and (ruling.needs_value or ruling.needs_publishers)
        has_facts, has_value = not matter, False
        while True:  # decide again with each new fact, in the mode of that moment: an operator may have changed it
            act.decision = self.policy.judge(act.command, ruling, act.facts if has_facts else None, self.mode)
            waits = act.decision.verdict == "consent" and not act.is_part
            is_known = has_facts and (has_value or not waits)
            if act.decision.verdict == "refused" or is_known or not find_facts:
                break
            act.facts, has_facts, has_value = await find_facts(ruling, waits), True, waits
        return waits

    def _after(self, act: Act, error: BaseException | None) -> None:
        if self.audit:
            self.audit.after(act, error)


def _rate_hz(command: Command[Any]) -> float:
    """Return the rate at which the bridge will publish for the command, in Hz; 0 if unknown, or for a single
    message.
    """
    return command.rate_hz or 0.0 if isinstance(command, Repeat | Move | Relay) else 0.0
