"""The table of rooms in CONTRIBUTING.md, which `./check` reads: complete, and true."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

from support.source import ROOT


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check", ROOT / ".ci/check.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


check = _load()
ROOMS = check.rooms()


def relative(paths: list[Path]) -> set[str]:
    return {str(path.relative_to(ROOT)) for path in paths}


def named(column: str) -> list[str]:
    return [path for room in ROOMS.values() for path in getattr(room, column)]


def covered(*columns: str) -> set[str]:
    return relative([path for column in columns for pattern in named(column) for path in check.files(pattern)])


def test_every_path_of_the_table_is_there() -> None:
    paths = named("sources") + named("unit_tests") + named("ros_tests")
    assert len(paths) > 100
    assert [path for path in paths if not list(check.files(path))] == []


def test_every_module_has_a_room_and_no_path_has_two() -> None:
    modules = relative([*(ROOT / "src").rglob("*.py")])
    assert modules - covered("sources") == set(), "add it to the table of rooms in CONTRIBUTING.md"
    assert [path for path, times in Counter(named("sources")).items() if times > 1] == []


def test_every_file_of_tests_has_a_room() -> None:
    tests = relative([*(ROOT / "tests").rglob("test_*.py")])
    assert tests - covered("unit_tests", "ros_tests") == set(), "add it to the table of rooms in CONTRIBUTING.md"


def test_every_room_has_tests() -> None:
    assert [room.name for room in ROOMS.values() if not room.unit_tests + room.ros_tests] == []


@pytest.mark.parametrize(
    "wanted",
    ["motion", "ops/motion", "src/ros2_mcp/ops/motion/", "tools/motion.py", "src/ros2_mcp/ops/motion/until.py"],
)
def test_a_room_is_found_by_its_name_and_by_its_sources(wanted: str) -> None:
    assert check.room_of(wanted, ROOMS).name == "motion"


def test_a_room_that_there_is_not_is_answered_with_the_nearest() -> None:
    asked = subprocess.run(
        [sys.executable, str(ROOT / ".ci/check.py"), "mottion"], capture_output=True, text=True, check=False
    )
    assert asked.returncode == 2
    assert "Did you mean motion" in asked.stderr
    assert "navigation" in asked.stderr
