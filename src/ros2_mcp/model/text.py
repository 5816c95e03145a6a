"""Escape text from the robot for display (decision 23).

Operations and errors carry text unchanged. Text is escaped by `visible` once, where it leaves for a model or a person,
and nowhere else: escaping twice would change its meaning. Within a sentence it is `quoted` before.
"""

from __future__ import annotations

import json
import re
import sys
import unicodedata
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

from ros2_mcp.model.finite import finite
from ros2_mcp.model.values import not_finite_text

_HIDDEN_CLASSES = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp", "Zs"})
"""Unicode classes whose characters are invisible, look like a space, or change how others are displayed: control,
format (including direction, joiners and tags), surrogates, private use, unassigned, separators."""

_HIDDEN_RANGES = (
    # Default_Ignorable_Code_Point of Unicode's DerivedCoreProperties, as far as not in a hidden class.
    (0x034F, 0x034F),  # combining grapheme joiner
    (0x115F, 0x1160),  # Hangul fillers
    (0x17B4, 0x17B5),  # Khmer inherent vowels
    (0x180B, 0x180F),  # Mongolian variation selectors
    (0x3164, 0x3164),  # Hangul filler
    (0xFE00, 0xFE0F),  # variation selectors
    (0xFFA0, 0xFFA0),  # halfwidth Hangul filler
    (0xE0000, 0xE0FFF),  # tags, more variation selectors, reserved ones
    # Characters that Unicode counts as visible, but which are drawn as nothing, or as a space.
    (0x2800, 0x2800),  # Braille pattern blank
    (0xFFFC, 0xFFFC),  # object replacement character
    (0x16FE4, 0x16FE4),  # Khitan small script filler
    (0x1D159, 0x1D159),  # musical symbol null notehead
)
_OPEN, _CLOSE = "⟦", "⟧"
_ESCAPE = re.compile(rf"{_OPEN}U\+([0-9A-F]{{4,6}}(?: [0-9A-F]{{4,6}})*){_CLOSE}")
_ESCAPED_CONTROL = re.compile(r"\\(?:u00|b|f|r)|\x7f")
"""A control character other than a new line or a tab in JSON text. Text that only looks like one matches, too, without
harm."""

LAYOUT = "\n\t"
"""Whitespace that visibly structures a text of several lines; kept where it cannot forge a line of ours."""

_MOST_QUOTED = 80
"""Characters of the robot's text within a sentence: about a line. The full text is in the values beside it."""
LOG_LINE = 240
"""Characters of a line of the log, which names node, file and goal before the reason."""
_LINE_BREAKS = re.compile(r"[\n\r\v\f\x1c-\x1e\x85\u2028\u2029]+")
_NAME = re.compile(r"[\w/~.:+\[\]*-]{1,256}", re.ASCII)


def visible(text: str, keep: str = "") -> str:
    """Replace each hidden character by its code, such as `⟦U+202E⟧`, except the characters in `keep`.

    Only the space U+0020 counts as visible space. Several in a row share their brackets: `⟦U+200B 200C⟧`. The brackets
    themselves are escaped too, so that no text can pass for an escape, and `as_sent` is an exact inverse.
    """
    if text.isascii() and text.isprintable():
        return text
    table = {ord(character): _escape(character) for character in set(text) - set(keep) if _is_hidden(character)}
    return text.translate(table).replace(f"{_CLOSE}{_OPEN}U+", " ") if table else text


def as_sent(text: str) -> str:
    """Inverse of `visible`: turn escapes in text from a model back into the robot's original characters.

    Escapes of surrogates or of code points beyond U+10FFFF are left alone, because no text can contain these.
    """
    return _ESCAPE.sub(_as_characters, text) if _OPEN in text else text


def _as_characters(escape: re.Match[str]) -> str:
    codes = [int(code, 16) for code in escape[1].split()]
    if any(code > sys.maxunicode or 0xD800 <= code <= 0xDFFF for code in codes):
        return escape[0]
    return "".join(map(chr, codes))


def visible_json(value: Any) -> tuple[Any, str]:
    """Return a JSON value with all hidden characters in strings and keys escaped, and its compact JSON text.

    New lines and tabs are kept.
    """
    text = _json(value)
    # Searching the text is 20 times as fast as walking through the value, which rarely has hidden characters.
    if not _ESCAPED_CONTROL.search(text) and (text.isascii() or not any(map(_is_hidden, set(text)))):
        return value, text
    value = _visible_value(value)
    return value, _json(value)


def exact_json(value: Any) -> str:
    """Return compact JSON text without hidden characters, which every parser reads as the original value."""
    return with_json_escapes(visible_json(value)[1])


