"""What a test of CI says does not depend on how fast the machine is: figures stand in full alone."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from support.processes import TESTS

QUIET = {"undisturbed", "undisturbed_where_judged", "undisturbed_async", "standstills"}
"""What measures on a machine that is quiet: of `support/standstill.py`."""
OF_STANDSTILL = {"standstill.py", "turns.py"}
CLOCKS = {"monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns", "time", "time_ns"}
LOOKS_AT_A_CLOCK = re.compile(rf"\b({'|'.join(QUIET | CLOCKS)})\b|mark\.alone")
ALONE = -1
Function = ast.FunctionDef | ast.AsyncFunctionDef
Node = Function | ast.ClassDef


def is_full(node: ast.AST) -> bool:
    """Whether it is run in full alone: marked so, or what stands under `if FULL`."""
    if isinstance(node, Node):
        return any(ast.unparse(one) == "pytest.mark.full" for one in node.decorator_list)
    return isinstance(node, ast.If | ast.IfExp) and isinstance(node.test, ast.Name) and node.test.id == "FULL"


def in_ci(node: ast.AST) -> Iterator[ast.AST]:
    """Everything below a node but what is run in full alone."""
    for child in ast.iter_child_nodes(node):
        if not is_full(child):
            yield child
            yield from in_ci(child)
        elif isinstance(child, ast.If | ast.IfExp):
            for other in child.orelse if isinstance(child, ast.If) else [child.orelse]:
                yield other
                yield from in_ci(other)


def marks_all(tree: ast.Module) -> bool:
    """Whether `pytestmark` says that every test of the file is run in full alone."""
    return any(
        isinstance(line, ast.Assign)
        and ast.unparse(line.targets[0]) == "pytestmark"
        and "pytest.mark.full" in ast.unparse(line.value)
        for line in tree.body
    )


def names_of(node: ast.AST) -> set[str]:
    """What is named in it: by which the functions and fixtures of a file are found."""
    named = {one.id for one in in_ci(node) if isinstance(one, ast.Name)}
    attributes = {one.attr for one in in_ci(node) if isinstance(one, ast.Attribute)}
    return named | attributes | {one.arg for one in in_ci(node) if isinstance(one, ast.arg)}


def reached(tree: ast.Module, fixtures: dict[str, Node]) -> dict[str, Node]:
    """The functions and classes that a run of this file's tests reaches in CI, by name; `fixtures` are of conftest."""
    own = {line.name: line for line in tree.body if isinstance(line, Node)}
    known = {**fixtures, **own}
    begin = [name for name, node in own.items() if name.startswith("test_") and not is_full(node)]
    begin += [name for name, node in known.items() if "autouse" in " ".join(map(ast.unparse, node.decorator_list))]
    found: dict[str, Node] = {}
    while begin:
        name = begin.pop()
        if name not in found:
            found[name] = known[name]
            begin += [one for one in names_of(known[name]) if one in known]
    return found


