"""Text from the robot, made fit to be shown."""

from __future__ import annotations

import json
import unicodedata

_INVISIBLE = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


def visible(text: str) -> str:
    """The text with control, invisible and direction-changing characters as escapes, for lines that people read.

    Structured values keep their text exactly; JSON escapes what it must.
    """
    if text.isprintable():
        return text
    return "".join(_escaped(character) for character in text)


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


def _escaped(character: str) -> str:
    if unicodedata.category(character) not in _INVISIBLE:
        return character
    return character.encode("unicode_escape").decode()
