"""Markers are added, changed, deleted and end; hostile ones are refused in words, and break nothing."""

from __future__ import annotations

import base64
import math
from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp.view.markers import MOST_MARKERS, MarkersOfTopic

SECOND = 1_000_000_000
HUGE = "<img src=x onerror=hit()>" * 40_000


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return SimpleNamespace(x=x, y=y, z=z)


def marker(**changed: Any) -> Any:
    """A message of one cube."""
    given = {
        "header": SimpleNamespace(frame_id="map", stamp=SimpleNamespace(sec=0, nanosec=0)),
        **{"ns": "", "id": 0, "type": 1, "action": 0, "frame_locked": False, "text": "", "mesh_resource": ""},
        "pose": SimpleNamespace(position=at(1.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)),
        **{"scale": at(1.0, 1.0, 1.0), "color": SimpleNamespace(r=1.0, g=0.0, b=2.0, a=math.inf), "points": []},
        **{"lifetime": SimpleNamespace(sec=0, nanosec=0), "colors": [], "mesh_use_embedded_materials": False},
    }
    if "color" not in changed:
        given["color"] = SimpleNamespace(r=1.0, g=0.0, b=2.0, a=1.0)
    return SimpleNamespace(**{**given, **changed})


def ids(of: MarkersOfTopic, at_ns: int = 0) -> list[float]:
    return [one.pose.translation[0] for one in of.shown(at_ns)]


def test_markers_are_added_changed_deleted_and_end() -> None:
    of = MarkersOfTopic("/markers")
    many = [marker(id=number, ns="ab"[number % 2]) for number in range(6)]
    of.take(SimpleNamespace(markers=many), 0)
    assert len(of.shown(0)) == 6
    moved = SimpleNamespace(position=at(9.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0))
    of.take(marker(id=0, ns="a", pose=moved), 0)
    assert sorted(ids(of)) == [1.0] * 5 + [9.0]
    of.take(marker(id=0, ns="a", action=2), 0)
    of.take(marker(id=0, ns="b", action=2), 0)  # which there is not
    assert ids(of) == [1.0] * 5
    of.take(marker(ns="b", action=3), 0)
    assert len(of.shown(0)) == 2
    of.take(marker(id=7, lifetime=SimpleNamespace(sec=1, nanosec=0)), 5 * SECOND)
    assert (len(of.shown(6 * SECOND)), len(of.shown(6 * SECOND + 1))) == (3, 2)
    of.take(marker(action=3), 0)
    assert of.shown(0) == [] and of.problems() == []


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"type": 99}, "the type 99"),
        ({"type": -1}, "the type -1"),
        ({"action": 77}, "the action 77"),
        ({"scale": at(math.nan)}, "not finite"),
        ({"scale": at(1e300)}, "too large"),
        ({"color": SimpleNamespace(r=math.nan, g=0.0, b=0.0, a=1.0)}, "colour"),
        ({"type": 4, "points": [at()]}, "only 1 points"),
        ({"type": 0, "points": [at()]}, "only 1 points"),
        ({"type": 11, "points": [at()] * 2}, "only 2 points"),
        ({"type": 9}, "no text"),
    ],
)
def test_what_cannot_be_drawn_is_said(changed: dict[str, Any], why: str) -> None:
    of = MarkersOfTopic("/markers")
    of.take(marker(ns=HUGE, id=-1, **changed), 0)
    (told,) = of.problems()
    assert of.shown(0) == [] and why in told and len(told) < 1000
    of.take(marker(ns=HUGE, id=-1), 0)
    assert len(of.shown(0)) == 1 and of.problems() == []


def test_hostile_points_colours_and_numbers_are_bounded() -> None:
    of = MarkersOfTopic("/markers")
    wild = [at(), at(math.nan), at(math.inf), at(1e9), *(at(float(number)) for number in range(50_000))]
    of.take(marker(type=8, points=wild, colors=[SimpleNamespace(r=5.0, g=math.nan, b=-1.0, a=1.0)] * len(wild)), 0)
    of.take(marker(id=1, type=11, points=wild, colors=wild[:3]), 0)  # colours of another number
    of.take(marker(id=2, type=9, text=HUGE), 0)
    points, triangles, text = (one.body for one in of.shown(0))
    assert len(base64.b64decode(points["points"])) == 12 * (20_000 - 3)
    assert base64.b64decode(points["colours"])[:3] == b"\xff\x00\x00"
    assert len(base64.b64decode(triangles["points"])) % 36 == 0 and "colours" not in triangles
    assert len(text["text"]) == 200
    of.take(SimpleNamespace(markers=[marker(id=number) for number in range(3, 3 + 2 * MOST_MARKERS)]), 0)
    assert len(of.shown(0)) == MOST_MARKERS and any("only 1000" in line for line in of.problems())
