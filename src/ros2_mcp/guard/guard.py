"""The one place through which everything that acts has to pass: `Robot.do` alone enters it."""

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
    """One command on its way through the guard. `ruling` is what the rules say about it whatever its value.

    `stops` is what ends something that this server began: it is never held, only audited. `approval` is the id of the
    approval that it used up, `line` its line in the audit. `notes` are sentences for the result, `ended_by` is what
    ended it before its time.
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
        """Whether it is part of what was decided, approved and audited before: messages for an open relay."""
        return isinstance(self.command, Feed)


class Approvals(Protocol):
    """What persons have approved."""

    @property
    def mode(self) -> Mode:
        """What the operator has chosen; it can only be stricter than the policy's own."""
        ...

    async def require(self, act: Act) -> str:
        """The id of the approval that fits, used up now; raises `ApprovalNeeded` where there is none."""
        ...

    def is_waiting(self, request_id: str) -> bool:
        """Whether nobody has answered that request yet."""
        ...

    def leave(self, principal: Principal) -> None:
        """Takes back what a client that has gone has asked for."""
        ...


class Audit(Protocol):
    """Writes down what was asked, decided and done."""

    def note(self, kind: str, **fields: Any) -> None:
        """Something else has happened, such as a stop; does not wait for it to be written."""
        ...

    def refused(self, act: Act, error: Exception) -> None:
        """It does not happen; does not wait for it to be written."""
        ...

    async def before(self, act: Act) -> None:
        """It is about to happen. Raises `Refused` where it cannot be written and the policy says so."""
        ...

    def after(self, act: Act, error: BaseException | None) -> None:
        """It has happened, or failed; does not wait for it to be written."""
        ...

    def close(self) -> None:
        """Writes what is left, and closes the file."""
        ...


class Guard:
    """The policy, and around it all that can hold a command back. Whatever is None holds nothing back.

    Who builds one of these sets it where the guard is made (`compose/robot.py`). Without a state folder the latch is
    kept in memory, and no other server is looked for.
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
        """Around a command that is carried out. What stops something is only audited; what only reads passes.

        Args:
            command: as it is meant.
            find_facts: asked once it is known that the command may be allowed, and that facts matter. It is told
                what the rules say, and whether the value is needed whatever they are about: what a person approves is
                bound to it.
            stops: whether it ends something that this server began.

        Raises:
            Refused: if the policy forbids it, it waits for an approval, the latch is set, or a budget is used up.
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
        """What would be decided about a command now. Nobody is asked, and nothing is used up or written.

        Raises:
            Refused: where the latch or another server would hold it.
            BadValue: if the value does not fit its definition.
        """
        act = Act(command=command, ruling=self.policy.ruling(command))
        self._check_state(act)
        await self._rule(act, find_facts)
        return act.decision

    def check_keeping(self, what: str) -> None:
        """Before something is kept on this machine, such as a place or a program. It moves nothing, and what is made of
        it is decided then: the mode alone decides.

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
        """What holds now: the stricter one of the policy's mode and the operator's."""
        chosen = self.approvals.mode if self.approvals else self.policy.mode
        return strictest(self.policy.mode, chosen)

    def _check_state(self, act: Act) -> None:
        """Raises `Latched` or `Refused` where the latch or another server holds it. Recording sends nothing."""
        if isinstance(act.command, Record):
            return
        if not isinstance(act.command, CancelGoals):  # ends something, whoever began it
            self.latch.check(act.command)
        if note := self.server_lock.check():
            act.notes.append(note)

    async def _decide(self, act: Act, find_facts: FindFacts | None) -> None:
        """Raises `Refused` unless the policy allows it, or somebody has approved it."""
        command = act.command
        waits = await self._rule(act, find_facts)
        if act.decision.verdict == "refused":
            raise Refused(act.decision.reason, act.decision.instead)
        if waits:
            if self.approvals is None:
                raise ApprovalNeeded(f"{command.act} needs an operator's approval, and nobody can give it here.")
            act.approval = await self.approvals.require(act)

    async def _rule(self, act: Act, find_facts: FindFacts | None) -> bool:
        """Notes what the policy decides, with the facts that it needs; whether a person has to approve it."""
        ruling = act.ruling
        matter = ruling is not None and not act.is_part and (ruling.needs_value or ruling.needs_publishers)
        has_facts, has_value = not matter, False
        while True:  # each time with what is known by now, and in the mode that an operator may have chosen meanwhile
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
    """How many messages a second the bridge will publish for it; 0 where that is not known, or it is once."""
    return command.rate_hz or 0.0 if isinstance(command, Repeat | Move | Relay) else 0.0
