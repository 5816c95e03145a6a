"""Rewrites programs for the sandbox, which cannot wait for the robot within the iterator of a `for` loop.

A loop over messages becomes a loop over a list that grows with every turn. The first line of its body requests the next
message: there, the sandbox can wait. `Rewritten.line` maps the shifted line numbers back.
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
"""Runs in the sandbox before the program. Its value is the list of objects that represent streams of messages there."""

_AWAIT = re.compile(r"\bawait[ \t]+(?=robot\.)")
_ASYNC_FOR = re.compile(r"\basync[ \t]+(?=for\b)")
_BLANKS = (tokenize.NL, tokenize.COMMENT)
_DEEPEST = 60
"""The deepest nesting of brackets, and of blocks: programs that people can read have less."""


@dataclass(frozen=True, slots=True)
class Rewritten:
    """A program for the sandbox. `lines` has, for each of its lines, the line number in the original."""

    text: str
    lines: Sequence[int]

    def line(self, number: int) -> int:
        """Return the line in the original, counted from 1; 0 if there is none."""
        return self.lines[number - 1] if 0 < number <= len(self.lines) else 0


@dataclass(slots=True)
class _Edits:
    """Edits of a program: within a line (from column, to column, new text), and lines to insert before a line."""

    within: dict[int, list[tuple[int, int, str]]] = field(default_factory=dict[int, list[tuple[int, int, str]]])
    before: dict[int, list[str]] = field(default_factory=dict[int, list[str]])

    def put(self, at: tuple[int, int], new: str, end: tuple[int, int] | None = None) -> None:
        """Insert text at a place, replacing the text up to `end` on the same line."""
        self.within.setdefault(at[0], []).append((at[1], (end or at)[1], new))


def without_async(text: str) -> str:
    """Return the program without `await` before functions of the robot and `async` before `for`: models often write
    them, but they are not needed.
    """
    return _ASYNC_FOR.sub("", _AWAIT.sub("", text))


def rewritten(text: str) -> Rewritten:
    """Return the program with its loops rewritten so that they can wait for messages.

    Raises:
        BadInput: with the line, if the text is not Python.
    """
    text = without_async(text)
    lines = text.splitlines(keepends=True)
    tokens = tokens_of(text)
    edits = _Edits()
    if any(token.string in ("messages", "feedback") for token in tokens):  # otherwise there is nothing to wait for
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
    """Return the tokens of a program. Raises `BadInput` with the line if it is not Python, or nested too deep."""
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
    """Wrap the iterable of each `for`, and fetch the message in the first line of its body."""
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
    """Rewrite a `for` statement. After the last message its list stops growing, so that an `else` is still reached."""
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
    else:  # the body is on the same line
        edits.put(tokens[end].end, "".join(["\n", *fetching, indent]), after[0].start)


def _parts(tokens: Sequence[tokenize.TokenInfo], start: int, ends: Sequence[str]) -> tuple[int, int]:
    """Return the indices of the token `in` and of the token that ends the iterable; 0 for a missing token."""
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
    """Return the source of a loop's target, on one line."""
    return "".join(f" {token.string}" for token in tokens if token.type not in (tokenize.NL, tokenize.COMMENT)).strip()