def with_json_escapes(text: str) -> str:
    """Replace our escapes in JSON text by those of JSON: `\\u200d` for `⟦U+200D⟧`.

    Brackets, which `as_sent` would take for an escape, and lone surrogates keep our escapes.
    """
    return _ESCAPE.sub(_as_json_escapes, text) if _OPEN in text else text


def _as_json_escapes(escape: re.Match[str]) -> str:
    codes = [int(code, 16) for code in escape[1].split()]
    return "".join(
        _escape(chr(code)) if 0xD800 <= code <= 0xDFFF or chr(code) in (_OPEN, _CLOSE) else json.dumps(chr(code))[1:-1]
        for code in codes
    )


def quoted(text: str, most: int = _MOST_QUOTED) -> str:
    """Quote text of the robot within a sentence: `«text»`, on one line, cut to `most` characters as shown."""
    line = _LINE_BREAKS.sub(" ⏎ ", text[: 2 * most].strip()).replace("\t", " ")
    line = line.replace("«", "‹").replace("»", "›")
    length = 0
    for place, character in enumerate(line):
        length += len(_escape(character)) if _is_hidden(character) else 1
        if length > most:
            return f"«{line[:place]}…»"
    return f"«{line}…»" if len(text) > 2 * most else f"«{line}»"


def named(name: str) -> str:
    """Return a name of the robot for a sentence: unchanged if it can only be a name, else `quoted`.

    ROS allows nothing else in names, but a recording may contain anything.
    """
    return name if is_name(name) else quoted(name)


def listed(found: Sequence[str], most: int) -> str:
    """List names of the robot for a sentence, each `named`: the first `most`, and how many more there are."""
    more = f" and {len(found) - most} more" if len(found) > most else ""
    return ", ".join(map(named, found[:most])) + more


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a number with its noun: `1 topic`, `2 topics`, `3 bodies`; `plural` for irregular nouns."""
    if number == 1:
        return f"1 {noun}"
    return f"{number} {plural or _plural(noun)}"


def counted_of(shown: int, total: int, noun: str) -> str:
    """Return how many of a total are shown: `2 topics` if it is all of them, else `2 of 30 topics`."""
    return counted(total, noun) if shown == total else f"{shown} of {counted(total, noun)}"


def is_name(text: str) -> bool:
    """Return whether it has only the characters that ROS allows in names, types, field paths and file names."""
    return bool(_NAME.fullmatch(text))


def in_quotes(value: object) -> str:
    """Return a value of the robot for a sentence: numbers unchanged, strings `quoted`, others as quoted JSON."""
    if isinstance(value, str):
        return quoted(value)
    return _json(value) if value is None or isinstance(value, (bool, int, float)) else quoted(_json(value))


def excerpt(value: object, most: int = 60) -> str:
    """Return a value as short JSON-like text for a message."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = f"a Python {type(value).__name__}"
    return text if len(text) <= most else text[: most - 1] + "…"


def is_unicode(text: str) -> bool:
    """Return whether it has no lone surrogates, from invalid UTF-8 or from half a character."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def escaped_bytes(text: str) -> str:
    """Return the text with `\\xb0` for each byte that was not UTF-8."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


@lru_cache(maxsize=4096)  # more than the alphabets of one robot
def _is_hidden(character: str) -> bool:
    if character.isascii():
        return not character.isprintable()
    code = ord(character)
    return (
        unicodedata.category(character) in _HIDDEN_CLASSES
        or character in (_OPEN, _CLOSE)
        or any(first <= code <= last for first, last in _HIDDEN_RANGES)
    )


def _plural(noun: str) -> str:
    if noun.endswith(("s", "x", "z", "ch", "sh")):
        return f"{noun}es"
    return f"{noun[:-1]}ies" if noun.endswith("y") and noun[-2] not in "aeiou" else f"{noun}s"


def _escape(character: str) -> str:
    return f"{_OPEN}U+{ord(character):04X}{_CLOSE}"


def _visible_value(value: Any) -> Any:
    if isinstance(value, str):
        return visible(value, keep=LAYOUT)
    if isinstance(value, Mapping):
        fields = cast("Mapping[str, Any]", value)
        return {visible(name, keep=LAYOUT): _visible_value(below) for name, below in fields.items()}
    if isinstance(value, Sequence):
        return [_visible_value(item) for item in cast("Sequence[Any]", value)]
    return value


def _json(value: Any) -> str:
    try:
        return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    except ValueError:  # NaN or infinity, which JSON does not have: as shown and accepted elsewhere
        return json.dumps(finite(value, not_finite_text), ensure_ascii=False, separators=(",", ":"))
