"""Conditions on a message's fields: `pose.pose.position.x > 1.0 and twist.twist.linear.x == 0`.

`status[*].level` are the levels of all elements. `any(status, name == "imu" and level > 1)` tests the elements one
by one: the names in its condition are fields of an element. For a laser scan, `nearest(-20, 20)` is the free
distance between two angles.

Conditions are parsed with Python's grammar but not run as Python: each permitted piece of syntax becomes a small
function of this module, every name is checked against the definition, and every kind against its operator.

Server and bridge share this module, so that a condition means the same in both: for messages of rosbags and of rclpy.
Needs no ROS. Its reference is docs/reference/conditions.md.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.language import scans
from ros2_mcp_common.language.field_types import TEXTS, Types
from ros2_mcp_common.language.paths import FieldPath, PathError, parse

# The longest condition in characters, far more than anyone could understand.
MAX_LENGTH = 1000
# The deepest nesting. Evaluation recurses, and Python's own parser gives up at about 200 levels.
MAX_DEPTH = 40
# Larger integers, beyond every ROS type, are rejected: otherwise a literal of 1000 digits would be used in arithmetic.
_LARGEST = 2**64

Evaluate = Callable[[object], Any]

_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda left, right: left + right,
    ast.Sub: lambda left, right: left - right,
    ast.Mult: lambda left, right: left * right,
    ast.Div: lambda left, right: left / right,
}
_COMPARISONS: Mapping[type[ast.cmpop], tuple[str, Callable[[Any, Any], bool]]] = {
    ast.Eq: ("equality", operator.eq),
    ast.NotEq: ("equality", operator.ne),
    ast.Lt: ("order", operator.lt),
    ast.LtE: ("order", operator.le),
    ast.Gt: ("order", operator.gt),
    ast.GtE: ("order", operator.ge),
    ast.In: ("membership", lambda part, whole: part in _plain(whole)),
    ast.NotIn: ("membership", lambda part, whole: part not in _plain(whole)),
}
_CONSTANTS = {"true": True, "false": False, "nan": math.nan, "inf": math.inf}
_ALLOWED = (
    "A condition is made of fields, numbers, texts, comparisons, and, or, not, + - * /, parentheses, "
    "in, abs(), min(), max(), len(), hypot(), sqrt(), atan2(), yaw(quaternion), any() and all(), and of a laser scan "
    "range_at(deg) and nearest(from_deg, to_deg); status[*].level are the levels of all elements."
)
_COMPARE_IT = "Compare it, such as: … > 1.0."
# Matches `[*]`, which is no Python, and string literals, in which it is not replaced.
_ALL_ELEMENTS = re.compile(r"""('(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")|\[\s*\*\s*\]""")


class ConditionError(ValueError):
    """Raised for a text that is not a valid condition; the hint says what is allowed.

    A missing field raises `PathError` instead.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(f"{message} {hint}".rstrip())
        self.message = message
        self.hint = hint


class Undecided(Exception):
    """Raised if the condition cannot be evaluated for this message, for example because a list is too
    short; the text says why.
    """


@dataclass(frozen=True)
class Condition:
    """A condition checked against a message type; `fields` are the paths that it reads, in order.

    `computed` has the functions it computes, such as `min(ranges)`, by their text; a list
    inside one is not in `fields`.
    """

    text: str
    fields: Sequence[str]
    computed: Mapping[str, Evaluate]
    _evaluate: Evaluate

    def holds(self, message: object) -> bool | None:
        """Return whether the condition is true for a message; None if undecidable (a list is too
        short, division by zero).
        """
        try:
            return bool(self._evaluate(message))
        except (Undecided, ArithmeticError):
            return None

    def values(self, message: object) -> dict[str, float | str | None]:
        """Return the computed values of a message by their text, as JSON; None for a value that cannot be computed."""
        found: dict[str, float | str | None] = {}
        for text, evaluate in self.computed.items():
            try:
                value = float(evaluate(message))
                whole = value.is_integer() and abs(value) <= _LARGEST
                found[text] = int(value) if whole else value if math.isfinite(value) else str(value)
            except (Undecided, ArithmeticError):
                found[text] = None
        return found

    def why_undecided(self, message: object) -> str:
        """Return why the condition cannot be evaluated for a message; "" if it can."""
        try:
            self._evaluate(message)
        except (Undecided, ArithmeticError) as error:
            return str(error) if isinstance(error, Undecided) else f"{error}."
        return ""


def condition(types: Types, type_name: str, text: str) -> Condition:
    """Parse a condition and check it against the type.

    Raises:
        ConditionError: if the text is not a condition.
        PathError: for a field that does not exist; names the nearest that does.
    """
    compiler = _Compiler(types, type_name)
    term = compiler.term(_parse(text))
    if term.kind != "truth":
        raise ConditionError(f"{text.strip()!r} is {term.words}, not a condition.", _COMPARE_IT)
    return Condition(text.strip(), list(compiler.fields), compiler.computed, term.evaluate)


def _parse(text: str) -> ast.expr:
    if not text.strip():
        raise ConditionError("The condition is empty.", _ALLOWED)
    if len(text) > MAX_LENGTH:
        raise ConditionError(f"The condition has {len(text)} characters.", f"At most {MAX_LENGTH} are read.")
    try:
        with warnings.catch_warnings():  # Python warns of `1 is 1` and the like; we reject them
            warnings.simplefilter("ignore")
            tree = ast.parse(_ALL_ELEMENTS.sub(lambda found: found[1] or "[:]", text.strip()), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        hint = _ALLOWED
        if "&&" in text or "||" in text or "!" in text.replace("!=", ""):
            hint = "Write and, or, not."
        elif "=" in text and "==" not in text:
            hint = "Write == to compare."
        raise ConditionError(f"The condition cannot be read: {getattr(error, 'msg', error)}.", hint) from error
    level: list[ast.AST] = [tree]
    for _ in range(MAX_DEPTH):
        level = [child for piece in level for child in ast.iter_child_nodes(piece)]
    if level:
        raise ConditionError("The condition is nested too deeply.", "Make it simpler.")
    return tree


@dataclass(frozen=True)
class _Term:
    """A compiled part of a condition: how to evaluate it, and its kind: `number`, `truth`, `text`, `list` or `message`.

    `type` is the type of a field, `element` the kind of a list's elements. `is_single`: it is a field or a
    constant, and not computed.
    """

    kind: str
    evaluate: Evaluate
    type: str = ""
    element: str = ""
    is_single: bool = False

    @property
    def holds(self) -> str:
        """The kind of a list's elements, or the type of a message."""
        return self.type if self.kind == "message" else self.element

    @property
    def words(self) -> str:
        """The kind in words, for errors."""
        if self.type:
            return f"a {self.kind} ({self.type})"
        return "true or false" if self.kind == "truth" else f"a {self.kind}"

    @property
    def hint(self) -> str:
        """A hint on how to write the term if it cannot be compared or computed with as it is."""
        hints = {
            "message": "Name one of its fields.",
            "list": "Pick an element, such as [0], or use min(), max(), len(), any() or all().",
        }
        return hints.get(self.kind, "")


@dataclass
class _Compiler:
    """Compiles syntax to terms; `fields` are the paths found so far, in order (the values mean nothing).

    `within` is the path, with a dot, of the list to whose elements the condition applies; "" for a whole message.
    """

    types: Types
    type_name: str
    fields: dict[str, None] = field(default_factory=dict[str, None])
    within: str = ""
    computed: dict[str, Evaluate] = field(default_factory=dict[str, Evaluate])

    def term(self, piece: ast.expr) -> _Term:
        """Compile any piece of syntax. Raise `ConditionError` if it is not permitted."""
        if isinstance(piece, ast.BoolOp):
            parts = [self._of_kind(value, "truth") for value in piece.values]
            decide = all if isinstance(piece.op, ast.And) else any
            return _Term("truth", lambda message: decide(part(message) for part in parts))
        if isinstance(piece, ast.UnaryOp) and isinstance(piece.op, ast.Not):
            inner = self._of_kind(piece.operand, "truth")
            return _Term("truth", lambda message: not inner(message))
        if isinstance(piece, ast.UnaryOp) and isinstance(piece.op, (ast.UAdd, ast.USub)):
            value, sign = self._of_kind(piece.operand, "number"), -1 if isinstance(piece.op, ast.USub) else 1
            return _Term("number", lambda message: sign * value(message))
        if isinstance(piece, ast.BinOp) and (compute := _ARITHMETIC.get(type(piece.op))):
            left, right = (self._of_kind(side, "number") for side in (piece.left, piece.right))
            return _Term("number", lambda message: compute(left(message), right(message)))
        if isinstance(piece, ast.Compare):
            return self._comparison(piece)
        if isinstance(piece, ast.Call):
            return self._call(piece)
        if isinstance(piece, ast.Constant):
            return _constant(piece.value)
        if isinstance(piece, (ast.Name, ast.Attribute, ast.Subscript)):
            return self._field(piece)
        raise ConditionError(f"{_excerpt(piece)} cannot be used in a condition.", _ALLOWED)

    def _comparison(self, piece: ast.Compare) -> _Term:
        terms = [self.term(side) for side in (piece.left, *piece.comparators)]
        steps = [
            (_comparing(piece, sign, left, right), left.evaluate, right.evaluate)
            for sign, left, right in zip(piece.ops, terms, terms[1:])  # noqa: B905 - `strict` is of 3.10
        ]
        return _Term(
            "truth", lambda message: all(compare(left(message), right(message)) for compare, left, right in steps)
        )

    def _call(self, piece: ast.Call) -> _Term:
        name = piece.func.id if isinstance(piece.func, ast.Name) else ""
        if name in _QUANTIFIERS and piece.args and not piece.keywords:
            return self._quantified(piece, _QUANTIFIERS[name])
        if name in _OF_SCANS and piece.args and not piece.keywords:
            return self._of_scan(piece, name)
        if name not in _FUNCTIONS or piece.keywords or not piece.args:
            known = ", ".join((*_FUNCTIONS, *_OF_SCANS, *_QUANTIFIERS))
            raise ConditionError(f"{_excerpt(piece)} cannot be called here.", f"There are {known}.")
        arguments = [self.term(argument) for argument in piece.args]
        compute, accepts, hint = _FUNCTIONS[name]
        if not accepts([f"{term.kind} {term.holds}".strip() for term in arguments]):
            kinds = ", ".join(term.words for term in arguments)
            raise ConditionError(f"{_excerpt(piece)}: {name}() does not take {kinds}.", hint)

        def evaluate(message: object) -> Any:
            return compute(*(term.evaluate(message) for term in arguments))

        if not self.within:
            self.computed[_text_of(piece)] = evaluate
            for term, argument in zip(arguments, piece.args):  # noqa: B905 - `strict` is of 3.10
                if term.kind in ("list", "message") and len(arguments) == 1:  # the result is shown instead of the list
                    self.fields.pop(_text_of(argument), None)
        return _Term("number", evaluate)

    def _of_scan(self, piece: ast.Call, name: str) -> _Term:
        """Compile `range_at(deg)` or `nearest(from_deg, to_deg)` of a laser scan."""
        count, hint = _OF_SCANS[name]
        if self.type_name != scans.LASER_SCAN or self.within:
            raise ConditionError(f"{name}() works only on a topic of type {scans.LASER_SCAN}.", _ALLOWED)
        if len(piece.args) != count:
            raise ConditionError(
                f"{_excerpt(piece)}: {name}() takes {count} {'angle' if count == 1 else 'angles'}.", hint
            )
        angles = [self._of_kind(argument, "number") for argument in piece.args]

        def evaluate(message: object) -> float:
            degrees = [float(angle(message)) for angle in angles]
            try:
                return scans.nearest_range(message, degrees[0], degrees[-1])
            except scans.NoRange as error:
                raise Undecided(f"{_text_of(piece)}: {error}") from error

        self.computed[_text_of(piece)] = evaluate
        return _Term("number", evaluate)

    def _quantified(self, piece: ast.Call, decisive: bool) -> _Term:
        """Compile `any` or `all` of a list of booleans, or of a condition on the elements of a list of messages."""
        subject, conditions = piece.args[0], piece.args[1:]
        if not conditions:
            flags = self.term(subject)
            if (flags.kind, flags.element) == ("list", "truth"):
                decide = any if decisive else all
                return _Term("truth", lambda message: decide(flags.evaluate(message)))
        elif len(conditions) == 1 and isinstance(subject, (ast.Name, ast.Attribute, ast.Subscript)):
            path = self._path(subject)
            if path.is_list and path.type.is_message:
                prefix = f"{self.within}{path.path}{'[*]' * (path.type.arity != 'single')}."
                inner = _Compiler(self.types, path.type.base, self.fields, prefix)
                asked, elements = inner._of_kind(conditions[0], "truth"), _reading(path)
                return _Term("truth", lambda message: _decided(asked, elements(message), decisive))
        raise ConditionError(f"{_excerpt(piece)} cannot be read.", _QUANTIFIED)

    def _path(self, piece: ast.expr) -> FieldPath:
        return parse(self.types, self.type_name, _text_of(piece))

    def _field(self, piece: ast.expr) -> _Term:
        if isinstance(piece, ast.Name):
            constants = {**_CONSTANTS, **self.types.constants(self.type_name)}
            if piece.id in constants and piece.id not in self.types.fields(self.type_name):
                return _constant(constants[piece.id])
        path = self._path(piece)
        self.fields[self.within + path.path] = None
        single = path.type.element if path.is_list else path.type
        kind = "text" if single.base in TEXTS else "number"
        if single.is_message or single.base == "bool":
            kind = "message" if single.is_message else "truth"
        read = _reading(path)
        if path.is_list:
            return _Term("list", read, str(path.type), kind, is_single=True)
        evaluate: Evaluate = (lambda message: bool(read(message))) if kind == "truth" else read
        return _Term(kind, evaluate, str(path.type), is_single=True)

    def _of_kind(self, piece: ast.expr, kind: str) -> Evaluate:
        term = self.term(piece)
        # a single boolean counts as 0 or 1; a whole comparison as a number would be a mistake
        if term.kind == kind or (kind == "number" and term.kind == "truth" and term.is_single):
            return term.evaluate
        needed, hint = ("a condition", _COMPARE_IT) if kind == "truth" else ("a number", "")
        raise ConditionError(f"{_excerpt(piece)} is {term.words}, but {needed} is needed here.", term.hint or hint)


def _reading(path: FieldPath) -> Evaluate:
    """Return a function that reads the value at a path; it raises `Undecided` if a list is too short."""

    def read(message: object) -> Any:
        try:
            return path.value_in(message)
        except PathError as error:
            raise Undecided(str(error)) from error

    return read


def _decided(asked: Evaluate, elements: Sequence[object], decisive: bool) -> bool:
    """Return `decisive` if one element's answer is `decisive` (True decides `any`, False decides
    `all`), else its opposite.

    Raises:
        Undecided, ArithmeticError: if no element decides and one cannot be evaluated.
    """
    undecided: Exception | None = None
    for element in elements:
        try:
            if bool(asked(element)) is decisive:
                return decisive
        except (Undecided, ArithmeticError) as error:
            undecided = undecided or error
    if undecided:
        raise undecided
    return not decisive


def _constant(value: object) -> _Term:
    if isinstance(value, (bool, str, float)) or (isinstance(value, int) and abs(value) <= _LARGEST):
        kind = "truth" if isinstance(value, bool) else "text" if isinstance(value, str) else "number"
        return _Term(kind, lambda _: value, is_single=True)
    raise ConditionError(f"{str(value)[:40]} cannot be used here.", _ALLOWED) from None


def _comparing(piece: ast.Compare, sign: ast.cmpop, left: _Term, right: _Term) -> Callable[[Any, Any], bool]:
    """Return the function of a comparison. Raise `ConditionError` if the two terms cannot be compared in this way."""
    kinds = {left.kind, right.kind}
    way, compare = _COMPARISONS.get(type(sign), ("", operator.eq))
    possible = {
        "equality": kinds <= {"number", "truth"} or kinds == {"text"},
        "order": kinds in ({"number"}, {"text"}),
        "membership": kinds == {"text"} or (right.kind == "list" and right.element == left.kind),
    }
    if possible.get(way):
        return compare
    hint = left.hint or right.hint or "Numbers compare with numbers, texts with texts."
    raise ConditionError(f"{_excerpt(piece)}: {left.words} and {right.words} cannot be compared.", hint)


def _extreme(choose: Callable[..., Any], first: Any, *others: Any) -> Any:
    """Return the smallest or largest of several numbers, or of one list of numbers; NaN is ignored."""
    values: Any = (first, *others) if others else first
    numbers = [value for value in _plain(values) if not math.isnan(value)]
    if not numbers:
        raise Undecided("min() or max() has no number: the list is empty, or all in it are NaN.")
    return choose(numbers)


def _plain(values: Any) -> Any:
    """Return an array as a list of Python numbers.

    They are faster here than NumPy's (60 instead of 86 µs for 1000 elements), and float32 are compared as elsewhere.
    """
    return values.tolist() if hasattr(values, "tolist") else values


def _square_root(value: float) -> float:
    if value < 0:
        raise Undecided(f"sqrt() of {value:g} is not a number.")
    return math.sqrt(value)


def _yaw(quaternion: Any) -> float:
    """Return the heading in rad, -π to π, counterclockwise about z. The quaternion may have any length."""
    x, y, z, w = (float(getattr(quaternion, name)) for name in "xyzw")
    if not any((x, y, z, w)):
        raise Undecided("yaw() of a quaternion of zeros is not a direction.")
    return yaw_rad(x, y, z, w)


def _accepts_several(kinds: Sequence[str]) -> bool:
    return list(kinds) == ["list number"] or (len(kinds) > 1 and set(kinds) == {"number"})


_QUATERNION = "geometry_msgs/msg/Quaternion"
_SEVERAL = "Give it one list of numbers, or several numbers."
# The functions: what each computes, which kinds of arguments it accepts, and the hint for others.
_FUNCTIONS: Mapping[str, tuple[Callable[..., Any], Callable[[Sequence[str]], bool], str]] = {
    "abs": (abs, lambda kinds: list(kinds) == ["number"], "Give it one number."),
    "min": (partial(_extreme, min), _accepts_several, _SEVERAL),
    "max": (partial(_extreme, max), _accepts_several, _SEVERAL),
    "len": (len, lambda kinds: len(kinds) == 1 and kinds[0].startswith(("list", "text")), "Give it one list or text."),
    "hypot": (math.hypot, lambda kinds: set(kinds) == {"number"}, "Give it numbers, such as hypot(x - 1, y - 2)."),
    "sqrt": (_square_root, lambda kinds: list(kinds) == ["number"], "Give it one number."),
    "atan2": (math.atan2, lambda kinds: list(kinds) == ["number", "number"], "Give it two numbers: atan2(y, x)."),
    "yaw": (
        _yaw,
        lambda kinds: list(kinds) == [f"message {_QUATERNION}"],
        "Give it one quaternion, such as yaw(pose.pose.orientation).",
    ),
}
# The quantifiers of lists, each with the answer of one element that decides it.
_QUANTIFIERS: Mapping[str, bool] = {"any": True, "all": False}
# The functions of a laser scan: the number of angles, and the hint for another number.
_OF_SCANS: Mapping[str, tuple[int, str]] = {
    "range_at": (1, "Give it one angle in degrees, counterclockwise from the scan's x axis: range_at(90)."),
    "nearest": (2, "Give it two angles in degrees, counterclockwise from the first to the second: nearest(-20, 20)."),
}
_QUANTIFIED = (
    "Give it a list of messages and a condition on the fields of one, "
    'such as any(status, name == "imu" and level > 1), or one list of booleans.'
)


def _excerpt(piece: ast.expr) -> str:
    text = _text_of(piece)
    return repr(text if len(text) <= 60 else text[:57] + "…")


def _text_of(piece: ast.expr) -> str:
    try:
        return ast.unparse(piece).replace("[:]", "[*]")
    except ValueError:  # some f-strings
        return "…"
