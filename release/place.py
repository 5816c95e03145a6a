"""Where a release is checked: a folder of its own, what was built, and how tools are run there."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from release.facts import ROOT, Facts

# Most of it is downloading and, for the demo, compiling; a check that hangs must not hang the release. Chosen.
COMMAND_S = 900.0
SHOWN_LINES = 25


class CheckFailed(Exception):
    """What is wrong, in words."""


class CannotCheck(Exception):
    """What this machine lacks for a check."""


@dataclass(slots=True, kw_only=True)
class Place:
    """`folder` is empty at the beginning and away afterwards; `wheel` and `sdist` are there once they are built."""

    facts: Facts
    folder: Path
    wheel: Path | None = None
    sdist: Path | None = None
    built: list[Path] = field(default_factory=list[Path])

    def run(
        self,
        *argv: str | Path,
        cwd: Path | None = None,
        env: Mapping[str, str] | None = None,
        codes: Sequence[int] = (0,),
    ) -> str:
        """What the command writes on stdout and stderr.

        Raises:
            CannotCheck: if the command is not there.
            CheckFailed: if it ends with another code than those that are good, or lasts too long.
        """
        words = [str(word) for word in argv]
        try:
            ended = subprocess.run(
                words,
                cwd=cwd or self.folder,
                env=env if env is not None else clean(os.environ),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                timeout=COMMAND_S,
                check=False,
            )
        except FileNotFoundError:
            raise CannotCheck(f"needs {words[0]}") from None
        except subprocess.TimeoutExpired:
            raise CheckFailed(f"{' '.join(words)} did not end within {COMMAND_S:.0f} s") from None
        if ended.returncode not in codes:
            last = "\n".join(ended.stdout.splitlines()[-SHOWN_LINES:])
            raise CheckFailed(f"{' '.join(words)} ended with {ended.returncode}:\n{last}")
        return ended.stdout

    def uv(self, *words: str | Path, cwd: Path | None = None, codes: Sequence[int] = (0,)) -> str:
        """Runs uv, which is what runs this, or is found on PATH."""
        return self.run(uv(), *words, cwd=cwd, codes=codes)

    def tool(self, requirement: str, *words: str | Path, codes: Sequence[int] = (0,)) -> str:
        """Runs a command of a package that is in no environment of ours; its name is the first of the words."""
        return self.uv("tool", "run", "--from", requirement, *words, codes=codes)

    def checkout(self) -> Path:
        """A copy of what git knows of this checkout, as others get it."""
        copy = self.folder / "checkout"
        if not copy.exists():
            listed = self.run("git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", cwd=ROOT)
            for name in filter(None, listed.split("\0")):
                source, target = ROOT / name, copy / name
                if source.is_symlink() or source.is_file():
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(source, target, follow_symlinks=False)
        return copy

    def keep(self, folder: Path) -> None:
        """Copies what was built there."""
        folder.mkdir(parents=True, exist_ok=True)
        for path in self.built:
            shutil.copy2(path, folder)


def uv() -> str:
    """The path of uv.

    Raises:
        CannotCheck: if it is not there.
    """
    found = os.environ.get("UV") or shutil.which("uv")
    if not found:
        raise CannotCheck("needs uv, on PATH or run by it: uv run python -m release check")
    return found


def clean(env: Mapping[str, str]) -> dict[str, str]:
    """The environment without what points to the one that runs this."""
    ours = ("VIRTUAL_ENV", "PYTHONPATH", "AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "ROS2_MCP_INTERFACES")
    return {name: value for name, value in env.items() if name not in ours}
