"""The robot in brief: its parts in words, and as many of them as two kilobytes hold."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ros2_mcp.model.text import quoted
from ros2_mcp.ops.results.results import ON_REQUEST, SAID, as_json
from ros2_mcp.ops.results.text import as_text
from ros2_mcp.ops.space.controllers import Controller, controllers_in_words
from ros2_mcp.ops.space.inputs import CommandInput, inputs_in_words
from ros2_mcp.ops.space.joints import JointNow, joints_in_words, without_last_speeds
from ros2_mcp.ops.space.sensors import Sensor, sensors_in_words
from ros2_mcp.ops.space.style import Names, Style

MOST_BYTES = 2_000
"""Of the answer: it is read at the beginning of most sessions."""
_WEIGHTS = {
    "inputs": 0.8, "actions": 1.2, "waited": 1.2, "services": 1.6, "sensors": 0.6, "told": 1.2, "joints": 1.0,
    "controllers": 0.9, "unhealthy": 0.5,
}  # fmt: skip
"""Which part loses its last where the whole is too long: that with the most characters times this."""
_BESIDES, _LEAST_BESIDES, _MOST_BESIDES = ("actions", "waited", "told"), 4, 100
"""What is told by its name alone; how much of it stays before what is described loses anything; how much at most."""
_FIRST_PART, _SHARED = re.compile(r"(/\w+)/"), 4
"""Of a name; so many names have it at least, and half of all, where it is told once."""
_MOST_NAME, _MOST_TEXT = 60, 200
"""Characters of a name and of a sentence where all else did not help: more somebody has made to be long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotInBrief:
    """The robot: `kind` of base or arm, `footprint` about the origin of `base_frame`, `command_inputs` (topic, type,
    who listens), `sensors` (topic, type, rate, mount in the base's frame in m, range), `joints` (position now, limits,
    greatest speed; rad or m), `controllers` (active, where nothing else is said), and where it is (`place`: in which
    frame, how that is known, how old). `stacks` are Nav2, MoveIt, ros2_control, MAVROS and others, as far as they run.

    What does not fit into 2 kB is told more shortly. A name has braces: `/sonar/{left,right}` are two, and what follows
    names is of all of them up to the last semicolon or line: one value of all, several of each in their order, in the
    last braces if there are two (± is the first one's + and the second's -; `mirrored` limits are negated and swapped;
    `all these 1/s` is the speed of each joint above). An input without → is taken by the node that its name begins
    with, if any; topics and nodes that do not begin with / are below `namespace`; joints without a unit are in rad;
    types may be missing, and the frames of sensors, whose places are told; `z to` is where a camera looks; `9 of Nav2`
    are actions that every Nav2 has. `left_out` counts what did not fit even so; the whole of it leaves nothing out.

    `not_read` are the parts that were not there within the time of this answer, or whose type is not known here, which
    says nothing of the robot; and the topics of frames, odometry and diagnostics that somebody publishes and that were
    silent, with how long they were listened to. `read_from` is the recording, where it is not of the live robot.
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
    read_from: str | None = field(default=None, metadata=ON_REQUEST)

    def summary(self) -> str:
        """A line: the rest stands in the values."""
        health = "" if self.unhealthy else " Nothing unhealthy seen."
        not_read = f" Not read: {', '.join(self.not_read)}." if self.not_read else ""
        left_out = f" {self.left_out} left out: whole=true shows all." if self.left_out else ""
        return f"{quoted(self.name)}: {self.kind}. {self.place}{health}{not_read}{left_out}"


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
    read_from: str = ""

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
            read_from=self.read_from or None,
        )


def within(parts: Parts, most_bytes: int) -> RobotInBrief:
    """All of it, told as shortly as it must be; where even that is too long, without what is needed least."""
    brief, left_out = parts.in_words(Style()), 0
    for style, shorter, count in _shorter(parts):
        left_out += count
        brief = shorter.in_words(style, left_out)
        if _size(brief) <= most_bytes:
            break
    return brief


def _shorter(parts: Parts) -> Iterator[tuple[Style, Parts, int]]:
    """The same in ever fewer words, each with how many names, lines or speeds it lacks that the one before had."""
    yield (style := Style()), parts, 0
    yield (style := replace(style, is_brief=True)), parts, 0
    yield (style := replace(style, namespace=_namespace(parts))), parts, 0
    yield (style := replace(style, decimals=2)), parts, 0
    yield (style := replace(style, has_senders=False)), parts, 0
    inputs = [one for one in parts.inputs if one.use != "joystick"]
    count = len(parts.inputs) - len(inputs)
    yield style, (parts := replace(parts, inputs=inputs)), count
    yield (style := replace(style, has_types=False)), parts, 0
    for name in (*_BESIDES, "services"):  # a graph of a thousand topics is not told one shorter a thousand times
        if (count := _length(parts, name) - _MOST_BESIDES) > 0:
            yield style, (parts := _without_last(parts, name, count)), count
    while parts.services.found:
        yield style, (parts := _without_last(parts, "services")), 1
    yield style, (parts := replace(parts, actions=parts.actions.with_known())), 0
    yield (style := replace(style, has_controller_types=False)), parts, 0
    yield (style := replace(style, has_listeners=False)), parts, 0
    yield (style := replace(style, has_frames=False)), parts, 0
    while name := _longest(parts, style, _BESIDES, least=_LEAST_BESIDES):
        yield style, (parts := _without_last(parts, name)), 1
    count = sum(bool(one.view) for one in parts.sensors)
    yield style, (parts := replace(parts, sensors=[replace(one, view="") for one in parts.sensors])), count
    while any(joint.speed for joint in parts.joints):
        joints, count = without_last_speeds(parts.joints)
        yield style, (parts := replace(parts, joints=joints)), count
    yield (style := replace(style, most_name=_MOST_NAME)), (parts := _with_short_texts(parts)), 0
    while name := _longest(parts, style, _WEIGHTS):
        yield style, (parts := _without_last(parts, name)), 1


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
    besides = (parts.actions, parts.waited, parts.services, parts.told)
    names += [one.name for line in besides for one in line.found]
    firsts = Counter(match[1] for name in names if (match := _FIRST_PART.match(name)))
    namespace, count = firsts.most_common(1)[0] if firsts else ("", 0)
    return namespace if count >= _SHARED and count * 2 >= len(names) else ""


def _longest(parts: Parts, style: Style, names: Iterable[str], least: int = 0) -> str:
    """The list that has to lose its last, of those that have more than the `least`; empty where none has."""

    def weight(name: str) -> float:
        return sum(map(len, _lines(parts, name, style))) * _WEIGHTS[name]

    return max((name for name in names if _length(parts, name) > least), key=weight, default="")


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


def _without_last(parts: Parts, name: str, count: int = 1) -> Parts:
    """The same without the last of a list."""
    part: Any = getattr(parts, name)
    if isinstance(part, Names):
        return replace(parts, **{name: replace(part, found=part.found[:-count], more=part.more + count)})
    return replace(parts, **{name: part[:-count]})


def _size(brief: RobotInBrief) -> int:
    """Bytes of its JSON, or of its text, whichever is more."""
    value = json.dumps(as_json(brief), ensure_ascii=False, separators=(",", ":"))
    return max(len(value.encode()), len(as_text(brief).encode()))
