"""`write` carries version and owner into all manifests; `check` builds, installs and validates what is published."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from release.checks import CHECKS, run
from release.facts import NOBODY, ROOT, read_facts
from release.manifests import write


def main() -> int:
    """Runs the step that was asked for; returns the exit code."""
    top = argparse.ArgumentParser(prog="python -m release", description=__doc__)
    steps = top.add_subparsers(dest="step", metavar="STEP", required=True)
    steps.add_parser("write", help="write the manifests that are out of date")
    check = steps.add_parser("check", help="build, install and validate all that is published")
    check.add_argument("--only", nargs="+", metavar="NAME", choices=list(CHECKS), help=", ".join(CHECKS))
    check.add_argument("--output", type=Path, metavar="DIR", help="keep what is built (wheel, sdist, .mcpb) there")
    arguments = top.parse_args()
    facts = read_facts()
    if arguments.step == "write":
        changed = write(facts, ROOT)
        print("\n".join(f"written: {path}" for path in changed) or "All manifests are as they must be.")
        return 0
    print(f"{facts.name} {facts.version} of {facts.owner}")
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        code = run(facts, Path(folder), arguments.output, arguments.only or list(CHECKS))
    if facts.owner == NOBODY:
        print(f"Nobody publishes this yet: set owner and author in [tool.release] of pyproject.toml (now {NOBODY}).")
    return code


if __name__ == "__main__":
    sys.exit(main())
