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
from functools import partial
from typing import Any, cast

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.select import FieldPath, parse_field
from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.model.interfaces import TEXTS, FieldType

MAX_LENGTH = 1000
"""Characters. Far more than a condition that can still be understood."""
MAX_DEPTH = 40
"""Levels of nesting. Evaluation recurses, and Python's own parser gives up at about 200."""
_LARGEST = 2**64
"""Integers beyond every type of ROS; without a bound a literal of 1000 digits would be computed with."""

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
    """A part of the condition: how to evaluate it, and of which kind it is: number, truth, text, list or message.

    `words` describe it in errors; `element` is the kind of a list's elements.
    """

    kind: str
    evaluate: Evaluate
    words: str
    element: str = ""


def _truth(evaluate: Evaluate) -> _Term:
    return _Term("truth", evaluate, "true or false")


def _number(evaluate: Evaluate) -> _Term:
    return _Term("number", evaluate, "a number")


@dataclass(slots=True)
class _Compiler:
    definitions: Definitions
    type_name: str
    fields: dict[str, None] = field(default_factory=dict[str, None])

    def term(self, node: ast.expr) -> _Term:
        match node:
            case ast.BoolOp(op=op, values=values):
                parts = [self._of_kind(value, "truth").evaluate for value in values]
                decide = all if isinstance(op, ast.And) else any
                return _truth(lambda message: decide(part(message) for part in parts))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                inner = self._of_kind(operand, "truth").evaluate
                return _truth(lambda message: not inner(message))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return _number(self._of_kind(operand, "number").evaluate)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                value = self._of_kind(operand, "number").evaluate
                return _number(lambda message: -value(message))
            case ast.BinOp(op=op) if compute := _ARITHMETIC.get(type(op)):
                left, right = (self._of_kind(side, "number").evaluate for side in (node.left, node.right))
                return _number(lambda message: compute(left(message), right(message)))
            case ast.Compare():
                return self._comparison(node)
            case ast.Call():
                return self._call(node)
            case ast.Constant(value=value):
                return _constant(value)
            case ast.Name() | ast.Attribute() | ast.Subscript():
                return self._field(node)
            case _:
                raise BadInput(f"{_excerpt(node)} cannot be used in a condition.", _ALLOWED)

    def _comparison(self, node: ast.Compare) -> _Term:
        terms = [self.term(side) for side in (node.left, *node.comparators)]
        steps = [
            (_comparing(node, sign, left, right), left.evaluate, right.evaluate)
            for sign, left, right in zip(node.ops, terms, terms[1:], strict=False)
        ]
        return _truth(lambda message: all(compare(left(message), right(message)) for compare, left, right in steps))

    def _call(self, node: ast.Call) -> _Term:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name not in _FUNCTIONS or node.keywords or not node.args:
            raise BadInput(f"{_excerpt(node)} cannot be called here.", f"There are {', '.join(_FUNCTIONS)}.")
        arguments = [self.term(argument) for argument in node.args]
        compute, takes, hint = _FUNCTIONS[name]
        if not takes([f"{term.kind} {term.element}".strip() for term in arguments]):
            kinds = ", ".join(term.words for term in arguments)
            raise BadInput(f"{_excerpt(node)}: {name}() does not take {kinds}.", hint)
        values = [term.evaluate for term in arguments]
        return _number(lambda message: compute(*(value(message) for value in values)))

    def _field(self, node: ast.expr) -> _Term:
        if isinstance(node, ast.Name):
            structure = self.definitions.structure(self.type_name)
            constants = {**_CONSTANTS, **{constant.name: constant.value for constant in structure.constants}}
            if node.id in constants and node.id not in {field.name for field in structure.fields}:
                return _constant(constants[node.id])
        path = parse_field(self.definitions, self.type_name, _text_of(node))
        self.fields[path.path] = None
        if path.is_list:
            return _Term("list", _reader(path), f"a list ({path.type})", _single_kind(path.type.element))
        kind = _single_kind(path.type)
        return _Term(kind, _reader(path), f"a {kind} ({path.type})")

    def _of_kind(self, node: ast.expr, kind: str) -> _Term:
        term = self.term(node)
        # a single boolean counts as 0 or 1; a whole comparison as a number would be a mistake
        if term.kind == kind or (kind == "number" and term.kind == "truth" and isinstance(node, _SINGLE)):
            return term
        needed = {"truth": "a condition", "number": "a number"}[kind]
        raise BadInput(f"{_excerpt(node)} is {term.words}, but {needed} is needed here.", _kind_hint(term, kind))


