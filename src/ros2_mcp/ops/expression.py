"""Conditions on a message's fields: `pose.pose.position.x > 1.0 and twist.twist.linear.x == 0`.

Python's grammar is used to read them, and nothing of Python to run them: each permitted piece of syntax becomes a small
function of our own, every name is checked against the definition, and every kind against its operator.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.select import FieldPath, parse_field
from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.model.interfaces import TEXTS, FieldType

MAX_LENGTH = 1000
MAX_DEPTH = 40
_LARGEST = 2**64

Evaluate = Callable[[object], Any]

_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda left, right: left + right,
    ast.Sub: lambda left, right: left - right,
    ast.Mult: lambda left, right: left * right,
    ast.Div: lambda left, right: left / right,
}
_ORDER: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_EQUALITY: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {ast.Eq: operator.eq, ast.NotEq: operator.ne}
_MEMBERSHIP: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.In: lambda part, whole: part in whole,
    ast.NotIn: lambda part, whole: part not in whole,
}
_CONSTANTS = {"true": True, "false": False, "nan": math.nan, "inf": math.inf}
_FUNCTIONS = ("abs", "min", "max", "len", "hypot")
_ALLOWED = (
    "A condition is made of fields, numbers, texts, comparisons, and, or, not, + - * /, parentheses, "
    "in, abs(), min(), max(), len() and hypot()."
)


class Undecided(Exception):
    """The condition has no answer for this message, because a list is too short."""


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition that fits the type; `fields` are the paths that it looks at, in order."""

    text: str
    fields: Sequence[str]
    _evaluate: Evaluate

    def holds(self, message: object) -> bool | None:
        """Whether it holds for a message; None where that cannot be said (a list is too short, division by zero)."""
        try:
            return bool(self._evaluate(message))
        except (Undecided, ArithmeticError):
            return None


def condition(definitions: Definitions, type_name: str, text: str) -> Condition:
    """Reads a condition and checks it against the definition.

    Raises:
        BadInput: for what is not a condition.
        BadValue: for a field that does not exist, with the nearest that does.
    """
    compiler = _Compiler(definitions, type_name)
    term = compiler.term(_parse(text))
    if term.kind != "truth":
        raise BadInput(f"{text.strip()!r} is {term.words}, not a condition.", "Compare it, such as: … > 1.0.")
    return Condition(text.strip(), list(compiler.fields), term.evaluate)


