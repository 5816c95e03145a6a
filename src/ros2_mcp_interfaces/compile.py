"""Compiles and links generated sources with the machine's C and C++ compilers."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ros2_mcp_interfaces.errors import BuildError

# Parallel compilers: nearly all of the time is spent there, 8 s for a small package. The bounds were not measured.
JOBS = max(2, min(4, os.cpu_count() or 2))
_MOST_LINES_SHOWN = 12
"""The most lines of a compiler's messages in an error: the first lines show the cause; consequences of it fill pages.
"""


@dataclass(frozen=True)
class Compiler:
    """The commands of the machine's compilers, with their leading arguments."""

    c: list[str]
    cpp: list[str]

    def compile(self, source: Path, includes: Sequence[Path]) -> Path:
        """Compile a source file, and return its object file, which an interrupted build may have left. Raises
        `BuildError`.
        """
        target = source.with_suffix(source.suffix + ".o")
        if target.is_file():
            return target
        # A compiler may outlive a builder that was killed: each builder has files of its own until they are whole.
        begun = source.with_suffix(f"{source.suffix}.{os.getpid()}")
        # -isystem and -w keep warnings about generated code out of the error texts.
        command = [*(self.cpp if source.suffix == ".cpp" else self.c), "-O1", "-fPIC", "-w"]
        command += [argument for path in includes for argument in ("-isystem", str(path))]
        _run([*command, "-c", str(source), "-o", str(begun)], f"compiling {source.name}")
        begun.replace(target)
        return target

    def link(self, target: Path, inputs: Sequence[Path], search: Sequence[str], keep_all: bool = False) -> None:
        """Link a shared library whose run-time search path is `search`.

        Unused libraries are dropped unless `keep_all` is set. Raises `BuildError`.
        """
        command = [*self.cpp, "-shared", "-s", "-o", str(target), f"-Wl,-soname,{target.name}"]
        command += ["-Wl,--no-as-needed" if keep_all else "-Wl,--as-needed"]
        command += [f"-Wl,-rpath,{path}" for path in search]
        _run([*command, *map(str, inputs)], f"linking {target.name}")


def find_compiler() -> Compiler:
    """Return the compilers in CC and CXX, or else the compilers on the PATH. Raises `BuildError` if there is no
    compiler.
    """
    return Compiler(
        _command("C", "CC", ("gcc", "cc", "clang")),
        _command("C++", "CXX", ("g++", "c++", "clang++")),
    )


def _command(language: str, variable: str, names: Sequence[str]) -> list[str]:
    chosen = shlex.split(os.environ.get(variable, ""))
    for command in [chosen] if chosen else [[name] for name in names]:
        if shutil.which(command[0]):
            return command
    tried = f"{variable}={chosen[0]}" if chosen else ", ".join(names)
    raise BuildError(f"no {language} compiler found ({tried})", "sudo apt install build-essential")


def _run(command: list[str], what: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode != 0:
        lines = done.stderr.splitlines()
        first = next((line for line in lines if "error" in line), f"exit status {done.returncode}")
        raise BuildError(f"{what} failed: {first}", "\n".join(lines[:_MOST_LINES_SHOWN]))
