"""Points, vectors, quaternions and poses in a message field, to be transformed into another frame."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import BadData, BadInput
from ros2_mcp.model.poses import Pose, normalised
from ros2_mcp.model.text import named
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.world.transforms import pose_of
from ros2_mcp_common.finite import not_finite

_LISTEN_S = 5.0
"""Time to wait for a live message: longer than the period of the slowest usual topics (1 s)."""
_WITHIN = {
    "PointStamped": "point",
    "Vector3Stamped": "vector",
    "QuaternionStamped": "quaternion",
    "PoseStamped": "pose",
    "PoseWithCovariance": "pose",
    "PoseWithCovarianceStamped": "pose",
    "PoseArray": "poses",
    "Path": "poses",
    "Odometry": "pose",
    "PolygonStamped": "polygon",
    "Polygon": "points",
}
"""The field that holds the geometry, by the message type's name in geometry_msgs and nav_msgs."""
_PLACES = {"Point": 3, "Point32": 3, "Vector3": 0, "Quaternion": 4, "Pose": 7}
"""Types that can be transformed, with their size in the result: 3 a point, 0 a vector, 4 a quaternion, 7 a pose (see
`tf_lookup._carried`)."""


@dataclass(frozen=True, slots=True)
class Given:
    """The geometry of a message: its frame, its stamp (0: none), its poses, and the size code of each as in
    `_PLACES`.
    """

    frame: str
    stamp_ns: int
    poses: Sequence[Pose]
    sizes: Sequence[int]
    note: str


async def given_in(source: Source, text: str, most: int, report: Report) -> Given:
    """Read the next message of `/topic:path` and return its geometry, at most `most` values; without a path, that of
    the whole message.

    Raises:
        BadInput: if the message has no frame, or what the path leads to cannot be given in another one.
        BadValue: for a path that does not exist.
        NotFound, TimedOut, TypeConflict, BadData: as `next_message`.
    """
    await load("ros2_mcp.values.select")  # with numpy: not before it is needed
    from ros2_mcp.values.select import parse_field

    topic, _, path = text.strip().partition(":")
    lasting = source.lasting(_LISTEN_S)
    type_name = await lasting.type_of(topic)
    found = await next_message(lasting, topic, type_name, report)
    message, kind = found.message, type_name.rpartition("/")[2]
    header = getattr(message, "header", None)
    values: Any = message
    if path:
        field = parse_field(lasting.codec.definitions, type_name, path)
        values, kind = field.value_in(message), field.type.base.rpartition("/")[2]
    flat = await asyncio.to_thread(_flat, values, kind, most + 1)
    if not flat:
        known = ", ".join(_PLACES)
        raise BadInput(f"{named(text)} is {named(kind)}, with nothing to transform.", f"Name a field that is {known}.")
    frame = getattr(header, "frame_id", "")
    poses: list[Pose] = []
    for number, (value, kind) in enumerate(flat[:most]):
        try:
            poses.append(_pose(value, kind))
        except ValueError as error:
            which = f"{named(text)}, {kind} {number + 1} of {len(flat)}" if len(flat) > 1 else named(text)
            raise BadData(f"{which} cannot be transformed: {error}.") from error
    stamp = header.stamp if header else None
    note = (
        f"From {named(topic)}, in the frame {named(frame)}."
        if frame
        else f"{named(topic)} has no header: source gives its frame."
    )
    note += f" {found.age[0].upper()}{found.age[1:]}." if found.age else ""
    note += f" Only the first {most} are transformed." if len(flat) > most else ""
    stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec if stamp else 0
    return Given(frame.lstrip("/"), stamp_ns, poses, [_PLACES[kind] for _, kind in flat[:most]], note)


def _flat(value: Any, kind: str, most: int) -> list[tuple[Any, str]]:
    """Return the values that can be transformed, each with its type name; lists are flattened."""
    if isinstance(value, (list, tuple)):
        found: list[tuple[Any, str]] = []
        for one in cast("Sequence[Any]", value):
            found += _flat(one, kind, most)
            if len(found) >= most:
                break
        return found
    if kind in _PLACES:
        return [(value, kind)]
    if kind in _WITHIN:
        inner = getattr(value, _WITHIN[kind])
        return _flat(inner, _inner_kind(kind), most)
    return []


def _inner_kind(kind: str) -> str:
    inner = {
        "PointStamped": "Point",
        "Vector3Stamped": "Vector3",
        "QuaternionStamped": "Quaternion",
        "PoseWithCovarianceStamped": "PoseWithCovariance",
        "Odometry": "PoseWithCovariance",
        "Path": "PoseStamped",
        "PolygonStamped": "Polygon",
        "Polygon": "Point32",
    }
    return inner.get(kind, "Pose")


def _pose(value: Any, kind: str) -> Pose:
    if kind == "Pose":
        return pose_of(value)
    if kind == "Quaternion":
        if why := not_finite(value, "x", "y", "z", "w"):
            raise ValueError(why)
        return Pose(rotation=normalised((value.x, value.y, value.z, value.w)))
    if why := not_finite(value, "x", "y", "z"):
        raise ValueError(why)
    return Pose((value.x, value.y, value.z))
