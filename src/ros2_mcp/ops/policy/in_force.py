"""Describe the policy in force in words and numbers, so that an agent plans within it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ros2_mcp.guard import words
from ros2_mcp.guard.document import Document
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.watch import most_of
from ros2_mcp.ops.results.results import IF_ANY, SAID
from ros2_mcp.robot import Robot

NONE = (
    "No policy is in force: whatever fits its definition is sent. Start small and slow. (The operator can have one: "
    "ros2-mcp policy init.)"
)
_READ_ONLY = "This server is read-only: no command is allowed."
_ALWAYS = "Reading, ros2_stop and cancelling your own goals are always allowed; whatever no line allows is refused."
_LATCHED = "A stop is latched: commands are refused until an operator resets it."
_MODES = {
    "observe": "Mode observe: only reading and stopping, until the operator changes it.",
    "confirm": "Mode confirm: a person approves each command that acts; the refusal says how.",
    "autonomous": "",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class InForce:
    """What is allowed. With several `policies` each of them has to allow it."""

    in_force: bool = field(metadata=SAID)
    policies: Sequence[str] = field(metadata=SAID)
    mode: str
    strength: str = field(metadata=SAID)
    digest: str
    allowed: Sequence[str]
    limits: Sequence[str]
    forbidden: Sequence[str]
    held: str
    tools_not_allowed: Sequence[str] = field(default=(), metadata=SAID)
    """Tools that the policy allows for nothing."""
    note: str = field(metadata=IF_ANY)

    def summary(self) -> list[str]:
        """Return the whole description, a line for each part."""
        if not self.in_force:
            return [self.note]
        head = f"Policy {' and '.join(self.policies)} ({self.strength})."
        parts = (("Allowed", self.allowed), ("Limits", self.limits), ("Forbidden", self.forbidden))
        held = [self.held] if self.held else []
        tools = ", ".join(self.tools_not_allowed)
        refused = [f"Tools that are not allowed: {tools}."] if tools else []
        return [head, *held, *(f"{title}: {line}" for title, lines in parts for line in lines), *refused, self.note]


async def in_force(robot: Robot) -> InForce:
    """Return the policy of this server in words, without the path of its file."""
    guard, policy = robot.guard, robot.policy
    held = _LATCHED if guard.latch.look().is_set else ""
    said = [_MODES[guard.mode], _ALWAYS] if policy.in_force else [NONE]
    note = " ".join(filter(None, [*(document.about for document in policy.documents), *said]))
    most = most_of(policy)
    return InForce(
        in_force=policy.in_force,
        policies=[document.name for document in policy.documents],
        mode=guard.mode,
        strength=guard.strength if policy.in_force else "",
        digest=policy.digest,
        allowed=_lines(policy, lambda document: words.allowed(document.rules)),
        limits=_lines(policy, lambda document: [*words.limits(document.rules), *words.watched(document, most)]),
        forbidden=_lines(policy, lambda document: words.forbidden(document.rules)),
        held=held,
        note=_READ_ONLY if policy.read_only else note,
    )


def _lines(policy: Policy, told: Callable[[Document], list[str]]) -> list[str]:
    """Return the lines of each policy; if there are several, with its name."""
    several = len(policy.documents) > 1
    return [
        f"[{document.name}] {line}" if several else line for document in policy.documents for line in told(document)
    ]