def _parse(text: str) -> ast.expr:
    if not text.strip():
        raise BadInput("The condition is empty.", _ALLOWED)
    if len(text) > MAX_LENGTH:
        raise BadInput(f"The condition has {len(text)} characters.", f"At most {MAX_LENGTH} are read.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise BadInput(f"The condition cannot be read: {getattr(error, 'msg', error)}.", _syntax_hint(text)) from error
    _check_depth(tree)
    return tree


def _check_depth(tree: ast.expr) -> None:
    level: list[ast.AST] = [tree]
    for _ in range(MAX_DEPTH):
        level = [below for node in level for below in ast.iter_child_nodes(node)]
    if level:
        raise BadInput("The condition is nested too deeply.", "Make it simpler.")


def _syntax_hint(text: str) -> str:
    if "&&" in text or "||" in text or "!" in text.replace("!=", ""):
        return "Write and, or, not."
    if "=" in text and "==" not in text:
        return "Write == to compare."
    return _ALLOWED


@dataclass(frozen=True, slots=True)
class _Term:
    """A part of the condition: how to evaluate it, and of which kind it is: number, truth, text or list."""

    kind: str
    evaluate: Evaluate
    words: str
    element: str = ""


@dataclass(slots=True)
class _Compiler:
    definitions: Definitions
    type_name: str
    fields: dict[str, None] = field(default_factory=dict[str, None])

    def term(self, node: ast.expr) -> _Term:
        match node:
            case ast.BoolOp():
                return self._and_or(node)
            case ast.UnaryOp():
                return self._unary(node)
            case ast.BinOp():
                return self._arithmetic(node)
            case ast.Compare():
                return self._comparison(node)
            case ast.Call():
                return self._call(node)
            case ast.Constant():
                return _constant(node.value)
            case ast.Name() | ast.Attribute() | ast.Subscript():
                return self._field(node)
            case _:
                raise _refusal(node)

    def _and_or(self, node: ast.BoolOp) -> _Term:
        parts = [self._of_kind(each, "truth").evaluate for each in node.values]
        decide = all if isinstance(node.op, ast.And) else any
        return _Term("truth", lambda message: decide(part(message) for part in parts), "true or false")

    def _unary(self, node: ast.UnaryOp) -> _Term:
        if isinstance(node.op, ast.Not):
            inner = self._of_kind(node.operand, "truth").evaluate
            return _Term("truth", lambda message: not inner(message), "true or false")
        if isinstance(node.op, ast.Invert):
            raise _refusal(node)
        number = self._of_kind(node.operand, "number").evaluate
        if isinstance(node.op, ast.UAdd):
            return _Term("number", number, "a number")
        return _Term("number", lambda message: -number(message), "a number")

    def _arithmetic(self, node: ast.BinOp) -> _Term:
        compute = _ARITHMETIC.get(type(node.op))
        if compute is None:
            raise _refusal(node)
        left = self._of_kind(node.left, "number").evaluate
        right = self._of_kind(node.right, "number").evaluate
        return _Term("number", lambda message: compute(left(message), right(message)), "a number")

    def _comparison(self, node: ast.Compare) -> _Term:
        terms = [self.term(each) for each in (node.left, *node.comparators)]
        steps = [
            (_comparing(node, sign, left, right), left.evaluate, right.evaluate)
            for sign, left, right in zip(node.ops, terms, terms[1:], strict=False)
        ]

        def holds(message: object) -> bool:
            return all(compare(left(message), right(message)) for compare, left, right in steps)

        return _Term("truth", holds, "true or false")

    def _call(self, node: ast.Call) -> _Term:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name not in _FUNCTIONS or node.keywords or not node.args:
            raise BadInput(f"{_excerpt(node)} cannot be called here.", f"There are {', '.join(_FUNCTIONS)}.")
        arguments = [self.term(each) for each in node.args]
        return _function(node, name, arguments)

    def _field(self, node: ast.expr) -> _Term:
        path = _text_of(node)
        structure = self.definitions.structure(self.type_name)
        if isinstance(node, ast.Name) and node.id not in {each.name for each in structure.fields}:
            constants = {each.name: each.value for each in structure.constants}
            known = {**_CONSTANTS, **constants}
            if node.id in known:
                return _constant(known[node.id])
        found = parse_field(self.definitions, self.type_name, path)
        self.fields[found.path] = None
        kind, words, element = _kind_of(found)
        return _Term(kind, _reader(found, kind), words, element)

    def _of_kind(self, node: ast.expr, kind: str) -> _Term:
        term = self.term(node)
        if term.kind == kind or (kind == "number" and term.kind == "truth" and isinstance(node, _SINGLE)):
            return term
        wanted = {"truth": "a condition", "number": "a number"}[kind]
        raise BadInput(f"{_excerpt(node)} is {term.words}, but {wanted} is needed here.", _kind_hint(term, kind))


_SINGLE = (ast.Name, ast.Attribute, ast.Subscript, ast.Constant)


def _constant(value: object) -> _Term:
    if isinstance(value, bool):
        return _Term("truth", lambda _: value, "true or false")
    if isinstance(value, str):
        return _Term("text", lambda _: value, "a text")
    if isinstance(value, float) or (isinstance(value, int) and abs(value) <= _LARGEST):
        return _Term("number", lambda _: value, "a number")
    raise BadInput(f"{str(value)[:40]} cannot be used here.", _ALLOWED) from None


def _kind_of(found: FieldPath) -> tuple[str, str, str]:
    if found.is_list:
        return "list", f"a list ({found.type})", _single_kind(found.type.element)
    return (kind := _single_kind(found.type)), f"a {kind} ({found.type})", ""


def _single_kind(field_type: FieldType) -> str:
    if field_type.is_message:
        return "message"
    if field_type.base == "bool":
        return "truth"
    return "text" if field_type.base in TEXTS else "number"


def _reader(found: FieldPath, kind: str) -> Evaluate:
    def read(message: object) -> Any:
        try:
            value = found.value_in(message)
        except BadValue as error:
            raise Undecided from error
        return bool(value) if kind == "truth" else value

    return read


def _comparing(node: ast.Compare, sign: ast.cmpop, left: _Term, right: _Term) -> Callable[[Any, Any], bool]:
    """The comparison, if these two can be compared so."""
    kinds = {left.kind, right.kind}
    if (compare := _EQUALITY.get(type(sign))) and (kinds <= {"number", "truth"} or kinds == {"text"}):
        return compare
    if (compare := _ORDER.get(type(sign))) and kinds in ({"number"}, {"text"}):
        return compare
    if (compare := _MEMBERSHIP.get(type(sign))) and (
        (right.kind == "list" and right.element == left.kind) or kinds == {"text"}
    ):
        return compare
    hint = _kind_hint(left, "") or _kind_hint(right, "") or "Numbers compare with numbers, texts with texts."
    raise BadInput(f"{_excerpt(node)}: {left.words} and {right.words} cannot be compared so.", hint)


def _function(node: ast.Call, name: str, arguments: Sequence[_Term]) -> _Term:
    kinds = [each.kind for each in arguments]
    evaluates = [each.evaluate for each in arguments]
    first = evaluates[0]
    if name == "len" and kinds in (["list"], ["text"]):
        return _Term("number", lambda message: len(first(message)), "a number")
    if name == "abs" and kinds == ["number"]:
        return _Term("number", lambda message: abs(first(message)), "a number")
    if name == "hypot" and set(kinds) == {"number"}:
        return _Term("number", lambda message: math.hypot(*(each(message) for each in evaluates)), "a number")
    if name in ("min", "max"):
        choose = min if name == "min" else max
        if kinds == ["list"] and arguments[0].element == "number":
            return _Term("number", lambda message: _extreme(choose, first(message)), "a number")
        if len(kinds) > 1 and set(kinds) == {"number"}:
            return _Term("number", lambda m: _extreme(choose, [each(m) for each in evaluates]), "a number")
    given = ", ".join(each.words for each in arguments)
    raise BadInput(f"{_excerpt(node)}: {name}() does not take {given}.", _FUNCTION_HINTS[name])


_FUNCTION_HINTS = {
    "len": "Give it one list or text.",
    "abs": "Give it one number.",
    "hypot": "Give it numbers, such as hypot(x - 1, y - 2).",
    "min": "Give it one list of numbers, or several numbers.",
    "max": "Give it one list of numbers, or several numbers.",
}


def _extreme(choose: Callable[..., Any], values: Any) -> Any:
    """The smallest or largest, NaN left out."""
    plain = cast("list[Any]", values.tolist() if hasattr(values, "tolist") else values)
    numbers = [value for value in plain if not math.isnan(value)]
    if not numbers:
        raise Undecided
    return choose(numbers)


def _kind_hint(term: _Term, wanted: str) -> str:
    if term.kind == "message":
        return "Name one of its fields."
    if term.kind == "list":
        return "Pick an element, such as [0], or use min(), max() or len()."
    return "Compare it, such as: … > 1.0." if wanted == "truth" else ""


def _refusal(node: ast.expr) -> BadInput:
    return BadInput(f"{_excerpt(node)} cannot be used in a condition.", _ALLOWED)


def _excerpt(node: ast.expr) -> str:
    text = _text_of(node)
    return repr(text if len(text) <= 60 else text[:57] + "…")


def _text_of(node: ast.expr) -> str:
    try:
        return ast.unparse(node)
    except ValueError:  # some f-strings
        return "…"