class Elapsed:
    """What is a moment of a clock, and what a time between two of them, by the names of one function.

    `returning` are the functions of the file that return such a time, or have it in a tuple: then with its places.
    """

    def __init__(self, node: ast.AST, returning: dict[str, set[int]]) -> None:
        self.moments: set[str] = set()
        self.spans: set[str] = set()
        self.returning = returning
        assigned = [
            (target, one.value)
            for one in ast.walk(node)
            if isinstance(one, ast.Assign | ast.AnnAssign) and one.value is not None
            for target in (one.targets if isinstance(one, ast.Assign) else [one.target])
        ]
        before = -1
        while before != len(self.moments) + len(self.spans):
            before = len(self.moments) + len(self.spans)
            for target, value in assigned:
                self._name(target, value)

    def _name(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            for one, its in zip(target.elts, value.elts, strict=False):
                self._name(one, its)
        elif isinstance(target, ast.Tuple):
            places = {place for one in ast.walk(value) if isinstance(one, ast.Name) for place in self._places(one.id)}
            self.spans |= {
                one.id for place, one in enumerate(target.elts) if place in places and isinstance(one, ast.Name)
            }
        elif isinstance(target, ast.Name):
            if self.is_span(value):
                self.spans.add(target.id)
            elif self.is_moment(value):
                self.moments.add(target.id)

    def _places(self, name: str) -> set[int]:
        return self.returning.get(name, set())

    def is_moment(self, node: ast.expr) -> bool:
        """Whether it is what a clock says, or that and a constant."""
        if isinstance(node, ast.Call):
            return is_clock(node)
        if isinstance(node, ast.BinOp):
            return self.is_moment(node.left) and not self._is_difference(node)
        return isinstance(node, ast.Name) and node.id in self.moments

    def is_span(self, node: ast.expr) -> bool:
        """Whether a difference of clocks is anywhere in it."""
        return any(
            self._is_difference(one)
            or (isinstance(one, ast.Name) and (one.id in self.spans or ALONE in self._places(one.id)))
            for one in ast.walk(node)
        )

    def _is_difference(self, node: ast.AST) -> bool:
        if not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub)):
            return False
        return self._has_moment(node.right) or (self._has_moment(node.left) and not is_constant(node.right))

    def _has_moment(self, node: ast.expr) -> bool:
        return any(
            (isinstance(one, ast.Call) and is_clock(one)) or (isinstance(one, ast.Name) and one.id in self.moments)
            for one in ast.walk(node)
        )


def returning_spans(tree: ast.Module) -> dict[str, set[int]]:
    """The functions that return a time between two moments: where in a tuple, or ALONE."""
    found: dict[str, set[int]] = {}
    functions = [node for node in ast.walk(tree) if isinstance(node, Function)]
    for _ in range(2):  # of those that call one of those
        for node in functions:
            elapsed = Elapsed(node, found)
            for line in ast.walk(node):
                if not isinstance(line, ast.Return) or line.value is None or not elapsed.is_span(line.value):
                    continue
                told = line.value.elts if isinstance(line.value, ast.Tuple) else None
                places = {at for at, one in enumerate(told) if elapsed.is_span(one)} if told else {ALONE}
                found.setdefault(node.name, set()).update(places)
    return found


def is_clock(call: ast.Call) -> bool:
    if isinstance(call.func, ast.Attribute):
        return call.func.attr in CLOCKS and not call.args
    return isinstance(call.func, ast.Name) and call.func.id in CLOCKS and not call.args


def is_constant(node: ast.expr) -> bool:
    """Of numbers, and of names in capitals, alone."""
    return all(one.id.isupper() for one in ast.walk(node) if isinstance(one, ast.Name)) and not any(
        isinstance(one, ast.Call | ast.Attribute | ast.Subscript) for one in ast.walk(node)
    )


def bounded_above(said: ast.Assert, elapsed: Elapsed) -> bool:
    """Whether it says that a time is short. That one is long is true on a slow machine, too."""
    for compared in ast.walk(said.test):
        if not isinstance(compared, ast.Compare):
            continue
        sides = [compared.left, *compared.comparators]
        for before, how, after in zip(sides, compared.ops, sides[1:], strict=False):
            smaller = before if isinstance(how, ast.Lt | ast.LtE) else after
            if isinstance(how, ast.Lt | ast.LtE | ast.Gt | ast.GtE):
                if elapsed.is_span(smaller):
                    return True
            elif elapsed.is_span(before) or elapsed.is_span(after):
                return True
    return False


def faults(text: str, fixtures: dict[str, Node] | None = None) -> list[str]:
    """What of a file of tests is judged by the clock in CI."""
    tree = ast.parse(text)
    if marks_all(tree):
        return []
    returning, found = returning_spans(tree), list[str]()
    for name, node in reached(tree, fixtures or {}).items():
        found += [f"{name}: {quiet} is for tests that are full" for quiet in sorted(QUIET & names_of(node))]
        if any(ast.unparse(one) == "pytest.mark.alone" for one in node.decorator_list):
            found.append(f"{name}: alone is for tests that are full")
        elapsed = Elapsed(node, returning)
        found += [
            f"{name}: {ast.unparse(one)}"
            for one in in_ci(node)
            if isinstance(one, ast.Assert) and bounded_above(one, elapsed)
        ]
    return found


