"""What this server allows: one place that decides, and never acts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ros2_mcp.guard.document import Document, Mode
from ros2_mcp.model import commands
from ros2_mcp.model.commands import SERVER, Command, ServiceBorne
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.text import named
from ros2_mcp_common.policy.rules import NO_TERMS, NO_VALUE, Rules, RuleSet, Ruling, Terms
from ros2_mcp_common.policy.trajectory_limits import LookAtJoints, nobody_measures
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES
from ros2_mcp_common.policy.verbs import Verb, meaning

MODES: Sequence[Mode] = ("observe", "confirm", "autonomous")
"""From the strictest to the one that asks least."""
VERBS: Sequence[Verb] = ("publish", "relay", "play", "call", "goal", "cancel", "set", "transition", "record")
"""What rules are about, as policy files write it; reading is always allowed."""
_ALL_TOPICS = "/…" * 9
"""Stands for every topic of a recording: no pattern that anybody writes fits it but `/**`."""
_MOST_NAMED = 5
"""Names in one sentence; the tool that tells of the policy has all."""
_MILDEST = ("never", "", "each")
_TOLD_BY_POLICY = "ros2_policy shows what is allowed."
_DOING: Mapping[Verb, str] = {
    "publish": "publishing",
    "relay": "relaying",
    "play": "playing bags",
    "call": "calling services",
    "goal": "sending goals",
    "cancel": "cancelling the goals of others",
    "set": "setting parameters",
    "transition": "changing lifecycle states",
    "record": "recording",
    "read": "reading",
}
_VERBS: Mapping[type[Command[Any]], Sequence[Verb]] = {
    commands.Publish: ("publish",),
    commands.Repeat: ("publish",),
    commands.Move: ("publish",),
    commands.Relay: ("relay",),
    commands.Play: ("play",),
    commands.Feed: ("relay", "play"),
    commands.Record: ("record",),
}
"""What those are that are no requests to services; of those `meaning` tells it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What a decision needs besides the command itself.

    `value` is the full value as it will be sent, defaults filled in: the message, the request, the goal; of parameters
    their values by their names. None where no rule asks. `publishers` are the robot's own nodes that publish that type
    on the topic. `joints` tells how those of a trajectory move now. `told` are sentences about the value for the person
    who approves it, in the words of `exact`.
    """

    value: object = None
    publishers: Sequence[str] = ()
    joints: LookAtJoints = nobody_measures
    told: Sequence[str] = ()


NO_FACTS = Facts()


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What a policy says to a command.

    `rule` is the rule that decided, as people find it in the file. Of a refusal `reason` says why, and `instead` what
    would be allowed; empty otherwise.
    """

    verdict: Literal["allowed", "refused", "consent"]
    rule: str = ""
    reason: str = ""
    instead: str = ""


ALLOWED = Decision(verdict="allowed")


