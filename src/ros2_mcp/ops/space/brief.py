"""The robot in brief: its parts in words, and as many of them as two kilobytes hold."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ros2_mcp.model.text import quoted, visible, visible_json
from ros2_mcp.ops.results import ON_REQUEST, SAID, as_json
from ros2_mcp.ops.results import in_brief as in_text
from ros2_mcp.ops.space.controllers import Controller, controllers_in_words
from ros2_mcp.ops.space.inputs import CommandInput, inputs_in_words
from ros2_mcp.ops.space.joints import JointNow, joints_in_words, without_last_speeds
from ros2_mcp.ops.space.sensors import Sensor, sensors_in_words
from ros2_mcp.ops.space.style import Names, Style

MOST_BYTES = 2_000
"""Of the answer: it is read at the beginning of most sessions."""
_DROPPED = {
    "inputs": 0.8, "actions": 1.2, "waited": 1.2, "services": 1.6, "sensors": 0.6, "told": 1.2, "joints": 1.0,
    "controllers": 1.2, "unhealthy": 0.5,
}  # fmt: skip
"""Which part loses its last where the whole is too long: that with the most characters times this."""
_FIRST_PART, _SHARED = re.compile(r"(/\w+)/"), 4
"""Of a name; so many names have it at least, and half of all, where it is told once."""
_MOST_NAME, _MOST_TEXT = 60, 200
"""Characters of a name and of a sentence where all else did not help: more somebody has made to be long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotInBrief:
    """The robot: `kind` of base or arm, `footprint` about the origin of `base_frame`, `command_inputs` (topic, type,
    who listens), `sensors` (topic, type, rate, mount in the base's frame in m, range), `joints` (position now, limits,
    greatest speed; rad or m), and where it is (`place`: in which frame, how that is known, how old). `stacks` are Nav2,
    MoveIt, ros2_control, MAVROS and others, as far as they run.

    Where it would be long, a name has braces: `/sonar/{left,right}` are two, and one value is of both, several are of
    each in their order (± is the first one's + and the second's -); joints without a unit are in rad; topics and nodes
    that do not begin with / are below `namespace`; a type that is called as its topic is not told. `left_out` counts
    what did not fit into 2 kB even so; the whole of it leaves nothing out. `not_read` are the parts that were not there
    within the time of this answer, or whose type is not known here, which says nothing of the robot.
    """

    name: str = field(metadata=SAID)
    kind: str = field(metadata=SAID)
    base_frame: str
    footprint: str
    place: str = field(metadata=SAID)
    command_inputs: Sequence[str]
    sensors: Sequence[str]
    joints: Sequence[str]
    controllers: Sequence[str]
    stacks: Sequence[str]
    frames: str
    unhealthy: Sequence[str]
    namespace: str | None = field(default=None, metadata=ON_REQUEST)
    not_read: Sequence[str] | None = field(default=None, metadata=ON_REQUEST)
    left_out: int = field(default=0, metadata=SAID)
    read_from: str = field(default="live")

    def summary(self) -> str:
        """A line: the rest stands in the values."""
        health = f"unhealthy: {len(self.unhealthy)} finding(s)" if self.unhealthy else "nothing unhealthy seen"
        not_read = f" Not read: {', '.join(self.not_read)}." if self.not_read else ""
        left_out = (
            f" {self.left_out} name(s), line(s) or speed(s) left out: whole=true tells all." if self.left_out else ""
        )
        return f"{quoted(self.name)}: {self.kind}. {self.place} {health}.{not_read}{left_out}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What is known of a robot, in the order in which it is told: of each list the last are needed least."""

    name: str
    kind: str
    base_frame: str
    footprint: str
    place: str
    inputs: Sequence[CommandInput] = ()
    actions: Names
    waited: Names
    services: Names
    sensors: Sequence[Sensor] = ()
    told: Names
    joints: Sequence[JointNow] = ()
    controllers: Sequence[Controller] = ()
    stacks: Sequence[str] = ()
    frames: str
    unhealthy: Sequence[str] = ()
    not_read: Sequence[str] = ()
    read_from: str = "live"

    def in_words(self, style: Style, left_out: int = 0) -> RobotInBrief:
        """All of it, told in one style."""
        asked = (*self.actions.in_words(style), *self.waited.in_words(style), *self.services.in_words(style))
        return RobotInBrief(
            name=self.name,
            kind=self.kind,
            base_frame=self.base_frame,
            footprint=self.footprint,
            place=self.place,
            command_inputs=[*inputs_in_words(self.inputs, style), *asked],
            sensors=[*sensors_in_words(self.sensors, style), *self.told.in_words(style)],
            joints=joints_in_words(self.joints, style),
            controllers=controllers_in_words(self.controllers, style),
            stacks=self.stacks,
            frames=self.frames,
            unhealthy=self.unhealthy,
            namespace=style.namespace or None,
            not_read=self.not_read or None,
            left_out=left_out,
            read_from=self.read_from,
        )