@cache
def fixtures_for(folder: Path) -> dict[str, Node]:
    """The functions of the files `conftest.py` that hold for a folder."""
    above = {} if folder == TESTS else fixtures_for(folder.parent)
    file = folder / "conftest.py"
    lines = ast.parse(file.read_text(encoding="utf-8")).body if file.is_file() else []
    return {**above, **{line.name: line for line in lines if isinstance(line, Node)}}


def all_faults() -> dict[str, list[str]]:
    """By file."""
    found: dict[str, list[str]] = {}
    for file in sorted(TESTS.rglob("test_*.py")):
        text = file.read_text(encoding="utf-8")
        if LOOKS_AT_A_CLOCK.search(text) and (said := faults(text, fixtures_for(file.parent))):
            found[str(file.relative_to(TESTS))] = said
    for file in sorted((TESTS / "support").rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        named = QUIET & names_of(ast.parse(text)) if LOOKS_AT_A_CLOCK.search(text) else set()
        if named and file.name not in OF_STANDSTILL:
            found[str(file.relative_to(TESTS))] = [f"{one} is used for tests that it does not know" for one in named]
    return found


def test_no_test_of_ci_needs_a_quiet_machine_or_says_that_something_is_soon() -> None:
    found = all_faults()
    assert not found


USES = "def seconds():\n    return undisturbed(measure)\n"
TIMED = "def seconds():\n    began = monotonic()\n    work()\n    return monotonic() - began\n"


@pytest.mark.parametrize(
    "text",
    [
        "def test_a():\n    assert undisturbed(heard) == ['x']",
        USES + "def test_a():\n    assert seconds() == 1",
        USES + "@pytest.fixture\ndef took():\n    return seconds()\n\n\ndef test_a(took):\n    assert took",
        "@pytest.mark.alone\ndef test_a():\n    pass",
        "def test_a():\n    began = time.monotonic()\n    assert time.monotonic() - began < 2",
        "def test_a():\n    began = time.monotonic()\n    took_s = time.monotonic() - began\n    assert 1 < took_s < 2",
        "def test_a():\n    began = loop.time()\n    assert 2 > loop.time() - began",
        TIMED + "def test_a():\n    assert max(seconds() for _ in range(3)) <= 2",
        TIMED + "@pytest.mark.parametrize('a', [pytest.param(1, marks=pytest.mark.full), 2])\n"
        "def test_a(a):\n    took_s = seconds()\n    assert took_s < 2",
        "def test_a():\n    if FULL:\n        pass\n    else:\n        assert time.time() - began() < 2",
    ],
)
def test_what_is_judged_by_the_clock_would_be_found(text: str) -> None:
    assert faults(text)


@pytest.mark.parametrize(
    "text",
    [
        "@pytest.mark.full\ndef test_a():\n    assert undisturbed(heard) == ['x']",
        "pytestmark = [pytest.mark.full]\n\n\ndef test_a():\n    assert undisturbed(heard) == ['x']",
        TIMED + "def test_a():\n    took_s = seconds()\n    if FULL:\n        assert took_s < 2",
        TIMED + "def test_a():\n    assert seconds() >= 2",
        "def test_a():\n    deadline = time.monotonic() + 60\n    assert time.monotonic() < deadline",
        "def test_a():\n    before = time.time_ns()\n    assert before - ROUNDED_NS <= stamp() <= time.time_ns()",
        "def test_a():\n    assert state['zero_at'] - state['moved_at'] < 1",
    ],
)
def test_what_is_judged_otherwise_is_let_be(text: str) -> None:
    assert not faults(text)
