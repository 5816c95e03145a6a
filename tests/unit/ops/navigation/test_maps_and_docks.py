"""Files of maps that can or cannot be looked at, codes of docking, and goals that a docking server has others run."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp.model.nav2 import DOCK, NAVIGATE, SAVE_MAP, SAVE_POSE_GRAPH, in_words, server_of
from ros2_mcp.ops.actions.running import RunningGoal, from_above
from ros2_mcp.ops.navigation.nav_map import written

HERE: Any = SimpleNamespace(graph=SimpleNamespace(is_remote=False))
ELSEWHERE: Any = SimpleNamespace(graph=SimpleNamespace(is_remote=True))


def test_files_that_were_written_now_are_verified_and_all_others_are_not(tmp_path: Path) -> None:
    path = str(tmp_path / "floor")
    assert "there is no" in written(HERE, path, SAVE_MAP, 0.0)
    for ending in (".yaml", ".pgm"):
        (tmp_path / f"floor{ending}").write_text("x")
    now = (tmp_path / "floor.pgm").stat().st_mtime
    assert written(HERE, path, SAVE_MAP, now).startswith("Verified: ")
    assert written(HERE, f"file://{path}.yaml", SAVE_MAP, now).startswith("Verified: ")
    assert "older than the call" in written(HERE, path, SAVE_MAP, now + 60)
    assert "there is no" in written(HERE, path, SAVE_POSE_GRAPH, now)
    assert "robot's computer" in written(ELSEWHERE, path, SAVE_MAP, now)
    assert "relative" in written(HERE, os.path.relpath(path), SAVE_MAP, now)


@pytest.mark.parametrize(
    ("code", "name"),
    [(901, "DOCK_NOT_IN_DB"), (903, "FAILED_TO_STAGE"), (906, "FAILED_TO_CHARGE"), (999, "UNKNOWN")],
)
def test_codes_of_docking_are_told_in_words(code: int, name: str) -> None:
    assert in_words(code).startswith(f"{name} ({code}): ")
    assert server_of(code) == "docking_server"


def test_the_drive_to_a_dock_belongs_to_the_docking() -> None:
    follow = "nav2_msgs/action/FollowPath"
    goals = [
        RunningGoal("/dock_robot", DOCK, "a" * 32, "EXECUTING", from_this_server=True),
        RunningGoal("/follow_path", follow, "c" * 32, "EXECUTING"),
        RunningGoal("/navigate_to_pose", NAVIGATE, "b" * 32, "EXECUTING"),
    ]
    (above,) = from_above(goals)
    assert above.action_name == "/dock_robot"
    assert above.delegated_to == ["/follow_path", "/navigate_to_pose"]
    assert [goal.action_name for goal in from_above(goals[1:])] == ["/navigate_to_pose"]
