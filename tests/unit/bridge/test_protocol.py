"""The description of the stream and the types that both of its ends share say the same."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from ros2_mcp_bridge.protocol import OPERATIONS, ErrorKind, Hello

ROOT = Path(__file__).resolve().parents[3]
DESCRIPTION = (ROOT / "docs/reference/stream.md").read_text(encoding="utf-8")
ROWS = {
    match[1]: (match[2], match[3])
    for match in re.finditer(r"^\| `(\w+)` \| (.*?) ?\| (.*) \|$", DESCRIPTION, re.MULTILINE)
}


def test_every_operation_is_described_and_every_described_one_is_there() -> None:
    assert set(ROWS) == set(OPERATIONS)


def test_every_operation_is_in_the_bridges_table() -> None:
    """As text: the table itself needs rclpy."""
    sources = [ROOT / f"src/ros2_mcp_bridge/{name}.py" for name in ("__main__", "operations")]
    rows = {row for path in sources for row in re.findall(r'^ +"(\w+)": [\w.]+,$', path.read_text(), re.MULTILINE)}
    assert rows == set(OPERATIONS)


@pytest.mark.parametrize("op", OPERATIONS)
def test_every_argument_and_every_part_of_a_reply_is_described(op: str) -> None:
    arguments, reply = OPERATIONS[op]
    described = " ".join(ROWS[op])
    for other in re.findall(r"\bas `(\w+)`", described):  # "as `publish`, and …"
        described += " ".join(ROWS[other])
    names = {*arguments.__annotations__, *reply.__annotations__}
    assert {name for name in names if not re.search(rf"[`\"]{name}[`\"]", described)} == set()


def test_the_kinds_of_errors_and_the_hello_are_described() -> None:
    assert {kind for kind in get_args(ErrorKind) if f"`{kind}`" not in DESCRIPTION} == set()
    assert {name for name in Hello._fields if f'"{name}"' not in DESCRIPTION} == set()
