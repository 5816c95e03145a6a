"""The compiled rules of the policies in force (the bridge gets these rules as JSON), and the functions that apply them.

The server applies them for its errors, the bridge at its exits, so that both decide alike. Needs no ROS. Several
policies are an intersection: each of them has to allow an act, and the limits of all hold. Within one policy, only what
an allowance names is allowed, a prohibition overrides every allowance, and every limit whose type and name match holds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from ros2_mcp_common.policy.checks import Checks, Pace, Zone, clamp
from ros2_mcp_common.policy.checks import problem as problem_of
from ros2_mcp_common.policy.field_values import get
from ros2_mcp_common.policy.keep_out import keep_out_of
from ros2_mcp_common.policy.trajectory_limits import CurveLimits, JointBounds, LookAtJoints, nobody_measures
from ros2_mcp_common.policy.verbs import Verb, is_meta, matches, meaning

Over = Literal["refuse", "clamp"]


# ── the rules as data ──────────────────────────────────────────────────────────────────────────────────────────────


NO_VALUE: Any = object()
"""Stands for a value that is not known, or that no rule is about: then only the `Terms` are judged."""


@dataclass(frozen=True)
class Terms:
    """What a command requests besides its value, as far as rules can bound it.

    `rate_hz` and `for_s` are None for a single message; a duration of 0 has no end. `source` is the topic from which a
    relay takes its messages. `speed` is the playback speed of velocities (1: as recorded). `publishers` are the names
    of the robot's own nodes that publish on the topic, as an error shows them.
    """

    rate_hz: float | None = None
    for_s: float | None = None
    source: str | None = None
    force: bool = False
    speed: float = 1.0
    publishers: Sequence[str] = ()


NO_TERMS = Terms()


@dataclass(frozen=True)
class Allowance:
    """One entry of `allow`: what may be done, on which names and types, within which bounds. None: no bound.

    `rule` is its name in errors. `checks` apply to the value: the message, the request, the goal, or the
    parameters by name. `sources` are the topics from which a relay may take its messages, `parameters` the names
    that may be set, `transitions` the labels that may be requested. If `consent` is empty, the mode decides
    whether a person has to approve.
    """

    rule: str
    verb: Verb
    names: tuple[str, ...]
    types: tuple[str, ...] = ("**",)
    checks: Checks = field(default_factory=Checks)
    rate_hz: float | None = None
    for_s: float | None = None
    per_minute: float | None = None
    consent: Literal["", "each", "never"] = ""
    sole_publisher: bool = False
    sources: tuple[str, ...] = ()
    force: bool = False
    parameters: tuple[str, ...] = ()
    transitions: tuple[str, ...] = ()
    meta: bool = False

    def covers(self, verb: Verb, name: str, type_name: str) -> bool:
        """Return whether the entry applies to this verb, name and type."""
        if verb != self.verb or not matches(self.names, name):
            return False
        if verb == "call" and is_meta(type_name) and not self.meta:
            return False
        return verb in ("cancel", "record", "set", "transition") or matches(self.types, type_name, hidden=True)

    def problem(self, terms: Terms, value: Any, zones: Mapping[str, Zone], look: LookAtJoints = nobody_measures) -> str:
        """Return in words why the entry does not allow these terms or this value; "" if it does.

        `zones` are the policy's zones by name; `look` returns the joint states from which a trajectory is judged.
        """
        if problem := self._problem_beside(terms):
            return problem
        if value is NO_VALUE:
            return ""
        if self.verb == "set" and "**" not in self.parameters:
            others = [name for name in value if name not in self.parameters]
            if others:
                return f"the parameter {others[0]} may not be set, only {', '.join(self.parameters)}"
        is_bound = self.verb == "transition" and "**" not in self.transitions
        if is_bound and (problem := _transition_problem(get(value, "transition"), self.transitions)):
            return problem
        return problem_of(self.checks, value, zones, look)

    def _problem_beside(self, terms: Terms) -> str:
        """Return why the entry does not allow these terms; "" if it does."""
        if self.rate_hz is not None and terms.rate_hz is not None and not terms.rate_hz <= self.rate_hz:
            return f"{terms.rate_hz:g} Hz is asked for, at most {self.rate_hz:g} Hz is allowed"
        if self.for_s is not None and terms.for_s is not None and not 0 < terms.for_s <= self.for_s:
            lasts = f"{terms.for_s:g} s is asked for" if terms.for_s else "no end is asked for"
            return f"{lasts}, at most {self.for_s:g} s is allowed"
        if terms.source is not None and not self.allows_source(terms.source):
            return f"messages of {terms.source} may not be relayed there, only those of {', '.join(self.sources)}"
        if terms.force and not self.force:
            return "force is not allowed"
        if not terms.speed <= 1:
            return f"{terms.speed:g} times the recorded speed is asked for, velocities may be played at 1 at most"
        if self.sole_publisher and terms.publishers:
            return f"{', '.join(terms.publishers)} of the robot publishes there itself"
        return ""

    def allows_source(self, source: str) -> bool:
        """Return whether a relay may take its messages from this topic."""
        return matches(self.sources, source)


def _transition_problem(transition: Any, labels: Sequence[str]) -> str:
    """Return why the transition is not one of these labels; "" if it is.

    A lifecycle node uses the label, or the id if the label is empty: both have to denote an allowed transition.
    """
    label, number = get(transition, "label"), int(get(transition, "id"))
    ids = [each for name in ([label] if label else labels) for each in _TRANSITIONS.get(name, ())]
    if (label and label not in labels) or (number not in ids and not (label and number == 0)):
        return f"the transition {label or number} may not be made, only {', '.join(labels)}"
    return ""


_TRANSITIONS = {
    "configure": (1,),
    "cleanup": (2,),
    "activate": (3,),
    "deactivate": (4,),
    "unconfigured_shutdown": (5,),
    "inactive_shutdown": (6,),
    "active_shutdown": (7,),
    "shutdown": (5, 6, 7),
}
"""The ids of lifecycle_msgs/msg/Transition by label."""


@dataclass(frozen=True)
class Forbidden:
    """One entry of `forbid`. Without a verb it covers everything done with the name or type.

    `publish` covers all ways of publishing (also `relay` and `play`), `call` also `set`,
    `transition`, `goal` and `cancel`.
    """

    rule: str
    verb: Verb | Literal[""] = ""
    names: tuple[str, ...] = ("**",)
    types: tuple[str, ...] = ("**",)

    def covers(self, verb: Verb, name: str, type_name: str) -> bool:
        """Return whether the entry applies to this verb, name and type."""
        fits = not self.verb or verb == self.verb or (self.verb == "publish" and verb in ("relay", "play"))
        fits = fits or (self.verb == "call" and verb in ("set", "transition", "goal", "cancel"))
        return fits and matches(self.names, name, hidden=True) and matches(self.types, type_name, hidden=True)


@dataclass(frozen=True)
class Ramp:
    """How fast the length of a vector may grow and shrink, in its unit per second; None: without limit."""

    up: float | None = None
    down: float | None = None


@dataclass(frozen=True)
class Limit:
    """Bounds on every value of these types and names, whichever allowance allowed it.

    `tool` and `stream` say whether a value beyond the bounds is refused or clamped: `tool` for a tool
    call, `stream` for a relay or playback. The zero is sent after `hold_s` without a new command. `ramp`
    has the path of a vector as key.
    """

    rule: str
    types: tuple[str, ...]
    names: tuple[str, ...] = ("**",)
    checks: Checks = field(default_factory=Checks)
    ramp: Mapping[str, Ramp] = field(default_factory=dict[str, Ramp])
    hold_s: float | None = None
    tool: Over = "refuse"
    stream: Over = "clamp"

    def covers(self, name: str, type_name: str) -> bool:
        """Return whether the limit applies to this name and type."""
        return matches(self.types, type_name, hidden=True) and matches(self.names, name, hidden=True)


@dataclass(frozen=True)
class RuleSet:
    """The rules of one policy."""

    name: str
    allow: tuple[Allowance, ...] = ()
    forbid: tuple[Forbidden, ...] = ()
    limits: tuple[Limit, ...] = ()
    zones: Mapping[str, Zone] = field(default_factory=dict[str, Zone])
    allows_all: bool = False


# ── judging ────────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True)
class Judged:
    """The judgement of a value: `problem` says how it breaks `rule`; both are empty if it is allowed.

    Then `allowances` has, for each policy with allowances, those that allow the value.
    """

    rule: str = ""
    problem: str = ""
    allowances: Sequence[Sequence[Allowance]] = ()


@dataclass(frozen=True)
class Settled:
    """The outcome for a value: `problem` says how it breaks `rule`, both empty if it is allowed;
    `clamped`: it was changed.
    """

    rule: str
    problem: str
    clamped: bool


@dataclass(frozen=True)
class Candidates:
    """The allowances and limits of one policy that apply to a verb, name and type."""

    rules: RuleSet
    allow: tuple[Allowance, ...]
    limits: tuple[Limit, ...]


@dataclass(frozen=True)
class Ruling:
    """The decision of all policies on a verb, name and type; `problem` is empty if each policy allows it.

    Made once for a topic or service, and then applied to each value.
    """

    problem: str
    rule: str
    policies: tuple[Candidates, ...] = ()

    @property
    def allowances(self) -> Sequence[Allowance]:
        """The matching allowances of all policies."""
        return [entry for policy in self.policies for entry in policy.allow]

    @property
    def limits(self) -> Sequence[Limit]:
        """The matching limits of all policies."""
        return [limit for policy in self.policies for limit in policy.limits]

    def most(self, bound: Literal["rate_hz", "for_s", "per_minute"]) -> float | None:
        """Return the strictest bound of all policies; within one policy, its most generous allowance counts.

        None: no bound.
        """
        per_policy = [[getattr(entry, bound) for entry in policy.allow] for policy in self.policies if policy.allow]
        return min((max(bounds) for bounds in per_policy if None not in bounds), default=None)

    def allows_source(self, source: str) -> bool:
        """Return whether every policy lets a relay take its messages from this topic."""
        return all(any(entry.allows_source(source) for entry in each.allow) for each in self.policies if each.allow)

    @property
    def hold_s(self) -> float | None:
        """The shortest hold time in s, after which the zero is sent if no new command comes; None if no rule sets a
        hold time.
        """
        return min((limit.hold_s for limit in self.limits if limit.hold_s is not None), default=None)

    @property
    def needs_value(self) -> bool:
        """Whether the decision depends on the value."""
        has_names = any(entry.verb in ("set", "transition") for entry in self.allowances)
        return has_names or any(not part.checks.is_empty for part in (*self.allowances, *self.limits))

    @property
    def needs_publishers(self) -> bool:
        """Whether the decision depends on which other nodes publish on the topic."""
        return any(entry.sole_publisher for entry in self.allowances)

    @property
    def curves(self) -> Sequence[str]:
        """The paths of trajectories whose whole curve has limits."""
        parts = (*self.allowances, *self.limits)
        return list(dict.fromkeys(path for part in parts for path in part.checks.curve))

    def judge(self, value: Any, look: LookAtJoints = nobody_measures, terms: Terms = NO_TERMS) -> Judged:
        """Judge a value and its terms by every policy: one of its allowances, if it has any for them, must permit them,
        and all its limits must hold.
        """
        allowing: list[Sequence[Allowance]] = []
        for policy in self.policies:
            zones = policy.rules.zones
            tried = [(entry, entry.problem(terms, value, zones, look)) for entry in policy.allow]
            fitting = [entry for entry, problem in tried if not problem]
            if tried and not fitting:
                return Judged(tried[0][0].rule, tried[0][1])
            if fitting:
                allowing.append(fitting)
            for limit in policy.limits if value is not NO_VALUE else ():
                if problem := problem_of(limit.checks, value, zones, look):
                    return Judged(limit.rule, problem)
        return Judged(allowances=allowing)

    def settle(self, value: Any, way: Literal["tool", "stream"], look: LookAtJoints = nobody_measures) -> Settled:
        """Judge a value of a tool call (`tool`), or of a relay, feed or playback (`stream`).

        Before that, the value is clamped in place to the limits that say `clamp`, and in a
        stream also to the allowances.
        """
        clamped = False
        for limit in self.limits:
            if (limit.tool if way == "tool" else limit.stream) == "clamp":
                clamped = clamp(limit.checks, value) or clamped
        for entry in self.allowances if way == "stream" else ():
            clamped = clamp(entry.checks, value) or clamped
        judged = self.judge(value, look)
        return Settled(judged.rule, judged.problem, clamped)


@dataclass(frozen=True)
class Rules:
    """All rules in force. The bridge receives them once, before any other request may act.

    `digest` is the SHA-256 of all policies in their canonical form.
    """

    digest: str
    policies: tuple[RuleSet, ...]

    def may(self, verb: Verb, types: Sequence[str] = ()) -> bool:
        """Return whether each policy allows the verb for at least some name, whatever the value.

        If `types` are given, only allowances for at least one of them count.
        """

        def allows(entry: Allowance) -> bool:
            is_typed = bool(types) and verb not in ("cancel", "record", "set", "transition")
            return entry.verb == verb and (not is_typed or any(matches(entry.types, one, hidden=True) for one in types))

        return all(policy.allows_all or any(map(allows, policy.allow)) for policy in self.policies)

    def ruling(self, verb: Verb, name: str, type_name: str) -> Ruling:
        """Return the decision of all policies on this verb, name and type, for any value."""
        if verb == "read":
            return Ruling("", "reading")
        found: list[Candidates] = []
        if entry := self._forbidden(verb, name, type_name):
            return Ruling(f"{_act(verb, name, type_name)} is forbidden", entry.rule)
        for policy in self.policies:
            allow = tuple(entry for entry in policy.allow if entry.covers(verb, name, type_name))
            if not (allow or policy.allows_all):
                return Ruling(
                    f"{_act(verb, name, type_name)} is not allowed: no rule allows it", f"{policy.name}: allow"
                )
            limits = tuple(limit for limit in policy.limits if limit.covers(name, type_name))
            found.append(Candidates(policy, allow, limits))
        return Ruling("", "; ".join(policy.allow[0].rule for policy in found if policy.allow), tuple(found))

    def topic(self, name: str, type_name: str, verbs: Sequence[Verb] = ("publish",)) -> Ruling:
        """Return the first ruling of these verbs that allows publishing on the topic, or the
        ruling of the first verb.
        """
        rulings = [self.ruling(verb, name, type_name) for verb in verbs]
        return next((ruling for ruling in rulings if not ruling.problem), rulings[0])

    def service(self, service: str, service_type: str) -> Ruling:
        """Return the ruling for calling a service, according to what the call means; judge
        `judged_part` of the request by it.

        A service that is forbidden to be called stays forbidden, whatever the call means.
        """
        meant = meaning(service, service_type)
        if meant.verb != "read" and (entry := self._forbidden("call", service, service_type)):
            return Ruling(f"{_act('call', service, service_type)} is forbidden", entry.rule)
        return self.ruling(meant.verb, meant.name, meant.type)

    def _forbidden(self, verb: Verb, name: str, type_name: str) -> Forbidden | None:
        """Return the first entry of any policy that forbids this, or None."""
        entries = (entry for policy in self.policies for entry in policy.forbid)
        return next((entry for entry in entries if entry.covers(verb, name, type_name)), None)

    def as_json(self) -> dict[str, Any]:
        """Return the rules as JSON for the bridge, the inverse of `from_json`."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Rules:
        """Return the rules from JSON. Raise `KeyError`, `TypeError` or `ValueError` if it has another structure."""
        return cls(value["digest"], tuple(_rule_set(each) for each in value["policies"]))


