"""The description of the stream, the table of operations and the types of their replies say the same."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from ros2_mcp_common.wire import protocol
from ros2_mcp_common.wire.protocol import ErrorKind, Hello

ROOT = Path(__file__).resolve().parents[3]
DESCRIPTION = (ROOT / "docs/reference/stream.md").read_text(encoding="utf-8")
ROWS = {
    match[1]: (match[2], match[3])
    for match in re.finditer(r"^\| `(\w+)` \| (.*?) ?\| (.*) \|$", DESCRIPTION, re.MULTILINE)
}
SOURCE = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "src/ros2_mcp_bridge").rglob("*.py")}
# As text: the table itself needs rclpy.
OPERATIONS = dict(
    row for name in ("__main__", "operations") for row in re.findall(r'^ +"(\w+)": [\w.]*?(\w+),$', SOURCE[name], re.M)
)
"""The operations and the names of the functions that carry them out."""


def functions_of_requests() -> Iterator[tuple[str, str]]:
    """The functions that take nothing but a request, and what they return."""
    nodes = [node for text in SOURCE.values() for node in ast.walk(ast.parse(text))]
    for function in (node for node in nodes if isinstance(node, ast.FunctionDef)):
        arguments = [arg.arg.lstrip("_") for arg in function.args.args if arg.arg != "self"]
        if arguments == ["request"] and function.returns:
            yield function.name, ast.unparse(function.returns)


RETURNED = dict(functions_of_requests())


def test_every_operation_is_described_and_every_described_one_is_there() -> None:
    assert set(ROWS) == set(OPERATIONS)
    assert set(OPERATIONS.values()) <= set(RETURNED)


@pytest.mark.parametrize("op", OPERATIONS)
def test_every_part_of_a_reply_is_described(op: str) -> None:
    described = " ".join(ROWS[op])
    for other in re.findall(r"\bas `(\w+)`", described):  # "as `publish`, and …"
        described += " ".join(ROWS[other])
    reply = re.search(r"(\w+Reply|Counts|Cancelled|Empty)\b", RETURNED[OPERATIONS[op]])
    assert reply or op == "unsubscribe"  # the queue of samples sends that one
    names = getattr(protocol, reply[1] if reply else "Counts").__annotations__
    assert {name for name in names if not re.search(rf"[`\"]{name}[`\"]", described)} == set()


def test_the_arguments_that_are_described_are_those_that_are_read() -> None:
    read = {name for text in SOURCE.values() for name in re.findall(r'request\.[a-z]+\("(\w+)"', text)}
    own = {"rate_hz", "qos"}  # have methods of their own
    described = {name for row, _ in ROWS.values() for name in re.findall(r"`(\w+)`", row)} - set(ROWS)
    values = {"all", "latest"}
    assert read | own == (described | {"topic", "type", "topics"}) - values


def test_the_kinds_of_errors_and_the_hello_are_described() -> None:
    assert {kind for kind in get_args(ErrorKind) if f"`{kind}`" not in DESCRIPTION} == set()
    assert {name for name in Hello._fields if f'"{name}"' not in DESCRIPTION} == set()
