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
    "", "unhealthy", "command_inputs", "other_actions", "topics_without_publisher", "command_services", "sensors",
    "state_topics", "joints", "controllers",
]  # fmt: skip
"""A part of the answer; empty for all parts."""
_WEIGHTS: Mapping[str, float] = {
    "unhealthy": 0.5, "command_inputs": 0.8, "other_actions": 1.2, "topics_without_publisher": 1.2,
    "command_services": 1.6, "sensors": 0.6, "state_topics": 1.2, "joints": 1.0, "controllers": 0.9,
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
    """The robot: `kind` of base or arm, `footprint` relative to the origin of `base_frame`, and its pose (`place`: with
    the frame, the source and the age of the pose). `stacks` lists which of Nav2, MoveIt, ros2_control, MAVROS and
    others are running.

    The parts have one line per item, the most important first. `unhealthy` lists faults. `command_inputs` move the
    robot: topic or action, type, → the nodes that receive it, and from which nodes. `other_actions`,
    `topics_without_publisher` (their subscribers wait for messages) and `command_services` are further ways to command
    it. `sensors`: topic, type, rate, frame, pose of that frame in the base's frame (x y z in m; `z to` is the viewing
    direction of a camera), range. `state_topics`: other topics on which the robot reports its state, with the value or
    the rate. `joints`: current position, limits, maximum speed. `controllers` are active unless another state is given.

    All parts together have at most 4 kB. If a part has more lines than fit, its last line counts the omitted ones, and
    `part` returns all of them; `omitted` is the total. With `part`, the other parts except `unhealthy` have only
    counts.

    `not_read` lists parts that could not be read in time, or whose type is not known here (which says nothing about the
    robot), and topics of frames, odometry and diagnostics that have a publisher but sent no message, with how long this
    server waited for one. `read_from` is the recording, if this is not the live robot.
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
    topics_without_publisher: Sequence[str]
    command_services: Sequence[str]
    sensors: Sequence[str]
    state_topics: Sequence[str]
    joints: Sequence[str]
    controllers: Sequence[str]
    not_read: Sequence[str] | None = field(default=None, metadata=ON_REQUEST)
    omitted: int = field(default=0, metadata=SAID)
    read_from: str | None = field(default=None, metadata=ON_REQUEST)

    def summary(self) -> str:
        """Return the first lines of the text; the values hold the rest."""
        health = "" if self.unhealthy else " Nothing unhealthy seen."
        not_read = f" Not read: {', '.join(self.not_read)}." if self.not_read else ""
        omitted = f" {self.omitted} lines are omitted: part returns one part in full." if self.omitted else ""
        return f"{quoted(self.name)}: {self.kind}. {self.place}{health}{not_read}{omitted}"


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
    """Return `head` with the first `kept` lines of each part, and a line that counts the omitted lines."""
    parts: dict[str, Sequence[str]] = {}
    omitted = 0
    for part, all_of in lines.items():
        count = kept.get(part, 0)
        gone = len(all_of) - count
        account = [f'{gone}{" more" if count else ""}: part="{part}" shows all.'] if gone else []
        parts[part], omitted = [*all_of[:count], *account], omitted + gone
    return replace(head, omitted=omitted, **parts)


def _head(whole: RobotInBrief) -> RobotInBrief:
    """Return `whole` with all parts empty and room for the count in `omitted`; texts are cut if they exceed
    `_MOST_HEAD`.
    """
    head = replace(whole, omitted=99_999, **dict.fromkeys(_WEIGHTS, ()))
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