def judged_part(verb: Verb, request: Any) -> Any:
    """Return the part of a request that limits apply to: the goal in it, its parameters by name, otherwise all of it.

    Raises:
        ValueError: if a parameter is set twice: it is not defined which value would hold.
    """
    if verb == "goal":
        return get(request, "goal")
    if verb != "set":
        return request
    parameters: dict[str, Any] = {}
    for entry in get(request, "parameters"):
        name = get(entry, "name")
        if name in parameters:
            raise ValueError(f"the parameter {name!r} is set twice")
        parameters[name] = parameter_value(get(entry, "value"))
    return parameters


_PARAMETER_FIELDS = (
    "",
    "bool_value",
    "integer_value",
    "double_value",
    "string_value",
    "byte_array_value",
    "bool_array_value",
    "integer_array_value",
    "double_array_value",
    "string_array_value",
)
"""The fields of rcl_interfaces/msg/ParameterValue, indexed by the codes of its `type`."""


def parameter_value(value: Any) -> Any:
    """Return the value in a ParameterValue, given as a JSON object or a message; None if it is not set."""
    code = int(get(value, "type"))
    return get(value, _PARAMETER_FIELDS[code]) if 0 < code < len(_PARAMETER_FIELDS) else None


def _act(verb: Verb, name: str, type_name: str) -> str:
    words = {"publish": "publishing on", "relay": "relaying to", "play": "playing on", "call": "calling"}
    words |= {"goal": "sending a goal to", "cancel": "cancelling goals of", "set": "setting parameters of"}
    words |= {"transition": "changing the state of", "record": "recording", "read": "asking"}
    return f"{words[verb]} {name} ({type_name})" if type_name else f"{words[verb]} {name}"


