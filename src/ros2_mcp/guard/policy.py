"""The policy: decides about commands, and never acts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ros2_mcp.guard.document import Document, Mode
from ros2_mcp.model import commands
from ros2_mcp.model.commands import SERVER, Command, ServiceBorne
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.text import named
from ros2_mcp_common.policy.rules import NO_TERMS, NO_VALUE, Allowance, Rules, RuleSet, Ruling, Terms
from ros2_mcp_common.policy.trajectory_limits import LookAtJoints, nobody_measures
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES
from ros2_mcp_common.policy.verbs import Verb, meaning

MODES: Sequence[Mode] = ("observe", "confirm", "autonomous")
"""From the strictest mode to the most permissive."""
VERBS: Sequence[Verb] = ("publish", "relay", "play", "call", "goal", "cancel", "set", "transition", "record")
"""The verbs of rules, as policy files spell them; reading is always allowed."""
_ALL_TOPICS = "/…" * 9
"""A name that represents every topic of a recording: in practice only the pattern `/**` matches it."""
_MOST_NAMED = 5
"""The most names in one sentence; `ros2_policy` lists all."""
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
"""The verbs of the commands that are no service requests; `meaning` returns the verb of a service request."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """The facts that a decision needs besides the command itself.

    `value` is the full value as it will be sent, including defaults: the message, the request, the goal, or the
    parameters' values by name. None if no rule checks it. `publishers` are the robot's own nodes that publish the type
    on the topic. `joints` returns the measured states of a trajectory's joints. `told` are sentences about the value
    for the person who approves it, worded as in `exact`. `route` are the full values of all goals of the list that
    begins with this one, which are decided with it.
    """

    value: object = None
    route: Sequence[object] = ()
    publishers: Sequence[str] = ()
    joints: LookAtJoints = nobody_measures
    told: Sequence[str] = ()


NO_FACTS = Facts()


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """The policy's decision about a command.

    `rule` names the deciding rule and its place in the file. For a refusal, `reason` says why and `instead` what is
    allowed; otherwise both are "".
    """

    verdict: Literal["allowed", "refused", "consent"]
    rule: str = ""
    reason: str = ""
    instead: str = ""


ALLOWED = Decision(verdict="allowed")


@dataclass(frozen=True, slots=True)
class Policy:
    """The rules for all commands. `recorded`: a recording stands for the robot.

    `documents` are the policies in force: each has to allow a command. Without any, everything is allowed unless
    `read_only`. `rules` are their compiled rules.
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
        """The SHA-256 of the policies in force in their canonical form; "" without a policy."""
        return self.rules.digest if self.rules else ""

    @property
    def mode(self) -> Mode:
        """The strictest of the policies' modes; `autonomous` without a policy."""
        modes: list[Mode] = [document.mode for document in self.documents]
        return strictest(*modes)

    @property
    def robot(self) -> str:
        """The robot's name in the first policy that gives a name; "" if no policy does."""
        return next((document.robot for document in self.documents if document.robot), "")

    def ruling(self, command: Command[Any]) -> Ruling | None:
        """Return the ruling on a command, before its value is checked; None without a policy, and for the black box's
        recording.
        """
        if self.rules is None or _is_own_record(command):
            return None
        if isinstance(command, ServiceBorne):
            return self.rules.service(command.service, command.service_type)
        if isinstance(command, commands.Record):
            rulings = [self.rules.ruling("record", topic, "") for topic in command.topics]
            if command.patterns or not command.topics:  # the topics that will match are not known yet
                every = self.rules.ruling("record", _ALL_TOPICS, "")
                rulings.append(replace(every, problem=every.problem and "recording all topics is not allowed"))
            return next((ruling for ruling in rulings if ruling.problem), rulings[0])
        return self.rules.topic(command.name, command.type, _VERBS[type(command)])

    def forbids_recording(self, topic: str) -> str:
        """Return why a topic that a recording has found is omitted; "" if it is recorded."""
        ruling = self.rules.ruling("record", topic, "") if self.rules else None
        return f"The policy: {ruling.problem} ({ruling.rule})." if ruling and ruling.problem else ""

    def decide(self, command: Command[Any], facts: Facts | None = None, mode: Mode = "autonomous") -> Decision:
        """Decide about a command. Has no side effects.

        Without facts, only name, type, rate and duration are checked. `mode` is the mode in force.
        """
        return self.judge(command, self.ruling(command), facts, mode)

    def judge(self, command: Command[Any], ruling: Ruling | None, facts: Facts | None, mode: Mode) -> Decision:
        """Decide as `decide`, with a ruling that is known already. For commands of clients, and for trials."""
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
        allowances: list[Sequence[Allowance]] = []
        values = facts.route or (value,)
        for number, each in enumerate(values, 1):
            judged = ruling.judge(each, facts.joints, _terms(command, facts.publishers))
            if judged.problem:
                which = f"goal {number} of {len(values)}: " if facts.route else ""
                return _refused(command, f"{which}{judged.problem}", judged.rule)
            allowances += judged.allowances
        # The mildest of the fitting rules applies, so that the order of the rules does not matter.
        chosen = [min(fitting, key=lambda entry: _MILDEST.index(entry.consent)) for fitting in allowances]
        rule = "; ".join(dict.fromkeys(entry.rule for entry in chosen))
        waits = any(entry.consent == "each" or (mode == "confirm" and not entry.consent) for entry in chosen)
        return Decision(verdict="consent" if waits else "allowed", rule=rule)

    def _allowed_instead(self, verb: Verb) -> str:
        """Return a sentence with the names that each policy allows for a verb."""
        names = [
            ", ".join(_names(document.rules, verb)) for document in self.documents if not document.rules.allows_all
        ]
        told = " and of these ".join(dict.fromkeys(each for each in names if each)) if all(names) else ""
        allowed = f"{_DOING[verb].capitalize()} is allowed for {told}." if told else f"No rule allows {_DOING[verb]}."
        return f"{allowed} {_TOLD_BY_POLICY}"