@dataclass(frozen=True, slots=True)
class Policy:
    """The rules that hold for every command. `recorded`: a recording stands for the robot.

    `documents` are the policies in force, of which each has to allow a command; without any, all is allowed that is not
    read-only. `rules` are theirs, compiled.
    """

    read_only: bool = False
    recorded: bool = False
    documents: Sequence[Document] = ()
    rules: Rules | None = field(default=None, repr=False)

    @property
    def in_force(self) -> bool:
        """Whether there is a policy."""
        return self.rules is not None

    @property
    def digest(self) -> str:
        """The SHA-256 of the policies in force, in their canonical form; empty without one."""
        return self.rules.digest if self.rules else ""

    @property
    def mode(self) -> Mode:
        """The strictest of the modes; `autonomous` without a policy."""
        modes: list[Mode] = [document.mode for document in self.documents]
        return strictest(*modes)

    @property
    def robot(self) -> str:
        """The robot's name, as the first policy that says one has it; empty where none does."""
        return next((document.robot for document in self.documents if document.robot), "")

    def ruling(self, command: Command[Any]) -> Ruling | None:
        """What the rules say about it, whatever its value; None without a policy."""
        if self.rules is None or _is_own_record(command):
            return None
        if isinstance(command, ServiceBorne):
            return self.rules.service(command.service, command.service_type)
        if isinstance(command, commands.Record):
            rulings = [self.rules.ruling("record", topic, "") for topic in command.topics]
            if command.patterns or not command.topics:  # what will fit a pattern is not known before
                every = self.rules.ruling("record", _ALL_TOPICS, "")
                rulings.append(replace(every, problem=every.problem and "recording all topics is not allowed"))
            return next((ruling for ruling in rulings if ruling.problem), rulings[0])
        return self.rules.topic(command.name, command.type, _VERBS[type(command)])

    def forbids_recording(self, topic: str) -> str:
        """Why one of the topics that a recording finds is left out; empty where it is recorded."""
        ruling = self.rules.ruling("record", topic, "") if self.rules else None
        return f"The policy: {ruling.problem} ({ruling.rule})." if ruling and ruling.problem else ""

    def decide(self, command: Command[Any], facts: Facts | None = None, mode: Mode = "autonomous") -> Decision:
        """Decides about a command, pure.

        Without facts it is decided as far as name, type, rate and duration tell. `mode` is what holds now.
        """
        return self.judge(command, self.ruling(command), facts, mode)

    def judge(self, command: Command[Any], ruling: Ruling | None, facts: Facts | None, mode: Mode) -> Decision:
        """As `decide`, where the ruling is known; about commands that somebody gave, called by `Guard` alone."""
        if self.read_only:
            reason = f"{command.act} is refused: this server is read-only."
            return Decision(verdict="refused", reason=reason, instead="Start it without --read-only to allow it.")
        if ruling is None or verb_of(command) == "read":
            return ALLOWED
        if mode == "observe":
            return _refused(command, "the mode is observe: only reading and stopping are allowed", "mode")
        if ruling.problem:
            return _refused(command, ruling.problem, ruling.rule, self._allowed_instead(verb_of(command)))
        facts = facts or NO_FACTS
        value: Any = NO_VALUE
        if facts.value is not None:
            value = facts.value
        judged = ruling.judge(value, facts.joints, _terms(command, facts.publishers))
        if judged.problem:
            return _refused(command, judged.problem, judged.rule)
        # The mildest one counts, so that the order of the rules does not matter.
        chosen = [min(fitting, key=lambda entry: _MILDEST.index(entry.consent)) for fitting in judged.allowances]
        rule = "; ".join(entry.rule for entry in chosen)
        waits = any(entry.consent == "each" or (mode == "confirm" and not entry.consent) for entry in chosen)
        return Decision(verdict="consent" if waits else "allowed", rule=rule)

    def _allowed_instead(self, verb: Verb) -> str:
        """Which names the policies allow for a verb, as far as each allows them."""
        names = [
            ", ".join(_names(document.rules, verb)) for document in self.documents if not document.rules.allows_all
        ]
        told = " and of these ".join(dict.fromkeys(each for each in names if each)) if all(names) else ""
        allowed = f"{_DOING[verb].capitalize()} is allowed for {told}." if told else f"No rule allows {_DOING[verb]}."
        return f"{allowed} {_TOLD_BY_POLICY}"


def _names(rules: RuleSet, verb: Verb) -> Sequence[str]:
    """The first names under which a policy allows a verb."""
    found = list(dict.fromkeys(name for entry in rules.allow if entry.verb == verb for name in entry.names))
    return [*found[:_MOST_NAMED], *(["…"] if len(found) > _MOST_NAMED else [])]


def _refused(command: Command[Any], problem: str, rule: str, instead: str = "") -> Decision:
    reason = f"{command.act} is refused by the policy: {problem} ({rule})."
    return Decision(verdict="refused", rule=rule, reason=reason, instead=instead or _TOLD_BY_POLICY)


def _terms(command: Command[Any], publishers: Sequence[str]) -> Terms:
    """What a command asks for beside its value; messages for a relay that is open ask for nothing more."""
    if isinstance(command, commands.Feed):
        return NO_TERMS
    lasts = isinstance(command, commands.Repeat | commands.Move | commands.Relay | commands.Play)
    play = command if isinstance(command, commands.Play) else None
    return Terms(
        rate_hz=command.rate_hz,
        for_s=command.duration_s or 0.0 if lasts else None,
        source=command.source if isinstance(command, commands.Relay) else None,
        force=play is not None and play.force,
        speed=play.speed if play and play.type in VELOCITY_TYPES else 1.0,
        publishers=[named(name) for name in publishers[:_MOST_NAMED]],
    )


def strictest(*modes: Mode) -> Mode:
    """The mode among these that allows least; of none the one that allows most."""
    return MODES[min((MODES.index(mode) for mode in modes), default=len(MODES) - 1)]


def verb_of(command: Command[Any]) -> Verb:
    """What a command does, in the policies' words."""
    if isinstance(command, ServiceBorne):
        return meaning(command.service, command.service_type).verb
    return _VERBS[type(command)][0]


def _is_own_record(command: Command[Any]) -> bool:
    """The black box is the operator's own setting."""
    return isinstance(command, commands.Record) and command.principal == SERVER


def bounded(name: str, value: float, low: float, high: float, unit: str) -> float:
    """`value` if it lies within the limits, which end users can rely on.

    Raises:
        BadValue: naming the limits.
    """
    if not low <= value <= high:
        raise BadValue(name, f"{value:g} {unit} is out of range.", f"Give {low:g} to {high:g} {unit}.")
    return value
