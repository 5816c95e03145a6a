"""Text from the robot, made fit to be shown."""

from __future__ import annotations

import json
import unicodedata

_INVISIBLE = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""The classes of Unicode whose characters cannot be seen, or change how others are seen: control, format (among them
direction and tags), surrogates, private use, unassigned, line and paragraph separators. Spaces (Zs) are seen."""


def visible(text: str, keep: str = "") -> str:
    """The text with its control and invisible characters as escapes; those in `keep` stay as they are.

    The one function for this: whatever shows text of a robot (or of another program) to a model or a person uses it.
    In JSON the escapes mean the same characters, as JSON itself escapes the control characters below U+0020.
    """
    if text.isprintable():
        return text
    table = {ord(character): _escape(character) for character in set(text) - set(keep) if _is_invisible(character)}
    return text.translate(table) if table else text


def _is_invisible(character: str) -> bool:
    return unicodedata.category(character) in _INVISIBLE


def _escape(character: str) -> str:
    """`\\n`, `\\x1b`, `\\u202e`; beyond U+FFFF as JSON writes it, in two halves."""
    if character < " ":
        return character.encode("unicode_escape").decode()
    return json.dumps(character)[1:-1]


def excerpt(value: object, most: int = 60) -> str:
    """A value as short JSON-like text for a message."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = f"a Python {type(value).__name__}"
    return visible(text if len(text) <= most else text[: most - 1] + "…")


def is_unicode(text: str) -> bool:
    """Whether it has no lone surrogates: neither bytes that were not UTF-8, nor halves of a character."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def escaped_bytes(text: str) -> str:
    """The text with `\\xb0` for each byte that was not UTF-8."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