def _names(rules: RuleSet, verb: Verb) -> Sequence[str]:
    """Return the first names for which a policy allows a verb."""
    found = list(dict.fromkeys(name for entry in rules.allow if entry.verb == verb for name in entry.names))
    return [*found[:_MOST_NAMED], *(["…"] if len(found) > _MOST_NAMED else [])]


def _refused(command: Command[Any], problem: str, rule: str, instead: str = "") -> Decision:
    reason = f"{command.act} is refused by the policy: {problem} ({rule})."
    return Decision(verdict="refused", rule=rule, reason=reason, instead=instead or _TOLD_BY_POLICY)


def _terms(command: Command[Any], publishers: Sequence[str]) -> Terms:
    """Return the checked properties of a command besides its value; none for messages to an open relay."""
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
    """Return the strictest of these modes; without modes, the most permissive mode."""
    return MODES[min((MODES.index(mode) for mode in modes), default=len(MODES) - 1)]


def verb_of(command: Command[Any]) -> Verb:
    """Return the verb of a command."""
    if isinstance(command, ServiceBorne):
        return meaning(command.service, command.service_type).verb
    return _VERBS[type(command)][0]


def _is_own_record(command: Command[Any]) -> bool:
    """Return whether this is the recording of the black box, which is the operator's own setting."""
    return isinstance(command, commands.Record) and command.principal == SERVER


def bounded(name: str, value: float, low: float, high: float, unit: str) -> float:
    """Return `value` if it lies within the limits.

    Raises:
        BadValue: naming the limits.
    """
    if not low <= value <= high:
        raise BadValue(name, f"{value:g} {unit} is out of range.", f"Give {low:g} to {high:g} {unit}.")
    return value
