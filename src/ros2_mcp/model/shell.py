"""Join and split shell commands."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence


def typed(words: Sequence[str]) -> str:
    """Join words to a command for the shell of this system."""
    if sys.platform == "win32":
        from subprocess import list2cmdline

        return list2cmdline(words)
    return shlex.join(words)


def words_of(text: str) -> tuple[str, ...]:
    """Split a shell command into words; on Windows a backslash is part of a path. Raises `ValueError`."""
    lexer = shlex.shlex(text, posix=True, punctuation_chars=False)
    lexer.whitespace_split = True
    lexer.commenters = ""
    if sys.platform == "win32":
        lexer.escape = ""
    return tuple(lexer)