# ── from JSON ──────────────────────────────────────────────────────────────────────────────────────────────────────


def _rule_set(value: Mapping[str, Any]) -> RuleSet:
    return RuleSet(
        name=value["name"],
        allow=tuple(_with_checks(Allowance, each) for each in value["allow"]),
        forbid=tuple(Forbidden(**_tuples(each)) for each in value["forbid"]),
        limits=tuple(_limit(each) for each in value["limits"]),
        zones={name: _zone(each) for name, each in value["zones"].items()},
        allows_all=bool(value["allows_all"]),
    )


def _tuples(value: Mapping[str, Any]) -> dict[str, Any]:
    return {name: tuple(cast("list[Any]", each)) if isinstance(each, list) else each for name, each in value.items()}


def _with_checks(kind: Any, value: Mapping[str, Any]) -> Any:
    return kind(**{**_tuples(value), "checks": _checks(value["checks"])})


def _limit(value: Mapping[str, Any]) -> Limit:
    ramp = {path: Ramp(**each) for path, each in value["ramp"].items()}
    return _with_checks(Limit, {**value, "ramp": ramp})


def _checks(value: Mapping[str, Any]) -> Checks:
    return Checks(
        norm=dict(value["norm"]),
        range={path: (low, high) for path, (low, high) in value["range"].items()},
        one_of={path: tuple(allowed) for path, allowed in value["one_of"].items()},
        zero=tuple(value["zero"]),
        count={path: (fewest, most) for path, (fewest, most) in value["count"].items()},
        zone=dict(value["zone"]),
        pace={path: Pace(**each) for path, each in value["pace"].items()},
        curve={path: _curve(each) for path, each in value["curve"].items()},
        keep_out=keep_out_of(value["keep_out"]) if value["keep_out"] else None,
    )


def _curve(value: Mapping[str, Any]) -> CurveLimits:
    more: dict[str, Any] = {"joints": {name: JointBounds(**each) for name, each in value["joints"].items()}}
    return CurveLimits(**{**_tuples(value), **more})


def _zone(value: Mapping[str, Any]) -> Zone:
    return Zone(value["frame_id"], tuple((x, y) for x, y in value["polygon"]), value["margin_m"])
