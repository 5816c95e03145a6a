"""The brief description of the robot: one line per item, with each part cut so that the whole fits into 4 kB."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from ros2_mcp.model.text import quoted
from ros2_mcp.ops.results.results import ON_REQUEST, SAID, as_json
from ros2_mcp.ops.results.text import as_text

MOST_BYTES = 4_000
"""Size limit of the whole answer: it is read at the beginning of most sessions."""
Part = Literal[
    "", "unhealthy", "command_inputs", "other_actions", "waited_for", "command_services", "sensors", "also_told",
    "joints", "controllers",
]  # fmt: skip
"""A part of the answer; empty for all parts."""
_WEIGHTS: Mapping[str, float] = {
    "unhealthy": 0.5, "command_inputs": 0.8, "other_actions": 1.2, "waited_for": 1.2, "command_services": 1.6,
    "sensors": 0.6, "also_told": 1.2, "joints": 1.0, "controllers": 0.9,
}  # fmt: skip
"""Weights for shortening: while the whole is too long, the part with the largest product of bytes and weight loses its
last line."""
_ACCOUNT = 50
"""Bytes reserved for the line that counts the omitted lines of a part."""
_MOST_HEAD, _MOST_NAME, _MOST_TEXT = 1_200, 60, 200
"""Limit in bytes of the fields that belong to no part; where they exceed it, the limits in characters of the name and
of each other text. Nodes can report texts of any length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotInBrief:
    """The robot: `kind` of base or arm, `footprint` about the origin of `base_frame`, and where it is (`place`: in
    which frame, how that is known, how old). `stacks` are Nav2, MoveIt, ros2_control, MAVROS and others, as far as they
    run.

    The parts have one line for each thing, the most important first. `unhealthy` is what is wrong. `command_inputs`
    move the robot: topic or action, type, → the nodes that take it, from whom. `other_actions`, `waited_for` (topics
    whose subscribers wait for messages that nobody sends) and `command_services` are what else it can be told to do.
    `sensors`: topic, type, rate, frame, where that is in the base's frame (x y z in m; `z to` is where a camera looks),
    range. `also_told`: what else the robot publishes of itself, with the value or the rate. `joints`: position now,
    limits, greatest speed. `controllers` are active where nothing else is said.

    The whole is at most 4 kB. Where a part has more lines than fit, its last line counts those that are left out, and
    `part` gives them all; `left_out` is the sum of them. With `part` the other parts, but `unhealthy`, are counted.

    `not_read` are the parts that were not there within the time of this answer, or whose type is not known here, which
    says nothing of the robot; and the topics of frames, odometry and diagnostics that somebody publishes and that were
    silent, with how long they were listened to. `read_from` is the recording, where it is not of the live robot.
    """

    name: str = field(metadata=SAID)
    kind: str = field(metadata=SAID)
    base_frame: str
    footprint: str
    place: str = field(metadata=SAID)
    frames: str
    stacks: Sequence[str]
    unhealthy: Sequence[str]
    command_inputs: Sequence[str]
    other_actions: Sequence[str]
    waited_for: Sequence[str]
    command_services: Sequence[str]
    sensors: Sequence[str]
    also_told: Sequence[str]
    joints: Sequence[str]
    controllers: Sequence[str]
    not_read: Sequence[str] | None = field(default=None, metadata=ON_REQUEST)
    left_out: int = field(default=0, metadata=SAID)
    read_from: str | None = field(default=None, metadata=ON_REQUEST)

    def summary(self) -> str:
        """Return the first lines of the text; the values hold the rest."""
        health = "" if self.unhealthy else " Nothing unhealthy seen."
        not_read = f" Not read: {', '.join(self.not_read)}." if self.not_read else ""
        left_out = f" {self.left_out} lines are left out: part shows all of one part." if self.left_out else ""
        return f"{quoted(self.name)}: {self.kind}. {self.place}{health}{not_read}{left_out}"


def within(whole: RobotInBrief, most_bytes: int) -> RobotInBrief:
    """Return the whole if it has at most `most_bytes`; else shorten its parts until it fits."""
    if _size(whole) <= most_bytes:
        return whole
    lines = _lines(whole)
    head = _head(whole)
    room = most_bytes - _size(head)
    costs = {part: [_cost(line) for line in lines[part]] for part in lines}
    used: dict[str, int] = {part: len(part) + 2 + sum(costs[part]) for part in lines if lines[part]}
    kept: dict[str, int] = {part: len(lines[part]) for part in used}
    while sum(used.values()) > room and any(kept.values()):
        part = max((part for part in used if kept[part]), key=lambda part: used[part] * _WEIGHTS[part])
        used[part] += _ACCOUNT if kept[part] == len(lines[part]) else 0
        kept[part] -= 1
        used[part] -= costs[part][kept[part]]
    return _with_first(head, lines, kept)


def one_part(whole: RobotInBrief, part: Part) -> RobotInBrief:
    """Return one part in full, and `unhealthy`; for each other part only the count of its lines."""
    lines = _lines(whole)
    return _with_first(whole, lines, {name: len(lines[name]) if name in (part, "unhealthy") else 0 for name in lines})


def _lines(whole: RobotInBrief) -> dict[str, Sequence[str]]:
    return {part: getattr(whole, part) for part in _WEIGHTS}


def _with_first(head: RobotInBrief, lines: Mapping[str, Sequence[str]], kept: Mapping[str, int]) -> RobotInBrief:
    """Return `head` with the first `kept` lines of each part, and a line that counts the omitted ones."""
    parts: dict[str, Sequence[str]] = {}
    left_out = 0
    for part, all_of in lines.items():
        count = kept.get(part, 0)
        gone = len(all_of) - count
        account = [f'{gone}{" more" if count else ""}: part="{part}" shows all.'] if gone else []
        parts[part], left_out = [*all_of[:count], *account], left_out + gone
    return replace(head, left_out=left_out, **parts)


def _head(whole: RobotInBrief) -> RobotInBrief:
    """Return `whole` with all parts empty and room for the count in `left_out`; texts are cut if they exceed
    `_MOST_HEAD`.
    """
    head = replace(whole, left_out=99_999, **dict.fromkeys(_WEIGHTS, ()))
    if _size(head) <= _MOST_HEAD:
        return head
    texts = {name: getattr(head, name)[:_MOST_TEXT] for name in ("kind", "footprint", "place", "frames")}
    not_read = [line[:_MOST_TEXT] for line in head.not_read] if head.not_read else None
    read_from = head.read_from[:_MOST_TEXT] if head.read_from else None
    return replace(head, name=head.name[:_MOST_NAME], not_read=not_read, read_from=read_from, **texts)


def _cost(line: str) -> int:
    """Return the bytes of a line in JSON or in the text, whichever is more."""
    return max(len(json.dumps(line, ensure_ascii=False).encode()) + 1, len(line.encode()) + 3)


def _size(brief: RobotInBrief) -> int:
    """Return the bytes of the answer as JSON or as text, whichever is more."""
    value = json.dumps(as_json(brief), ensure_ascii=False, separators=(",", ":"))
    return max(len(value.encode()), len(as_text(brief).encode()))
