"""Commands as one types them."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence


def typed(words: Sequence[str]) -> str:
    """The words as one types them in the shell of this system."""
    if sys.platform == "win32":
        from subprocess import list2cmdline

        return list2cmdline(words)
    return shlex.join(words)


def words_of(text: str) -> tuple[str, ...]:
    """The words of a command as one types them; on Windows a backslash is part of a path. Raises `ValueError`."""
    lexer = shlex.shlex(text, posix=True, punctuation_chars=False)
    lexer.whitespace_split = True
    lexer.commenters = ""
    if sys.platform == "win32":
        lexer.escape = ""
    return tuple(lexer)
