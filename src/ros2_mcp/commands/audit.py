"""`ros2-mcp audit show | verify`: show the audit, or verify that it was not changed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from ros2_mcp.guard.chain import newest, verify
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.text import visible

_WHAT = (
    *(
        "verb",
        "name",
        "rate_hz",
        "duration_s",
        "of",
        "outcome",
        "reason",
        "by",
        "what",
        "goal_id",
        "mode",
        "before",
        "now",
    ),
    *("approval", "rule", "tool"),
)


def audit(folder: Path, step: str, *, limit: int = 50, as_json: bool = False, head: str = "") -> int:
    """Print the last lines, or the verdict.

    Args:
        folder: the folder of the audit.
        step: `show` or `verify`.
        limit: how many lines to show, the newest ones.
        as_json: print the lines as they are stored.
        head: for `verify`, a head that was copied earlier.

    Returns:
        0; for `verify`, 1 if the audit was changed.

    Raises:
        NotFound: if there is no audit.
    """
    if not folder.is_dir():
        raise NotFound(
            f"There is no audit in {folder}.",
            "It is created by the first command. For a robot that its policy names: ros2-mcp --policy FILE audit …, or "
            "--state DIR.",
        )
    if step == "show":
        if not as_json:
            print(f"The audit of {folder.parent.name}, in {folder}")  # noqa: T201
        for entry in [*islice(newest(folder), limit)][::-1]:
            print(json.dumps(entry) if as_json else visible(line_of(entry)))  # noqa: T201
        return 0
    verdict = verify(folder, head)
    for fault in verdict.faults:
        print(f"CHANGED: {visible(fault)}")  # noqa: T201
    for note in verdict.notes:
        print(visible(note))  # noqa: T201
    said = "has been changed" if verdict.faults else "is whole"
    counts = f"{verdict.lines} lines in {verdict.files} files, head {verdict.head.short}"
    print(f"The audit of {folder.parent.name} {said}: {counts}.")  # noqa: T201
    return 1 if verdict.faults else 0


def line_of(entry: Mapping[str, Any]) -> str:
    """Return one line for people: number, time, kind, principal, and the other fields."""
    told = " ".join(f"{name}={entry[name]}" for name in _WHAT if entry.get(name))
    who = entry.get("principal", "")
    value = f" value={json.dumps(entry['value'])[:200]}" if entry.get("value") else ""
    return f"{entry.get('seq')} {entry.get('time')} {entry.get('kind')} {who} {told}{value}".replace("  ", " ")
