"""`python -m ros2_mcp_interfaces DIR... [--cache DIR] [--json]`: build packages and print their prefixes."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ros2_mcp_interfaces import BuildError, build, default_cache
from ros2_mcp_interfaces.package import left_out


def main(arguments: Sequence[str] | None = None) -> int:
    """Build packages; write prefixes to stdout, progress and errors to stderr. Return 0, 1 if a package could not be
    built, or 2 if a definition was skipped.
    """
    parser = argparse.ArgumentParser(
        prog="ros2_mcp_interfaces", description="Build ROS 2 interface packages without colcon."
    )
    folders = "an interface package, or a folder with several; order does not matter"
    parser.add_argument("directories", metavar="DIR", nargs="+", type=Path, help=folders)
    kept = "where results are kept (default: %(default)s)"
    parser.add_argument("--cache", type=Path, default=default_cache(), help=kept)
    parser.add_argument("--json", action="store_true", help="print one JSON object, errors included")
    options = parser.parse_args(arguments)
    try:
        prefixes = [str(prefix) for prefix in build(options.directories, options.cache, _report)]
    except BuildError as error:
        if options.json:
            sys.stdout.write(json.dumps({"error": error.message, "hint": error.hint}) + "\n")
        _report(f"error: {error.message}")
        if error.hint:
            _report(error.hint)
        return 1
    others = left_out(options.directories)
    for file, why in others:
        _report(f"left out: {file}: {why}")
    answer = {"prefixes": prefixes, "left_out": [str(one.file) for one in others]}
    sys.stdout.write((json.dumps(answer) if options.json else "\n".join(prefixes)) + "\n")
    return 2 if others else 0


def _report(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()  # progress is read while the build goes on


if __name__ == "__main__":
    sys.exit(main())
