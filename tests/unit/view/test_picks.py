"""What was picked is kept for the agent's servers, and only what is ours is taken from there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.view.picks import FILE, keep, kept, picks_of

WHEN = {"at_s": 1_700_000_000, "now_s": 1_700_000_001}
GIVEN: list[dict[str, Any]] = [
    {"x": 1.5, "y": -0.25, "frame": "map", "at_s": 3, "grid": "/map", "cell": 100},
    {"kind": "point", "topic": "/a", "frame": "b", "xyz": [1, 2, 3], "in_frame": "map", "in": [4, 5, 6], **WHEN},
    {"kind": "box", "topic": "/a", "frame": "", "box": [1, 2, 3, 4], "size": [5, 6], **WHEN},
    {"kind": "time", "topic": "/a", "values": [{"name": "x", "value": -1e30, "unit": "m"}], **WHEN},
]


def test_all_kinds_are_kept_as_they_are(tmp_path: Path) -> None:
    folder, picks = StateFolder(tmp_path), picks_of(GIVEN)
    keep(folder, "the robot now", picks)
    found = kept(folder)
    assert found and [one.summary() for one in found.picks] == [one.summary() for one in picks]


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "goal"},
        {"box_px": [1]},
        {"box_px": None},
        {"frame": 5},
        {"view_xyz_m": [1]},
        {"values": {}},
        {"x_m": "1"},
    ],
)
def test_what_is_none_of_ours_is_not_taken(tmp_path: Path, change: dict[str, Any]) -> None:
    folder = StateFolder(tmp_path)
    keep(folder, "the robot now", picks_of(GIVEN[2:3]))
    found = json.loads((tmp_path / FILE).read_text())
    found["picks"][0].update(change)
    (tmp_path / FILE).write_text(json.dumps(found))
    assert kept(folder) is None
