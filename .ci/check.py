"""`./check ROOM [OPTION OF PYTEST...]`: the tests of one room, ruff, and pyright of what changed since main.

The rooms are those of the table in CONTRIBUTING.md. Without a room, it lists them.
"""

from __future__ import annotations

import difflib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
BASES = ("src/ros2_mcp", "tests/unit", "tests/ros")
"""Where the paths of each column are, unless they are there from the root."""
TESTS_BOUND_S = 600
"""The slowest room, `stop`, takes some minutes on a busy machine."""
LINTER_BOUND_S = 120
"""pyright takes 10 s for a few files."""
ENVIRONMENT = ("--extra", "jazzy", "--group", "test", "--group", "lint")


class Room(NamedTuple):
    """One row: paths from the root, which may be patterns such as `tests/ros/test_bridge*.py`."""

    name: str
    sources: list[str]
    unit_tests: list[str]
    ros_tests: list[str]


def rooms() -> dict[str, Room]:
    """The table of CONTRIBUTING.md, by name."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.partition("| room | sources | unit tests | ROS tests |\n")[2].partition("\n\n")[0]
    found: dict[str, Room] = {}
    for row in table.splitlines()[1:]:
        name, *cells = (cell.strip() for cell in row.strip("|").split("|"))
        columns = [
            [_from_root(path, base) for path in re.findall("`([^`]+)`", cell)]
            for cell, base in zip(cells, BASES)  # noqa: B905  (Python 3.9 has no `strict`)
        ]
        found[name] = Room(name, *columns)
    return found


def _from_root(path: str, base: str) -> str:
    return f"{base}/{path}" if any((ROOT / base).glob(path)) else path


def files(pattern: str) -> Iterator[Path]:
    """What a path of the table names: files, and all Python files of folders."""
    for path in ROOT.glob(pattern):
        if path.is_dir():
            yield from path.rglob("*.py")
        else:
            yield path


def room_of(wanted: str, known: dict[str, Room]) -> Room | None:
    """By its name, or by one of its sources: `motion`, `ops/motion`, `src/ros2_mcp/ops/motion/until.py`."""
    if wanted in known:
        return known[wanted]
    path = wanted.rstrip("/")
    owners = {source: room for room in known.values() for source in room.sources}
    while path and path != ".":
        for source in (path, f"{BASES[0]}/{path}"):
            if source in owners:
                return owners[source]
        path = str(Path(path).parent)
    return None


def changed_files() -> list[str]:
    """What is not as it is on main: committed here, changed, or new. Without a main, what is not committed."""
    main = next((name for name in ("origin/main", "main") if _git("rev-parse", "--verify", "-q", name)), "HEAD")
    base = (_git("merge-base", "HEAD", main) or ["HEAD"])[0]
    changed = _git("diff", "--name-only", base) + _git("ls-files", "--others", "--exclude-standard")
    return sorted(path for path in changed if (ROOT / path).is_file())


def _git(*arguments: str) -> list[str]:
    asked = ["git", *arguments]
    return subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False).stdout.splitlines()


def _program(name: str) -> list[str]:
    """A program of the environment, as it is; where there is none yet, uv makes it."""
    if all((ROOT / ".venv/bin" / each).exists() for each in ("pytest", "ruff", "pyright")):
        return [str(ROOT / ".venv/bin" / name)]
    uv = shutil.which("uv") or shutil.which("uv", path=str(ROOT / ".venv-uv/bin"))
    if not uv:
        sys.exit("Needs uv: python3 -m venv .venv-uv && .venv-uv/bin/pip install uv")
    return [uv, "run", *ENVIRONMENT, name]


def _step(name: str, bound_s: int, *command: str) -> subprocess.Popen[bytes]:
    """Begins a step that ends by its bound, whatever it does."""
    runner = [sys.executable, str(ROOT / ".ci/step.py"), name, str(bound_s)]
    environment = {
        **os.environ,
        # pyright reads the packages of the first Python on the path
        "PATH": os.pathsep.join([f"{ROOT}/.venv/bin", os.environ.get("PATH", os.defpath)]),
        "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1",
    }
    return subprocess.Popen([*runner, *command], cwd=ROOT, env=environment)


def check(room: Room, options: list[str]) -> int:
    """1 if anything fails, after everything has been run."""
    began = time.monotonic()
    failed: list[str] = []

    def wait(name: str, step: subprocess.Popen[bytes]) -> None:
        if step.wait():
            failed.append(name)

    wait("ruff check", _step("ruff check", LINTER_BOUND_S, *_program("ruff"), "check"))
    wait("ruff format", _step("ruff format", LINTER_BOUND_S, *_program("ruff"), "format", "--check"))
    typed = [path for path in changed_files() if path.endswith(".py") and path.startswith(("src/", "release/"))]
    pyright = None
    if typed:
        pyright = _step("pyright", LINTER_BOUND_S, *_program("pyright"), *typed)
    tests = [str(path) for pattern in (*room.unit_tests, *room.ros_tests) for path in sorted(ROOT.glob(pattern))]
    wait("tests", _step("tests", TESTS_BOUND_S, *_program("pytest"), "-q", *options, *tests))
    if pyright:
        wait("pyright", pyright)
    took = f"after {time.monotonic() - began:.0f} s"
    print(f"{room.name}: {'failed: ' + ', '.join(failed) if failed else 'all is well'}, {took}")
    return 1 if failed else 0


def main() -> int:
    """The exit status: 2 for a room that there is not."""
    known = rooms()
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        print(f"Usage: ./check ROOM [OPTION OF PYTEST...]\nRooms: {', '.join(sorted(known))}")
        return 2 if len(sys.argv) > 1 and sys.argv[1] not in ("-h", "--help") else 0
    room = room_of(sys.argv[1], known)
    if room:
        return check(room, sys.argv[2:])
    near = difflib.get_close_matches(sys.argv[1], known, n=3, cutoff=0.5)
    hint = f" Did you mean {' or '.join(near)}?" if near else ""
    print(f"There is no room {sys.argv[1]!r}.{hint}\nRooms: {', '.join(sorted(known))}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
