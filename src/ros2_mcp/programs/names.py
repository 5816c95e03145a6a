"""Checks the names of topics and fields in a program's text against the current graph."""

from __future__ import annotations

import ast
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, BadValue, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.programs.rewrite import tokens_of
from ros2_mcp.programs.sandbox import MODULE
from ros2_mcp.robot import Robot

_READ = frozenset({"latest", "messages", "wait_until", "scan", "picture"})
"""Functions whose leading text arguments are topics that must exist."""


@dataclass(frozen=True, slots=True)
class Named:
    """The topics and fields that a call names as literal texts, with its line."""

    line: int
    topics: Sequence[str]
    fields: Sequence[str]


async def require_names(robot: Robot, text: str) -> None:
    """Raise `BadInput` for a topic that does not exist but has a similar name, or whose type lacks a named field.

    A topic unlike any other may appear later: the function that reads it waits for it, and raises its own error.
    """
    if not (found := [one for one in named_in(text) if one.topics]):
        return
    try:
        present = {row.name: row for row in await robot.graph.topics()}
    except RobotError:  # the function that reads raises the error
        return
    for one in found:
        full = [await robot.graph.name_of(topic) for topic in one.topics]
        for topic in full:
            if topic not in present and (near := names.nearest(topic, [*present])):
                raise BadInput(f"line {one.line}: there is no topic {named(topic)}.", f"Did you mean {named(near)}?")
        row = present.get(full[0]) if len(full) == 1 else None
        if row and len(row.types) == 1 and one.fields:
            await _require_fields(robot, row.types[0], one)


async def _require_fields(robot: Robot, type_name: str, one: Named) -> None:
    from ros2_mcp.values.select import parse_fields

    try:
        await robot.values.learn(type_name)
        parse_fields(robot.values.definitions, type_name, one.fields)
    except BadValue as error:
        raise BadInput(f"line {one.line}: {error.message}", error.hint) from error
    except RobotError:  # the function that reads it raises the error
        return


def named_in(text: str) -> Iterator[Named]:
    """Yield the literal names in the calls of a program, such as `robot.latest("/odom", fields=["pose"])`."""
    tokens = [token for token in tokens_of(text) if token.type not in (tokenize.NL, tokenize.COMMENT)]
    for place in range(len(tokens) - 4):
        module, dot, function, bracket = tokens[place : place + 4]
        if (module.string, dot.string, bracket.string) == (MODULE, ".", "(") and function.string in _READ:
            yield _named(tokens[place + 4 :], function)


def _named(tokens: Sequence[tokenize.TokenInfo], function: tokenize.TokenInfo) -> Named:
    topics: list[str] = []
    fields: list[str] = []
    depth, argument, is_first = 0, "", True
    for place, token in enumerate(tokens):
        if token.type == tokenize.OP:
            depth += (token.string in "([{") - (token.string in ")]}")
            if depth < 0:
                break
            if token.string == "," and depth == 0:
                argument, is_first = "", False
        elif token.type == tokenize.NAME and depth == 0 and tokens[place + 1].string == "=":
            argument = token.string
            if argument == "bag":  # a recording: the function that reads it checks the names
                return Named(function.start[0], (), ())
        elif token.type == tokenize.STRING and (value := _text(token.string)):
            if argument == "fields":
                fields.append(value)
            elif argument in ("topic_name", "") and depth == 0 and (is_first or function.string == "messages"):
                topics.append(value)
    return Named(function.start[0], topics, fields)


def _text(literal: str) -> str:
    """Return the value of a plain text literal; "" for bytes, f-strings and other prefixed literals."""
    if literal[:1] not in "'\"" or len(literal) > 300:
        return ""
    try:
        value = ast.literal_eval(literal)
    except (ValueError, SyntaxError):
        return ""
    return value if isinstance(value, str) else ""
