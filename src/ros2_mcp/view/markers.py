"""Convert markers (visualization_msgs) for the page: the markers added and not deleted on each topic, within bounds."""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model.poses import Pose
from ros2_mcp.model.text import counted, named, quoted

MARKER, MARKER_ARRAY = "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray"
MOST_MARKERS = 1000
"""Markers of one topic; RViz itself becomes slow with some thousand."""
_MOST_OF_MESSAGE = 5000
_MOST_POINTS = 20_000
"""Points of one marker."""
_MOST_TEXT = 200
_FARTHEST = 1e6
KINDS = (
    "arrow",
    "cube",
    "sphere",
    "cylinder",
    "line strip",
    "line list",
    "cube list",
    "sphere list",
    "points",
    "text",
    "mesh",
    "triangles",
    "arrow strip",
)
"""Names of the marker types, by their number."""
_LEAST_POINTS = {4: 2, 5: 2, 6: 1, 7: 1, 8: 1, 11: 3, 12: 2}
_ADD, _DELETE, _DELETE_ALL = 0, 2, 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Marker:
    """One marker: its `pose` in `frame` at `stamp_ns` (0: always the newest transform).

    `until_ns` is when it expires (None: never), and `body` the part that changes less often than the pose.
    """

    frame: str
    stamp_ns: int
    pose: Pose
    until_ns: int | None
    body: Mapping[str, Any]


@dataclass
class MarkersOfTopic:
    """The markers of one topic by namespace and id; `refused` has the reason for each marker that cannot be drawn."""

    topic: str
    markers: dict[tuple[str, int], Marker] = field(default_factory=dict[tuple[str, int], Marker])
    refused: dict[tuple[str, int], str] = field(default_factory=dict[tuple[str, int], str])
    received_ns: int = 0
    left_out: int = 0

    def take(self, message: Any, received_ns: int) -> None:
        """Apply a Marker or MarkerArray, received at that time."""
        self.received_ns = received_ns
        for one in message.markers[:_MOST_OF_MESSAGE] if hasattr(message, "markers") else [message]:
            self._one(one, received_ns)

    def shown(self, at_ns: int) -> Sequence[Marker]:
        """Return the markers that are visible at a time; drop expired markers."""
        over = [key for key, one in self.markers.items() if one.until_ns is not None and one.until_ns < at_ns]
        for key in over:
            del self.markers[key]
        return list(self.markers.values())

    def problems(self) -> list[str]:
        """Describe the markers that are not drawn."""
        found = [
            f"{named(self.topic)}: the marker {_called(key)} {why}." for key, why in list(self.refused.items())[:2]
        ]
        if len(self.refused) > len(found):
            found.append(f"{named(self.topic)}: {counted(len(self.refused) - len(found), 'more marker')} not drawn.")
        if self.left_out:
            found.append(f"{named(self.topic)}: only {MOST_MARKERS} of its markers are drawn.")
        return found

    def _one(self, one: Any, received_ns: int) -> None:
        key = (str(one.ns)[:_MOST_TEXT], int(one.id))
        if one.action == _DELETE_ALL:
            gone = [known for known in {**self.markers, **self.refused} if not one.ns or known[0] == key[0]]
            for known in gone:
                self._forget(known)
            self.left_out = 0
            return
        self._forget(key)
        if one.action == _DELETE:
            return
        why = f"has the action {one.action}, which does not exist" if one.action != _ADD else _why_not(one)
        if why:
            if len(self.refused) < MOST_MARKERS:
                self.refused[key] = why
        elif len(self.markers) >= MOST_MARKERS:
            self.left_out += 1
        else:
            self.markers[key] = _marker(one, received_ns)

    def _forget(self, key: tuple[str, int]) -> None:
        self.markers.pop(key, None)
        self.refused.pop(key, None)


def _called(key: tuple[str, int]) -> str:
    return f"{quoted(key[0])}/{key[1]}" if key[0] else str(key[1])


