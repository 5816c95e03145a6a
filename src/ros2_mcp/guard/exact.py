"""A resolved command in the exact form that the audit records, that an approval covers, and that an operator reads.

The sentences for the operator are fixed. Text from a model or a robot appears in them only as a valid name, as a
number, or within «» as ASCII, so that it cannot pass for a sentence of this server.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, cast

from ros2_mcp.guard.policy import verb_of
from ros2_mcp.model.commands import Command, Principal, Route, SendGoal
from ros2_mcp.model.text import is_name
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES

_SENTENCES: Mapping[str, str] = {
    "publish": "Publish on {name}",
    "relay": "Relay what comes on {source} to {name}",
    "play": "Play {topic} of the bag {bag}, its part {part}, on {name}",
    "record": "Record {topics}{patterns}",
    "call": "Call the service {name}",
    "set": "Set parameters of {name}",
    "transition": "Make the transition {transition} of {name}",
    "goal": "Send a goal to {name}",
    "cancel": "Cancel goals of {name}",
}
_NOT_BOUND = frozenset(
    {"principal", "name", "type", "value", "rate_hz", "duration_s", "risk", "choice", "qos", "route"}
)
_NOT_SAID = frozenset(
    {"messages", "goal_id", "repeat_id", "motion_id", "relay_id", "wait_match_s", "wait_ack_s", "timeout_s", "wait_s"}
)
"""Fields of commands that have a field of their own in `ExactCommand` (`_NOT_BOUND`), or are new for each call or only
limit waiting (`_NOT_SAID`). Every other field, including one added later, is part of what was approved."""
_SHOWN = 12
"""The most values in a summary, so that a person reads it within a second; `operate show` lists all."""
_TEXT = 80
"""The most characters of a text within a summary: about a line."""
_ROW = 8
"""A longer list of numbers is summarised by its smallest and largest number."""
_DIGEST_GROUPS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class ExactCommand:
    """A resolved command: an approval covers exactly this. `value` is decoded in full, including defaults.

    `digest` is SHA-256 over the type and the CDR bytes that are sent, or, where `of` got no bytes, over the type and
    the value as canonical JSON; of a list of goals, over the whole list. `more` are the other fields of the command
    that affect its outcome, `policy` is the hash of the policies, `epoch` the stop epoch of the request, `told` further
    sentences for the person who approves. `route` is the list of goals that begins with this one, with full values, and
    `route_id` the id of the list, which is new for each call.
    """

    principal: Principal
    verb: str
    name: str
    type: str
    value: Any
    digest: str
    rate_hz: float | None
    duration_s: float | None
    more: Mapping[str, Any]
    policy: str = ""
    epoch: str = ""
    told: Sequence[str] = ()
    route: Mapping[str, Any] = field(default_factory=dict[str, Any])
    route_id: str = ""

    @classmethod
    def of(
        cls,
        command: Command[Any],
        value: object = None,
        body: bytes = b"",
        *,
        policy: str = "",
        epoch: str = "",
        told: Sequence[str] = (),
        route: Sequence[object] = (),
    ) -> ExactCommand:
        """Return the exact form of a command.

        Args:
            command: the resolved command (`robot/translation.py`).
            value: its value, decoded in full from the bytes that are sent; without it, the command's own value.
            body: the bytes; without them, the digest is computed from the value as JSON, which is equivalent.
            policy: the hash of the policies in force.
            epoch: the stop epoch in which the command was accepted.
            told: further sentences about the value for the person who approves, such as the extremes of a trajectory;
                they are not part of what is approved.
            route: the full values of the goals of a list that begins with this goal.
        """
        value = command.value if value is None else value
        listed = command.route if isinstance(command, SendGoal) and command.route else None
        of_list = _route(listed, route or listed.goals) if listed and listed.goals else {}
        of = canonical(of_list).encode() if of_list else body or canonical(value).encode()
        more = {
            each.name: getattr(command, each.name)
            for each in fields(command)
            if each.name not in _NOT_BOUND | _NOT_SAID
        }
        return cls(
            principal=command.principal,
            verb=verb_of(command),
            name=command.name,
            type=command.type,
            value=value,
            digest=hashlib.sha256(canonical(command.type).encode() + of).hexdigest(),
            route=of_list,
            route_id=listed.id if listed else "",
            rate_hz=command.rate_hz,
            duration_s=command.duration_s,
            more={name: found for name, found in more.items() if found not in (None, "", 0)},
            policy=policy,
            epoch=epoch,
            told=told,
        )

    @property
    def subject(self) -> str:
        """The part that a grant covers: principal, verb, name, type, policies and other fields, without value, rate and
        duration.
        """
        parts = [
            self.principal.transport,
            self.principal.name,
            self.principal.login,
            self.verb,
            self.name,
            self.type,
            self.policy,
        ]
        return canonical([*parts, self.more])

    @property
    def key(self) -> str:
        """A hash of all that an approval covers: two commands are the same if their keys are equal."""
        parts = [self.subject, self.digest, self.rate_hz, self.duration_s, self.epoch]
        return hashlib.sha256(canonical(parts).encode()).hexdigest()

    @property
    def goals(self) -> Sequence[Any]:
        """The values of all goals that an approval covers: the goals of the list, or the only goal."""
        return self.route.get("goals", (self.value,))

    @property
    def goal_digests(self) -> frozenset[str]:
        """The digests of `goals`, each as that of a command with this value."""
        kind = canonical(self.type).encode()
        return frozenset(hashlib.sha256(kind + canonical(goal).encode()).hexdigest() for goal in self.goals)

    def line(self, **more: Any) -> dict[str, Any]:
        """Return the fields of the audit line of this command, with `more` added."""
        return {
            "principal": self.principal.name,
            "transport": self.principal.transport,
            "login": self.principal.login,
            "verb": self.verb,
            "name": self.name,
            "type": self.type,
            "digest": self.digest,
            "rate_hz": self.rate_hz,
            "duration_s": self.duration_s,
            "epoch": self.epoch,
            **{
                name: found if isinstance(found, (str, int, float)) else canonical(found)
                for name, found in more.items()
            },
            **({"more": canonical(self.more)} if self.more else {}),
            **({"route": canonical(self.route)} if self.route else {}),
            "value": self.value,
        }

    def summary(self) -> list[str]:
        """Return sentences of printable ASCII and «» for an operator: effect, values, client and digest."""
        groups = [self.digest[4 * place : 4 * place + 4] for place in range(_DIGEST_GROUPS)]
        return [
            f"{self._effect()}{self._type()}, {self._often()}.",
            *self.told,
            *([self._values(self.value)] if not self.route else self._listed()),
            *self._motion(),
            f"For the client {_text(self.principal.name)} ({word(self.principal.transport)}). "
            f"Digest {' '.join(groups)}.",
        ]

    def _effect(self) -> str:
        topics = cast("Sequence[str]", self.more.get("topics", ()))
        shown = ", ".join(map(word, topics[:_SHOWN])) + (f" and {len(topics) - _SHOWN} more" * (len(topics) > _SHOWN))
        patterns = cast("Sequence[str]", self.more.get("patterns", ()))
        given = {name: word(str(found)) for name, found in self.more.items() if name != "topics"}
        given |= {"name": word(self.name), "topics": shown or "all topics"}
        given |= {"patterns": f" of the patterns {', '.join(map(_text, patterns))}" if patterns else ""}
        return _SENTENCES[self.verb].format_map(_Given(given))

    def _type(self) -> str:
        return f" ({word(self.type)})" if self.type else ""

    def _listed(self) -> list[str]:
        """Return the sentences about a list of goals: how it is carried out, and each goal."""
        goals, loops, waits = self.goals, self.route["loops"], self.route["waits_s"]
        missed = "goes on" if self.route["goes_on"] else "ends it"
        often = "once" if loops == 1 else f"{number(loops)} times"
        told = f"It begins a list of {number(len(goals))} goals, in this order, {often}; a missed one {missed}."
        waiting = [f", then wait {number(wait_s)} s" if wait_s else "" for wait_s in waits]
        return [
            told,
            *(
                f"Goal {place}{wait}: {self._values(goal)}"
                for place, (goal, wait) in enumerate(zip(goals, waiting, strict=True), 1)
            ),
        ]

    def _often(self) -> str:
        if self.rate_hz is None and self.duration_s is None:
            return "once" if self.verb not in ("relay", "play", "record") else "until it ends or is stopped"
        rate = "at the rate of its source" if self.rate_hz is None else f"at {number(self.rate_hz)} Hz"
        lasting = f"for {number(self.duration_s)} s" if self.duration_s else "without end"
        return f"{rate} {lasting}"

    def _values(self, value: Any) -> str:
        parameters: Mapping[str, Any] | None = self.more.get("parameters")
        if parameters is None:
            leaves = [(path, leaf) for path, leaf in leaves_of(value) if not is_default(leaf)]
            others, none = "every other value is 0 or empty", "Every value is 0 or empty."
        else:  # parameters: all are shown, because a default value is set as well
            leaves = [
                leaf for name, value in parameters.items() for leaf in [*leaves_of(value, name)] or [(name, None)]
            ]
            others, none = "every other parameter stays as it is", "No parameter."
        if not leaves:
            return none
        told = ", ".join(f"{_path(path)} {self._leaf(path, leaf)}" for path, leaf in leaves[:_SHOWN])
        rest = len(leaves) - _SHOWN
        return f"{told}, and {rest} more." if rest > 0 else f"{told}; {others}."

    def _motion(self) -> list[str]:
        """Return a sentence about a motion by feedback: its values are maxima, and these are its controller's
        settings.
        """
        controller: Mapping[str, Any] | None = self.more.get("controller")
        if not controller:
            return []
        leaves = [(path, leaf) for path, leaf in leaves_of(controller) if not is_default(leaf)]
        told = ", ".join(f"{_path(path)} {self._leaf(path, leaf)}" for path, leaf in leaves[:_SHOWN])
        return [f"By feedback, with at most these values: {told}."]

    def _leaf(self, path: str, leaf: Any) -> str:
        if isinstance(leaf, list):
            numbers = cast("list[float]", leaf)
            return f"{len(numbers)} numbers from {number(min(numbers))} to {number(max(numbers))}"
        if isinstance(leaf, bool):
            return "true" if leaf else "false"
        if isinstance(leaf, (int, float)):
            return number(leaf) + _unit(self.type, path)
        if leaf is None:
            return "empty"
        return _text(leaf) if isinstance(leaf, str) else _text(canonical(leaf))


def _route(route: Route, goals: Sequence[object]) -> dict[str, Any]:
    waits_s = [*route.waits_s] or [0.0] * len(goals)
    return {"goals": [*goals], "loops": route.loops, "waits_s": waits_s, "goes_on": route.goes_on}


class _Given(dict[str, str]):
    """The fields of a sentence; a missing field is shown as `(no NAME)`."""

    def __missing__(self, name: str) -> str:
        return f"(no {name})"


def canonical(value: Any) -> str:
    """Return the canonical JSON text of a value: sorted keys, ASCII, no spaces."""
    return json.dumps(value, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=_plain)


def _plain(value: Any) -> Any:
    return [*cast("Sequence[Any]", value)] if isinstance(value, Sequence) else str(value)


def word(name: str) -> str:
    """Return a valid name unchanged, and any other text as quoted ASCII."""
    return name if is_name(name) else _text(name)


def number(value: float) -> str:
    """Return a number with all its digits, so that two numbers that differ in the last bit are shown as different."""
    return repr(value)


def leaves_of(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and the value of each leaf; a long list of numbers counts as one leaf."""
    if isinstance(value, Mapping):
        for name, below in cast("Mapping[str, Any]", value).items():
            yield from leaves_of(below, f"{path}.{name}" if path else name)
    elif isinstance(value, (list, tuple)):
        items = cast("Sequence[Any]", value)
        if len(items) > _ROW and all(isinstance(item, (int, float)) and math.isfinite(item) for item in items):
            yield path, list(items)
            return
        for place, below in enumerate(items):
            yield from leaves_of(below, f"{path}[{place}]")
    else:
        yield path, value


def is_default(leaf: Any) -> bool:
    """Return whether a leaf has the default value of its field in ROS."""
    return leaf is None or leaf is False or leaf == "" or (isinstance(leaf, (int, float)) and leaf == 0)


def _path(path: str) -> str:
    return word(path) if path else "value"


def _unit(type_name: str, path: str) -> str:
    if type_name not in VELOCITY_TYPES:
        return ""
    parts = path.split(".")
    return " m/s" if "linear" in parts or path.endswith("speed") else " rad/s" if "angular" in parts else ""


def _text(text: str) -> str:
    """Return any text within «», as ASCII on one line, cut if it is long."""
    inner = json.dumps(text[: 2 * _TEXT], ensure_ascii=True)[1:-1].replace("\x7f", "\\u007f")
    return f"«{inner}»" if len(inner) <= _TEXT and len(text) <= 2 * _TEXT else f"«{inner[: _TEXT - 3]}...»"