_SINGLE = (ast.Name, ast.Attribute, ast.Subscript, ast.Constant)


def _constant(value: object) -> _Term:
    if isinstance(value, bool):
        return _truth(lambda _: value)
    if isinstance(value, str):
        return _Term("text", lambda _: value, "a text")
    if isinstance(value, float) or (isinstance(value, int) and abs(value) <= _LARGEST):
        return _number(lambda _: value)
    raise BadInput(f"{str(value)[:40]} cannot be used here.", _ALLOWED) from None


def _single_kind(field_type: FieldType) -> str:
    if field_type.is_message:
        return "message"
    if field_type.base == "bool":
        return "truth"
    return "text" if field_type.base in TEXTS else "number"


def _reader(path: FieldPath) -> Evaluate:
    is_truth = not path.is_list and path.type.base == "bool"

    def read(message: object) -> Any:
        try:
            value = path.value_in(message)
        except BadValue as error:
            raise Undecided from error
        return bool(value) if is_truth else value

    return read


def _comparing(node: ast.Compare, sign: ast.cmpop, left: _Term, right: _Term) -> Callable[[Any, Any], bool]:
    """The comparison, if these two can be compared so."""
    kinds = {left.kind, right.kind}
    if (compare := _EQUALITY.get(type(sign))) and (kinds <= {"number", "truth"} or kinds == {"text"}):
        return compare
    if (compare := _ORDER.get(type(sign))) and kinds in ({"number"}, {"text"}):
        return compare
    is_in_list = right.kind == "list" and right.element == left.kind
    if (compare := _MEMBERSHIP.get(type(sign))) and (is_in_list or kinds == {"text"}):
        return compare
    hint = _kind_hint(left, "") or _kind_hint(right, "") or "Numbers compare with numbers, texts with texts."
    raise BadInput(f"{_excerpt(node)}: {left.words} and {right.words} cannot be compared so.", hint)


def _extreme(choose: Callable[..., Any], first: Any, *others: Any) -> Any:
    """The smallest or largest of several numbers, or of one list of them; NaN left out."""
    several = cast("Any", (first, *others) if others else first)
    plain = cast("Sequence[Any]", several.tolist() if hasattr(several, "tolist") else several)
    numbers = [value for value in plain if not math.isnan(value)]
    if not numbers:
        raise Undecided
    return choose(numbers)


def _several_numbers(kinds: Sequence[str]) -> bool:
    return list(kinds) == ["list number"] or (len(kinds) > 1 and set(kinds) == {"number"})


def _one_list_or_text(kinds: Sequence[str]) -> bool:
    return len(kinds) == 1 and kinds[0].startswith(("list", "text"))


_SEVERAL = "Give it one list of numbers, or several numbers."
_FUNCTIONS: Mapping[str, tuple[Callable[..., Any], Callable[[Sequence[str]], bool], str]] = {
    "abs": (abs, lambda kinds: list(kinds) == ["number"], "Give it one number."),
    "min": (partial(_extreme, min), _several_numbers, _SEVERAL),
    "max": (partial(_extreme, max), _several_numbers, _SEVERAL),
    "len": (len, _one_list_or_text, "Give it one list or text."),
    "hypot": (math.hypot, lambda kinds: set(kinds) == {"number"}, "Give it numbers, such as hypot(x - 1, y - 2)."),
}
"""What can be called: what it computes, whether it takes arguments of such kinds, and what to give it."""


def _kind_hint(term: _Term, needed: str) -> str:
    if term.kind == "message":
        return "Name one of its fields."
    if term.kind == "list":
        return "Pick an element, such as [0], or use min(), max() or len()."
    return "Compare it, such as: … > 1.0." if needed == "truth" else ""


def _excerpt(node: ast.expr) -> str:
    text = _text_of(node)
    return repr(text if len(text) <= 60 else text[:57] + "…")


def _text_of(node: ast.expr) -> str:
    try:
        return ast.unparse(node)
    except ValueError:  # some f-strings
        return "…"
