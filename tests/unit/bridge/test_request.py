"""Arguments of requests are checked before they are used, and a wrong one is named with what was expected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ros2_mcp_bridge.request import Cancelled, OperationError, Request


def request_of(body: bytes = b"", **arguments: Any) -> Request:
    return Request({"id": 7, "op": "publish", **arguments}, body)


READ: dict[str, Callable[[Request], object]] = {
    "text": lambda request: request.text("x"),
    "texts": lambda request: request.texts("x"),
    "number": lambda request: request.number("x"),
    "rate": lambda request: request.rate(),
    "sizes": lambda request: request.sizes("x"),
    "choice": lambda request: request.choice("x", ("a", "b")),
    "qos": lambda request: request.qos(),
}


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("text", None),
        ("text", ""),
        ("text", 3),
        ("texts", "abc"),
        ("texts", ["a", 1]),
        ("number", -1),
        ("number", True),
        ("number", "1"),
        ("rate", 0),
        ("rate", 1000.1),
        ("rate", 0.009),
        ("sizes", [1, 1]),
        ("sizes", [1.5, 1.5]),
        ("choice", "c"),
        ("qos", []),
    ],
)
def test_a_wrong_argument_is_a_bad_request_that_names_it(kind: str, value: object) -> None:
    name = {"rate": "rate_hz", "qos": "qos"}.get(kind, "x")
    with pytest.raises(OperationError, match=f"publish: {name} is .*expected") as refused:
        READ[kind](request_of(b"abc", **{name: value}))
    assert refused.value.kind == "bad_request"


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("text", "a"),
        ("texts", []),
        ("number", 0),
        ("rate", 1000),
        ("rate", 0.01),
        ("sizes", [1, 2]),
        ("choice", "b"),
        ("qos", {}),
    ],
)
def test_a_right_argument_comes_as_it_is(kind: str, value: object) -> None:
    name = {"rate": "rate_hz", "qos": "qos"}.get(kind, "x")
    assert READ[kind](request_of(b"abc", **{name: value})) == value


def test_a_number_that_is_absent_or_null_is_its_default() -> None:
    assert request_of().number("x", 2.5) == 2.5
    assert request_of(x=None).number("x", 2.5) == 2.5
    assert request_of(x=0).number("x", 2.5) == 0


def test_a_request_is_cancelled_once() -> None:
    class Work:
        def __init__(self) -> None:
            self.thrown: list[Exception] = []

        def wake(self) -> None: ...

        def throw(self, error: Exception) -> None:
            self.thrown.append(error)

    request, work = request_of(), Work()
    assert not request.end("cancel")
    request.task = work
    assert request.end("cancel")
    assert not request.end("cancel")
    assert [type(error) for error in work.thrown] == [Cancelled]