def within(parts: Parts, most_bytes: int) -> RobotInBrief:
    """All of it, told as shortly as it must be; where even that is too long, without speeds, then without the ends of
    its lists.
    """
    styles = list(_styles(parts))
    for style in styles:
        if _size(brief := parts.in_words(style)) <= most_bytes:
            return brief
    style, left_out = styles[-1], 0
    while any(joint.speed for joint in parts.joints):
        joints, count = without_last_speeds(parts.joints)
        parts, left_out = replace(parts, joints=joints), left_out + count
        if _size(brief := parts.in_words(style, left_out)) <= most_bytes:
            return brief
    parts, style = _with_short_texts(parts), replace(style, most_name=_MOST_NAME)
    while _size(brief := parts.in_words(style, left_out)) > most_bytes and (longest := _longest(parts, style)):
        parts, left_out = _without_last(parts, longest), left_out + 1
    return brief


def _styles(parts: Parts) -> Iterator[Style]:
    """One shorter than the other."""
    yield Style()
    yield (brief := Style(is_brief=True))
    yield (below := replace(brief, namespace=_namespace(parts)))
    yield (coarse := replace(below, decimals=2))
    yield replace(coarse, has_senders=False)


def _with_short_texts(parts: Parts) -> Parts:
    """The same, where sentences that somebody has made to be long are cut."""
    texts = {name: getattr(parts, name)[:_MOST_TEXT] for name in ("kind", "footprint", "place", "frames", "read_from")}
    return replace(
        parts, name=parts.name[:_MOST_NAME], unhealthy=[line[:_MOST_TEXT] for line in parts.unhealthy], **texts
    )


def _namespace(parts: Parts) -> str:
    """The first part that most names of topics, nodes and actions share; empty where there is none."""
    names = [*(one.topic for one in parts.inputs), *(one.topic for one in parts.sensors)]
    names += [name for one in parts.inputs for name in one.listeners]
    names += [one.name for one in parts.controllers]
    names += [name for line in (parts.actions, parts.waited, parts.services, parts.told) for name, _ in line.found]
    firsts = Counter(match[1] for name in names if (match := _FIRST_PART.match(name)))
    namespace, count = firsts.most_common(1)[0] if firsts else ("", 0)
    return namespace if count >= _SHARED and count * 2 >= len(names) else ""


def _longest(parts: Parts, style: Style) -> str:
    """The list that has to lose its last; empty where none has anything."""

    def weight(name: str) -> float:
        return sum(map(len, _lines(parts, name, style))) * _DROPPED[name] if _length(parts, name) else 0.0

    longest = max(_DROPPED, key=weight)
    return longest if _length(parts, longest) else ""


def _lines(parts: Parts, name: str, style: Style) -> Sequence[str]:
    part: Any = getattr(parts, name)
    if isinstance(part, Names):
        return part.in_words(style)
    if name == "unhealthy":
        return parts.unhealthy
    words: dict[str, Any] = {
        "inputs": inputs_in_words, "sensors": sensors_in_words, "joints": joints_in_words,
        "controllers": controllers_in_words,
    }  # fmt: skip
    return words[name](part, style)


def _length(parts: Parts, name: str) -> int:
    part = getattr(parts, name)
    return len(part.found) if isinstance(part, Names) else len(part)


def _without_last(parts: Parts, name: str) -> Parts:
    part: Any = getattr(parts, name)
    if isinstance(part, Names):
        return replace(parts, **{name: replace(part, found=part.found[:-1], more=part.more + 1)})
    return replace(parts, **{name: part[:-1]})


def _size(brief: RobotInBrief) -> int:
    """Bytes of its JSON, or of its text, whichever is more."""
    value, summary = as_json(brief), brief.summary()
    _, structured = visible_json(value)
    _, text = visible_json(in_text(brief, value, summary)[0])
    return max(len(structured.encode()), len(f"{visible(summary)}\n{text}".encode()))
