"""How a robot is told in a given room: which names stand together, what is told of each, and in how few characters."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product, takewhile
from typing import TypeVar

from ros2_mcp.model.text import named

Item = TypeVar("Item")
_BRACES = re.compile(r"[{},«»\s]")
"""In a name: then it stands in no braces."""
_MOST_NODES, _LEAST_KNOWN = 3, 3
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


@dataclass(frozen=True, slots=True)
class Style:
    """What is told of each part of a robot. `is_brief`: what is alike stands together, in braces where names are, as
    a shell expands them (`/sonar/{left,right}`), and a type that is called as its topic is not told. `namespace`,
    which begins most names, is left out of them. `decimals` of limits, and digits of speeds. `has_senders`: who else
    sends to an input. `has_types`, `has_listeners`: of what is told by its name; `has_controller_types` of controllers.
    `has_frames`: the frames of sensors; without them those at one place stand together. `most_name`: characters of a
    name, longer ones are cut.
    """

    is_brief: bool = False
    namespace: str = ""
    decimals: int = 3
    has_senders: bool = True
    has_types: bool = True
    has_controller_types: bool = True
    has_listeners: bool = True
    has_frames: bool = True
    most_name: int = 255

    def name(self, name: str) -> str:
        """One name of the robot."""
        below = name.removeprefix(f"{self.namespace}/") if self.namespace else name
        return named(f"{below[: self.most_name]}…" if len(below) > self.most_name else below)

    def names(self, names: Iterable[str]) -> str:
        """Several of them."""
        return braced([self.name(name) for name in names])

    def whom(self, name: str, nodes: Sequence[str]) -> str:
        """That these nodes take what is sent to a topic or an action, with a blank before it; in brief not of one that
        the name begins with.
        """
        if not nodes or (self.is_brief and len(nodes) == 1 and name.startswith(f"{nodes[0]}/")):
            return ""
        more = f" and {len(nodes) - _MOST_NODES} more" if len(nodes) > _MOST_NODES else ""
        return f" → {' and '.join(map(self.name, nodes[:_MOST_NODES]))}{more}"

    def groups(self, items: Iterable[Item], key: Callable[[Item], Hashable]) -> list[list[Item]]:
        """Each by itself; in brief those with equal keys together, where the first of them stood."""
        if not self.is_brief:
            return [[item] for item in items]
        found: dict[Hashable, list[Item]] = {}
        for item in items:
            found.setdefault(key(item), []).append(item)
        return list(found.values())


@dataclass(frozen=True, slots=True)
class Named:
    """What is told by its name, with its type, how often it comes or what it tells, the nodes that listen there, and
    the stack to which it belongs, such as Nav2; empty where it needs none.
    """

    name: str
    type: str = ""
    value: str = ""
    listeners: Sequence[str] = ()
    stack: str = ""

    def about(self, style: Style) -> str:
        """All but its name, with a blank before each."""
        is_told = self.type and style.has_types and not (style.is_brief and is_called_as(self.type, self.name))
        kind = f" {named(self.type)}" if is_told else ""
        whom = style.whom(self.name, self.listeners) if style.has_listeners else ""
        return f"{kind}{f' {self.value}' if self.value else ''}{whom}"


@dataclass(frozen=True, slots=True)
class Names:
    """A line that begins with `lead`, of what is told by name; there are `more` besides, and some that are `known` to
    whoever knows a stack, such as Nav2: how many of which.
    """

    lead: str
    found: Sequence[Named] = ()
    more: int = 0
    known: Sequence[str] = ()

    def with_known(self) -> Names:
        """The same, shorter: those of a stack without their names."""
        counts = Counter(one.stack for one in self.found if one.stack)
        known = {stack: count for stack, count in counts.items() if count >= _LEAST_KNOWN}
        found = [one for one in self.found if one.stack not in known]
        return replace(self, found=found, known=[f"{count} of {stack}" for stack, count in known.items()])

    def in_words(self, style: Style) -> list[str]:
        """A line, or none where there is nothing."""
        alike = style.groups(self.found, key=lambda one: one.about(style))
        told = [f"{_by_place([style.name(one.name) for one in all_of])}{all_of[0].about(style)}" for all_of in alike]
        more = f"{self.more} more" if told or self.known else f"{self.more}"
        rest = [*self.known, *([more] if self.more else [])]
        return [f"{self.lead}: {'; '.join([*told, *rest])}"] if told or rest else []


def _by_place(names: Sequence[str]) -> str:
    """Those below one name, as /status, together."""
    places: dict[str, list[str]] = {}
    for name in names:
        places.setdefault(name.rpartition("/")[0], []).append(name)
    return ", ".join(map(braced, places.values()))


def is_called_as(kind: str, name: str) -> bool:
    """Whether a type is called as the last part of a topic is: `BatteryState` and `/mavros/battery_state`."""
    return kind.lower() == name.rpartition("/")[2].replace("_", "").lower()


def braced(names: Sequence[str]) -> str:
    """Names one after the other, or what differs in braces where that is shorter: `joint_{1,2}`, `{L,R}Hip`."""
    apart = ", ".join(names)
    if len(set(names)) < max(len(names), 2) or any(map(_BRACES.search, names)):
        return apart
    if several := factors(names):
        return "/".join(part[0] if len(part) == 1 else f"{{{','.join(part)}}}" for part in several)
    is_apart = _is_apart if len({name.count("/") for name in names}) == 1 else _begins_part
    before = _common_beginning(names)
    while before and not all(is_apart(name, len(before)) for name in names):
        before = before[:-1]
    after = _common_beginning([name[len(before) :][::-1] for name in names])[::-1]
    while after and not all(
        len(name) > len(before + after) and is_apart(name, len(name) - len(after)) for name in names
    ):
        after = after[1:]
    inner = [name[len(before) : len(name) - len(after)] for name in names]
    together = f"{before}{{{','.join(inner)}}}{after}"
    return together if len(before + after) > 1 and all(inner) and len(together) < len(apart) else apart


def factors(names: Sequence[str]) -> list[list[str]]:
    """What stands in each place of names that are all combinations of it, in their order, with a choice in more than
    one place: `/{color,depth}/{left,right}`; empty for others.
    """
    parts = [name.split("/") for name in names]
    if len({len(one) for one in parts}) != 1:
        return []
    choices = [list(dict.fromkeys(place)) for place in zip(*parts, strict=True)]
    are_several = sum(len(choice) > 1 for choice in choices) > 1
    return choices if are_several and [list(one) for one in product(*choices)] == parts else []


def _common_beginning(names: Sequence[str]) -> str:
    first, last = min(names), max(names)  # what these two begin with, all between them do
    same = takewhile(lambda pair: pair[0] == pair[1], zip(first, last, strict=False))
    return "".join(letter for letter, _ in same)


def _is_apart(name: str, place: int) -> bool:
    """Whether one word ends there and another begins: `imu_|left`, `joint|7`, `L|Knee`."""
    if place in (0, len(name)):
        return place == 0
    left, right = name[place - 1], name[place]
    is_inside = (left.isalpha() and right.isalpha() and not right.isupper()) or (left.isdigit() and right.isdigit())
    return not is_inside and (left != "_" or right != "_")


def _begins_part(name: str, place: int) -> bool:
    """Whether a part of a name begins or ends there."""
    return "/" in name[place - 1 : place + 1]


def same_or_each(values: Sequence[str], between: str = ", ") -> str:
    """What all have, once; else each one's in their order, with ± (or ∓) where two differ in signs alone: the first of
    them has the upper one.
    """
    if len(set(values)) == 1:
        return values[0]
    if len(values) == 2 and (mirrored := _mirrored(*values)):
        return mirrored
    return between.join(values)


def _mirrored(one: str, other: str) -> str:
    """Both as one; empty if more differs than signs."""
    ones, others = _NUMBER.findall(one), _NUMBER.findall(other)
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other) or len(ones) < 2:  # two numbers alone are clearer as such
        return ""
    if any(first.lstrip("-") != second.lstrip("-") for first, second in zip(ones, others, strict=True)):
        return ""
    signed = [
        first if first == second else f"{'∓' if first.startswith('-') else '±'}{first.lstrip('-')}"
        for first, second in zip(ones, others, strict=True)
    ]
    numbers = iter(signed)
    return _NUMBER.sub(lambda _: next(numbers), one)
