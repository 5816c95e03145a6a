"""`python -m ros2_mcp_interfaces DIR... [--cache DIR] [--json]`: builds packages, prints their prefixes."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ros2_mcp_interfaces import BuildError, build, default_cache


def main(arguments: Sequence[str] | None = None) -> int:
    """Prefixes go to stdout, progress and errors to stderr; returns 0, or 1 when nothing usable was built."""
    options = _parser().parse_args(arguments)
    try:
        prefixes = build(options.directories, options.cache, _report)
    except BuildError as error:
        return _refuse(error, options.json)
    if options.json:
        _print(json.dumps({"prefixes": [str(prefix) for prefix in prefixes]}))
    else:
        _print("\n".join(map(str, prefixes)))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2_mcp_interfaces", description="Build ROS 2 interface packages without colcon."
    )
    parser.add_argument(
        "directories",
        metavar="DIR",
        nargs="+",
        type=Path,
        help="an interface package, or a folder with several; order does not matter",
    )
    parser.add_argument(
        "--cache", type=Path, default=default_cache(), help="where results are kept (default: %(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, errors included")
    return parser


def _refuse(error: BuildError, as_json: bool) -> int:
    if as_json:
        _print(json.dumps({"error": error.message, "hint": error.hint}))
    _report(f"error: {error.message}")
    if error.hint:
        _report(error.hint)
    return 1


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")


def _report(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