def _why_not(one: Any) -> str:
    """Return why a marker cannot be drawn; empty if it can."""
    if not 0 <= one.type < len(KINDS):
        return f"has the type {one.type}, which does not exist"
    place, turn = one.pose.position, one.pose.orientation
    numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, one.scale.x, one.scale.y, one.scale.z)
    if not all(math.isfinite(value) and abs(value) < _FARTHEST for value in numbers):
        return "has a pose or size that is not finite or is too large"
    if not all(math.isfinite(part) for part in (one.color.r, one.color.g, one.color.b, one.color.a)):
        return "has a colour that is not finite"
    count = len(one.points)
    if count < _LEAST_POINTS.get(one.type, 0) or (one.type == 0 and count == 1):
        return f"({KINDS[one.type]}) has only {count} points"
    if one.type == 9 and not one.text:
        return "has no text"
    return ""


def _marker(one: Any, received_ns: int) -> Marker:
    place, turn = one.pose.position, one.pose.orientation
    length = math.sqrt(turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2)
    turned = (turn.x / length, turn.y / length, turn.z / length, turn.w / length) if length > 1e-6 else None
    lifetime_ns = one.lifetime.sec * 1_000_000_000 + one.lifetime.nanosec
    stamp_ns = one.header.stamp.sec * 1_000_000_000 + one.header.stamp.nanosec
    body: dict[str, Any] = {
        "kind": one.type,
        "scale": [round(float(value), 5) for value in (one.scale.x, one.scale.y, one.scale.z)],
        "rgba": [_share(part) for part in (one.color.r, one.color.g, one.color.b, one.color.a)],
    }
    if one.type == 9:
        body["text"] = str(one.text)[:_MOST_TEXT]
    if one.type == 10:
        body["mesh"] = str(one.mesh_resource)[:500]
        body["own"] = bool(one.mesh_use_embedded_materials)
    if one.type in _LEAST_POINTS or (one.type == 0 and len(one.points)):
        body |= _points(one)
    return Marker(
        frame=str(one.header.frame_id).lstrip("/")[:_MOST_TEXT],
        # A marker with `frame_locked` follows its frame; any other one stays where it was put.
        stamp_ns=0 if one.frame_locked else stamp_ns,
        pose=Pose((place.x, place.y, place.z), turned or (0.0, 0.0, 0.0, 1.0)),
        until_ns=received_ns + lifetime_ns if lifetime_ns > 0 else None,
        body=body,
    )


def _points(one: Any) -> Mapping[str, Any]:
    """Return `points` (x, y, z as 32-bit floats) and `colours` (red, green, blue, a byte each), both in base64.

    Points that are not finite are omitted with their line or triangle; colours are ignored unless there are as many as
    points.
    """
    colours = one.colors if len(one.colors) == len(one.points) else ()
    if one.type == 11 and len(one.colors) * 3 == len(one.points):  # one colour for each triangle
        colours = [colour for colour in one.colors[: _MOST_POINTS // 3 + 1] for _ in range(3)]
    step = {5: 2, 11: 3}.get(one.type, 1)
    count = min(len(one.points), _MOST_POINTS) // step * step
    kept: list[int] = []
    for begin in range(0, count, step):
        group = range(begin, begin + step)
        if all(_is_place(one.points[at]) for at in group):
            kept += group
    told: dict[str, Any] = {"points": _packed("<f", [(p.x, p.y, p.z) for p in (one.points[at] for at in kept)])}
    if colours:
        shades = [(colours[at].r, colours[at].g, colours[at].b) for at in kept]
        told["colours"] = _packed("B", [[round(_share(part) * 255) for part in shade] for shade in shades])
    return told


def _is_place(point: Any) -> bool:
    return all(math.isfinite(value) and abs(value) < _FARTHEST for value in (point.x, point.y, point.z))


def _packed(kind: str, rows: Sequence[Sequence[float]]) -> str:
    flat = [value for row in rows for value in row]
    return base64.b64encode(struct.pack(f"{kind[:-1]}{len(flat)}{kind[-1]}", *flat)).decode("ascii")


def _share(part: float) -> float:
    """Limit a colour component to 0 to 1."""
    return round(min(max(float(part), 0.0), 1.0), 3) if math.isfinite(part) else 0.0
