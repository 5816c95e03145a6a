"""How a robot is told in a given room: which names stand together, what is told of each, and in how few characters."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from ros2_mcp.model.text import named

Item = TypeVar("Item")
_BRACES = re.compile(r"[{},«»\s]")
"""In a name: then it stands in no braces."""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


@dataclass(frozen=True, slots=True)
class Style:
    """What is told of each part of a robot. `is_brief`: what is alike stands together, in braces where names are, as
    a shell expands them (`/sonar/{left,right}`), and a type that is called as its topic is not told. `namespace`,
    which begins most names, is left out of them. `decimals` of limits, and digits of speeds. `has_senders`: who else
    sends to an input. `most_name`: characters of a name, longer ones are cut.
    """

    is_brief: bool = False
    namespace: str = ""
    decimals: int = 3
    has_senders: bool = True
    most_name: int = 255

    def name(self, name: str) -> str:
        """One name of the robot."""
        below = name.removeprefix(f"{self.namespace}/") if self.namespace else name
        return named(f"{below[: self.most_name]}…" if len(below) > self.most_name else below)

    def names(self, names: Iterable[str]) -> str:
        """Several of them."""
        return braced([self.name(name) for name in names])

    def groups(self, items: Iterable[Item], key: Callable[[Item], Hashable]) -> list[list[Item]]:
        """Each by itself; in brief those with equal keys together, where the first of them stood."""
        if not self.is_brief:
            return [[item] for item in items]
        found: dict[Hashable, list[Item]] = {}
        for item in items:
            found.setdefault(key(item), []).append(item)
        return list(found.values())


@dataclass(frozen=True, slots=True)
class Names:
    """What is told by name and type alone (`type` is empty where it needs none): a line that begins with `lead`."""

    lead: str
    found: Sequence[tuple[str, str]] = field(default=())
    more: int = 0
    """How many there are besides."""

    def in_words(self, style: Style) -> list[str]:
        """A line, or none where there is nothing."""
        found = [(name, "" if style.is_brief and is_called_as(kind, name) else kind) for name, kind in self.found]
        told = [
            f"{style.names(name for name, _ in group)}{f' {named(kind)}' if (kind := group[0][1]) else ''}"
            for group in style.groups(found, key=lambda one: one[1])
        ]
        more = [f"{self.more} more"] if self.more else []
        between = "; " if style.is_brief else ", "  # where several have one type
        return [f"{self.lead}: {between.join([*told, *more])}"] if told or more else []


def is_called_as(kind: str, name: str) -> bool:
    """Whether a type is called as the last part of a topic is: `BatteryState` and `/mavros/battery_state`."""
    return kind.lower() == name.rpartition("/")[2].replace("_", "").lower()


def braced(names: Sequence[str]) -> str:
    """Names one after the other, or what differs in braces where that is shorter: `joint_{1,2}`, `{L,R}Hip`."""
    apart = ", ".join(names)
    if len(set(names)) < max(len(names), 2) or any(map(_BRACES.search, names)):
        return apart
    before = _common_beginning(names)
    after = _common_beginning([name[len(before) :][::-1] for name in names])[::-1]
    while before and not all(_is_apart(name, len(before)) for name in names):
        before = before[:-1]
    while after and not all(_is_apart(name, len(name) - len(after)) for name in names):
        after = after[1:]
    inner = [name[len(before) : len(name) - len(after)] for name in names]
    together = f"{before}{{{','.join(inner)}}}{after}"
    return together if len(before + after) > 1 and all(inner) and len(together) < len(apart) else apart


def _common_beginning(names: Sequence[str]) -> str:
    first, last = min(names), max(names)  # what these two begin with, all between them do
    return first[
        : next((place for place, pair in enumerate(zip(first, last, strict=False)) if pair[0] != pair[1]), None)
    ]


def _is_apart(name: str, place: int) -> bool:
    """Whether one word ends there and another begins: `imu_|left`, `joint|7`, `L|Knee`."""
    if place in (0, len(name)):
        return place == 0
    left, right = name[place - 1], name[place]
    is_inside = (left.isalpha() and right.isalpha() and not right.isupper()) or (left.isdigit() and right.isdigit())
    return not is_inside and (left != "_" or right != "_")


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
