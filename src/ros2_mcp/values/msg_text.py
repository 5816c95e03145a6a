"""Parse the text of .msg, .srv and .action files."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ros2_mcp.model.errors import UnknownInterface
from ros2_mcp.model.interfaces import (
    FLOATS,
    INTEGERS,
    PRIMITIVES,
    TEXTS,
    TIME,
    Arity,
    Constant,
    Field,
    FieldType,
    Literals,
    Structure,
)
from ros2_mcp.model.text import quoted

_TYPE = re.compile(
    r"(?P<base>[A-Za-z]\w*(?:/[A-Za-z]\w*){0,2})(?:<=(?P<text_bound>\d+))?"
    r"(?P<array>\[(?:(?P<at_most><=)?(?P<size>\d+))?\])?",
    re.ASCII,
)
_CONSTANT = re.compile(r"(?P<type>\S+)\s+(?P<name>[A-Za-z]\w*)\s*=\s*(?P<value>.*)", re.ASCII)
_FIELD = re.compile(r"(?P<type>\S+)\s+(?P<name>[A-Za-z]\w*)(?:\s+(?P<default>.+))?", re.ASCII)
_ITEM = re.compile(r""""(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|[^,\s][^,]*""")
_TIMES = {"time": TIME, "duration": "builtin_interfaces/msg/Duration"}
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}


def split_sections(text: str) -> list[str]:
    """Split a .srv or .action text at its `---` lines."""
    return re.split(r"^---[ \t]*$", text, flags=re.MULTILINE)


def read_structure(type_name: str, text: str) -> Structure:
    """Parse one message, or one side of a service or action.

    Raises:
        UnknownInterface: naming the line that cannot be parsed.
    """
    package, _, _ = type_name.partition("/")
    about, rest = _about(text)
    items = [_read_line(type_name, package, *line) for line in _code_lines(rest)]
    fields = tuple(item for item in items if isinstance(item, Field))
    constants = tuple(item for item in items if isinstance(item, Constant))
    return Structure(type_name, fields, constants, about)


def _about(text: str) -> tuple[str, str]:
    """Return the leading comment, if an empty line separates it from the rest, and the rest of the text."""
    match = re.match(r"\s*((?:[ \t]*#[^\n]*\n)+)[ \t]*\n", text)
    if match is None:
        return "", text
    return _joined([line.strip().lstrip("#").strip() for line in match[1].splitlines()]), text[match.end() :]


def _code_lines(text: str) -> Iterator[tuple[str, str]]:
    """Yield each line of code with its comment: the comment lines just above, and the comment on the line itself."""
    above: list[str] = []
    for line in text.splitlines():
        code, _, comment = line.partition("#")
        code, comment = code.strip(), comment.lstrip("#").strip()
        if code and not code.startswith("@"):
            yield code, _joined([*above, comment])
        if code or not comment:
            above.clear()
        else:
            above.append(comment)


def _joined(comments: list[str]) -> str:
    return " ".join(comment for comment in comments if comment)


def _read_line(type_name: str, package: str, code: str, comment: str) -> Field | Constant:
    try:
        if match := _CONSTANT.fullmatch(code):
            field_type = read_type(package, match["type"])
            if field_type.arity != "single" or field_type.is_message:
                raise ValueError("a constant is one primitive value")
            value = _read_literal(field_type.base, match["value"].strip())
            return Constant(match["name"], str(field_type), value, comment)
        if match := _FIELD.fullmatch(code):
            field_type = read_type(package, match["type"])
            default = None if match["default"] is None else _read_default(field_type, match["default"].strip())
            return Field(match["name"], field_type, default, comment)
        raise ValueError("neither a field nor a constant")
    except ValueError as error:
        raise UnknownInterface(f"The definition of {type_name} cannot be read: {quoted(code)}: {error}.") from error


def read_type(package: str, text: str) -> FieldType:
    """Parse a type such as `float64[36]`, `string<=10[<=3]` or `Point` (of the same package).

    Raises:
        ValueError: if the text is not a type.
    """
    match = _TYPE.fullmatch(text)
    if match is None:
        raise ValueError("not a type")
    base = match["base"]
    parts = base.split("/")
    if base in _TIMES:
        base = _TIMES[base]
    elif base not in PRIMITIVES and len(parts) < 3:
        base = "/".join([parts[0] if len(parts) == 2 else package, "msg", parts[-1]])
    if match["text_bound"] and base not in TEXTS:
        raise ValueError("only strings have such a bound")
    arity: Arity = "single"
    if match["array"]:
        arity = "array" if match["size"] and not match["at_most"] else "sequence"
    return FieldType(base, arity, int(match["size"] or 0), int(match["text_bound"] or 0))


def _read_default(field_type: FieldType, text: str) -> Literals:
    if field_type.is_message:
        raise ValueError("a message has no default")
    if field_type.arity == "single":
        return _read_literal(field_type.base, text)
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError("the default of an array is written in brackets")
    return tuple(_read_literal(field_type.base, match[0].strip()) for match in _ITEM.finditer(text[1:-1]))


def _read_literal(base: str, text: str) -> bool | int | float | str:
    if base == "bool":
        if text.lower() not in _BOOLEANS:
            raise ValueError(f"{quoted(text)} is not a boolean")
        return _BOOLEANS[text.lower()]
    if base in INTEGERS:
        value = int(text, 0) if re.match(r"[+-]?0[xXbBoO]", text) else int(text)
        low, high = INTEGERS[base]
        if not low <= value <= high:
            raise ValueError(f"{value} is out of range for {base}")
        return value
    if base in FLOATS:
        return float(text)
    quote = text[:1]
    is_quoted = len(text) >= 2 and quote == text[-1] and quote in "\"'"
    return text[1:-1].replace("\\" + quote, quote) if is_quoted else text
