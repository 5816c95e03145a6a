"""Programs as the sandbox takes them: it cannot wait for the robot in the middle of a `for` loop, nor has `async for`.

So a loop over messages is written as one over a list that grows with every turn, and the next message is asked for in
the first line of its body, where the sandbox can wait. Lines move by that; `Rewritten.line` leads back.
"""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model.errors import BadInput

PRELUDE = """\
import _robot, robot
class Messages:
    def __init__(self, number):
        self.number = number
class _Turn:
    def __init__(self, stream):
        self.stream = stream
_end = _Turn(None)
def _all(value):
    if type(value) is not Messages:
        return value
    found = []
    while (message := _robot.next(value.number)) is not None:
        found.append(message)
    return found
def _turns(value):
    return [_Turn(value)] if type(value) is Messages else value
def _turn(value, turns):
    if type(value) is not _Turn:
        return value
    message = _robot.next(value.stream.number)
    if message is None:
        return _end
    turns.append(value)
    return message
def help(about=None):
    print(_robot.help(about))
_streams = [Messages(number) for number in range({streams})]
_streams
"""
"""Runs in the sandbox before the program. Its value are the objects that stand for streams of messages there."""

_AWAIT = re.compile(r"\bawait[ \t]+(?=robot\.)")
_ASYNC_FOR = re.compile(r"\basync[ \t]+(?=for\b)")
_BLANKS = (tokenize.NL, tokenize.COMMENT)
_DEEPEST = 60
"""Brackets within brackets, and blocks within blocks: no program that a person reads has as many."""


@dataclass(frozen=True, slots=True)
class Rewritten:
    """A program for the sandbox; `lines` has for each of its lines the number of that of the original."""

    text: str
    lines: Sequence[int]

    def line(self, number: int) -> int:
        """The line of the original, from 1 on; 0 where there is none."""
        return self.lines[number - 1] if 0 < number <= len(self.lines) else 0


@dataclass(slots=True)
class _Edits:
    """What changes: in a line (from column, to column, new text), and lines that are put before one."""

    within: dict[int, list[tuple[int, int, str]]] = field(default_factory=dict[int, list[tuple[int, int, str]]])
    before: dict[int, list[str]] = field(default_factory=dict[int, list[str]])

    def put(self, at: tuple[int, int], new: str, end: tuple[int, int] | None = None) -> None:
        """Puts text there, in the place of what stands up to `end` on the same line."""
        self.within.setdefault(at[0], []).append((at[1], (end or at)[1], new))


def without_async(text: str) -> str:
    """The program without the `await` and `async` that the functions of the robot do not need, and many write."""
    return _ASYNC_FOR.sub("", _AWAIT.sub("", text))


def rewritten(text: str) -> Rewritten:
    """The program with its loops written so that they can wait for messages.

    Raises:
        BadInput: for what cannot be read as Python at all, with the line.
    """
    text = without_async(text)
    lines = text.splitlines(keepends=True)
    tokens = tokens_of(text)
    edits = _Edits()
    if any(token.string in ("messages", "feedback") for token in tokens):  # else nothing is to be waited for
        _rewrite(tokens, edits)
    out: list[str] = []
    numbers: list[int] = []
    for number, line in enumerate(lines, 1):
        inserted = edits.before.get(number, [])
        changed = line
        for start, end, new in sorted(edits.within.get(number, ()), reverse=True):
            changed = changed[:start] + new + changed[end:]
        out += [*inserted, changed]
        numbers += [number] * (len(inserted) + max(1, len(changed.splitlines())))
    return Rewritten("".join(out), numbers)


def tokens_of(text: str) -> list[tokenize.TokenInfo]:
    """The tokens of a program; raises `BadInput` with the line where it is no Python, or nested beyond all measure."""
    depth = blocks = 0
    found: list[tokenize.TokenInfo] = []
    try:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.OP:
                depth += (token.string in "([{") - (token.string in ")]}")
            blocks += (token.type == tokenize.INDENT) - (token.type == tokenize.DEDENT)
            if max(depth, blocks) > _DEEPEST:
                raise BadInput(f"line {token.start[0]}: brackets or blocks are nested more than {_DEEPEST} times.")
            found.append(token)
    except tokenize.TokenError as error:
        what, at = error.args
        raise BadInput(f"line {at[0]}: this is not valid Python: {what}.") from error
    except SyntaxError as error:
        raise BadInput(f"line {error.lineno or 0}: this is not valid Python: {error.msg}.") from error
    return found


def _rewrite(tokens: Sequence[tokenize.TokenInfo], edits: _Edits) -> None:
    """Of each `for` the iterable is wrapped, and the first line of its body fetches the message."""
    depth, begins = 0, True
    for place, token in enumerate(tokens):
        if token.type == tokenize.OP:
            depth += (token.string in "([{") - (token.string in ")]}")
        if token.type == tokenize.NAME and token.string == "for":
            if begins:
                _rewrite_loop(tokens, place, edits)
            elif depth:
                _rewrite_comprehension(tokens, place, edits)
        if token.type not in _BLANKS:
            begins = token.type in (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)


def _rewrite_loop(tokens: Sequence[tokenize.TokenInfo], start: int, edits: _Edits) -> None:
    """A statement. At the end of the messages its list grows no more, so that an `else` of it is reached."""
    within, end = _parts(tokens, start, (":",))
    after = [token for token in tokens[end + 1 :][:64] if token.type not in _BLANKS][:2]
    if not within or not end or len(after) < 2 or tokens[within].end[0] != tokens[start].start[0]:
        return
    is_block = [token.type for token in after] == [tokenize.NEWLINE, tokenize.INDENT]
    number, column = tokens[start].start
    indent = after[1].string if is_block else tokens[start].line[:column] + " "
    item, turns = f"_item{number}", f"_turns{number}"
    target = _text(tokens[start + 1 : within])
    edits.put(tokens[start].end, f" {item} in ({turns} := _turns(", tokens[within].end)
    fetching = [
        f"{indent}{item} = _turn({item}, {turns})\n",
        f"{indent}if {item} is _end: continue\n",
        f"{indent}{target} = {item}\n",
    ]
    edits.put(tokens[end].start, "))")
    if is_block:
        edits.before.setdefault(after[1].end[0], []).extend(fetching)
    else:  # its body stands on the same line
        edits.put(tokens[end].end, "".join(["\n", *fetching, indent]), after[0].start)


def _parts(tokens: Sequence[tokenize.TokenInfo], start: int, ends: Sequence[str]) -> tuple[int, int]:
    """The places of `in`, and of what ends the iterable; 0 where there is none."""
    depth = within = 0
    for place in range(start + 1, len(tokens)):
        token = tokens[place]
        if depth == 0 and not within and token.string == "in":
            within = place
        elif depth == 0 and within and token.string in ends:
            return within, place
        if token.type == tokenize.OP:
            depth += (token.string in "([{") - (token.string in ")]}")
        if token.type == tokenize.NEWLINE:
            break
    return within, 0


def _rewrite_comprehension(tokens: Sequence[tokenize.TokenInfo], start: int, edits: _Edits) -> None:
    within, end = _parts(tokens, start, ("for", "if", ")", "]", "}", ","))
    if within and end:
        edits.put(tokens[within].end, " _all(")
        edits.put(tokens[end].start, ")")


def _text(tokens: Sequence[tokenize.TokenInfo]) -> str:
    """A target as it is written, on one line."""
    return "".join(f" {token.string}" for token in tokens if token.type not in (tokenize.NL, tokenize.COMMENT)).strip()
