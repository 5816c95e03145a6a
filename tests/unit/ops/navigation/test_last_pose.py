"""The last pose of a robot, kept in its folder of state, and what is told where it is in doubt."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadData, NotFound
from ros2_mcp.ops.navigation.last_pose import KeptPose, LastPose, MapMark
from ros2_mcp.ops.navigation.scan_fit import ScanFit
from support.made_rooms import made_grid

CELLS = np.zeros((40, 60), np.int8)
MARK = MapMark.of("/map", made_grid(CELLS, 0.05, -1.0, -1.0))
POSE = KeptPose(1.0, -2.0, 0.5, 1000.0, 0.9, MARK)


def test_a_pose_is_known_to_the_next_server_with_its_time_and_its_map(tmp_path: Path) -> None:
    folder = StateFolder(tmp_path / "robot")
    with pytest.raises(NotFound, match="No last pose is kept"):
        LastPose(folder).read()
    LastPose(folder).write(POSE)
    assert LastPose(folder).read() == POSE
    assert [path.name for path in folder.path.iterdir()] == ["last_pose.json"]
    assert replace(POSE, at=time.time() - 60).age_s == pytest.approx(60, abs=5)


def test_without_a_folder_it_is_kept_in_memory() -> None:
    last = LastPose()
    last.write(POSE)
    assert last.read() == POSE


@pytest.mark.parametrize("text", ["{", "[]", "{}", json.dumps({"x_m": "here"})])
def test_a_damaged_file_is_told(tmp_path: Path, text: str) -> None:
    folder = StateFolder(tmp_path / "robot")
    LastPose(folder).write(POSE)
    (folder.path / "last_pose.json").write_text(text)
    with pytest.raises(BadData, match="damaged"):
        LastPose(folder).read()


def test_numbers_that_are_not_finite_are_damage(tmp_path: Path) -> None:
    folder = StateFolder(tmp_path / "robot")
    LastPose(folder).write(replace(POSE, x_m=float("nan")))
    with pytest.raises(BadData, match="damaged"):
        LastPose(folder).read()


def test_another_map_and_a_changed_one_are_told_apart() -> None:
    changed = CELLS.copy()
    changed[3, 3] = 100
    assert MARK.difference(MARK) == ""
    assert MARK.difference(MapMark.of("/map", made_grid(changed, 0.05, -1.0, -1.0))) == "the map has changed since"
    other = MARK.difference(MapMark.of("/map", made_grid(np.zeros((80, 80), np.int8), 0.1, 0.0, 0.0)))
    assert "60 × 40 cells of 0.05 m" in other and "80 × 80 cells of 0.1 m" in other
    moved = MARK.difference(MapMark.of("/map", made_grid(CELLS, 0.05, 5.0, -1.0)))
    assert "(-1, -1)" in moved and "(5, -1)" in moved


def test_beams_that_leave_the_map_count_against_a_pose_in_doubt() -> None:
    fit = ScanFit(0.6, 100, 300, "/scan", "/map")
    assert fit.of_all == pytest.approx(0.2)
    assert "200 leave it" in str(fit)
    assert "leave" not in str(ScanFit(0.6, 300, 300, "/scan", "/map"))
