"""Text from the robot, made fit to be shown (decision 23).

Operations and errors carry text as it is. Where it leaves for a model or a person, and nowhere else, it goes through
`visible`, once: what is escaped twice says something else. Within a sentence it is `quoted` before.
"""

from __future__ import annotations

import json
import re
import sys
import unicodedata
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

_HIDDEN_CLASSES = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp", "Zs"})
"""The classes of Unicode whose characters cannot be seen, cannot be told from a space, or change how others are seen:
control, format (among them direction, joiners and tags), surrogates, private use, unassigned, separators."""

_HIDDEN_RANGES = (
    # Default_Ignorable_Code_Point of Unicode's DerivedCoreProperties, what of it is of no hidden class.
    (0x034F, 0x034F),  # combining grapheme joiner
    (0x115F, 0x1160),  # Hangul fillers
    (0x17B4, 0x17B5),  # Khmer inherent vowels
    (0x180B, 0x180F),  # Mongolian variation selectors
    (0x3164, 0x3164),  # Hangul filler
    (0xFE00, 0xFE0F),  # variation selectors
    (0xFFA0, 0xFFA0),  # halfwidth Hangul filler
    (0xE0000, 0xE0FFF),  # tags, more variation selectors, reserved ones
    # What Unicode counts as seen, but is drawn as nothing, or as a space.
    (0x2800, 0x2800),  # Braille pattern blank
    (0xFFFC, 0xFFFC),  # object replacement character
    (0x16FE4, 0x16FE4),  # Khitan small script filler
    (0x1D159, 0x1D159),  # musical symbol null notehead
)
_OPEN, _CLOSE = "⟦", "⟧"
_ESCAPE = re.compile(rf"{_OPEN}U\+([0-9A-F]{{4,6}}(?: [0-9A-F]{{4,6}})*){_CLOSE}")
_ESCAPED_CONTROL = re.compile(r"\\(?:u00|b|f|r)|\x7f")
"""A control character other than a new line or a tab in JSON text; or what only looks like one, which does no harm."""

LAYOUT = "\n\t"
"""What structures a text of several lines and is seen to do so; kept where no line of ours can be forged with it."""

_MOST_QUOTED = 80
"""Characters of the robot's text within a sentence: about a line. The whole of it stands in the values beside it."""
_LINE_BREAKS = re.compile(r"[\n\r\v\f\x1c-\x1e\x85\u2028\u2029]+")
_NAME = re.compile(r"[\w/~.:+\[\]*-]{1,256}", re.ASCII)


def visible(text: str, keep: str = "") -> str:
    """The text with each hidden character as its code, such as `⟦U+202E⟧`; those in `keep` stay as they are.

    Only the space U+0020 is a space. Several in a row share their brackets: `⟦U+200B 200C⟧`. The brackets themselves
    are escaped too, so that no text can be taken for an escape, and `as_sent` gives exactly the text back.
    """
    if text.isascii() and text.isprintable():
        return text
    table = {ord(character): _escape(character) for character in set(text) - set(keep) if _is_hidden(character)}
    return text.translate(table).replace(f"{_CLOSE}{_OPEN}U+", " ") if table else text


def as_sent(text: str) -> str:
    """The text that `visible` made this of: what a model was shown and sends back is the robot's own text again.

    An escape of what is no character (a surrogate, or beyond U+10FFFF) stays as it is: no text could carry it.
    """
    return _ESCAPE.sub(_as_characters, text) if _OPEN in text else text


def _as_characters(escape: re.Match[str]) -> str:
    codes = [int(code, 16) for code in escape[1].split()]
    if any(code > sys.maxunicode or 0xD800 <= code <= 0xDFFF for code in codes):
        return escape[0]
    return "".join(map(chr, codes))


def visible_json(value: Any) -> tuple[Any, str]:
    """A JSON value whose texts and keys are all visible (new lines and tabs stay), and the compact JSON text of it."""
    text = _json(value)
    # Looking at the text is 20 times as fast as walking through the value, which hardly ever has something to hide.
    if not _ESCAPED_CONTROL.search(text) and (text.isascii() or not any(map(_is_hidden, set(text)))):
        return value, text
    value = _visible_value(value)
    return value, _json(value)


def exact_json(value: Any) -> str:
    """A JSON value as compact JSON text that hides nothing, and that every parser reads as the value itself."""
    return with_json_escapes(visible_json(value)[1])


def with_json_escapes(text: str) -> str:
    """JSON text of what was made visible, with the escapes of JSON in place of ours: `\\u200d` for `⟦U+200D⟧`.

    What JSON cannot say keeps ours: the brackets, which `as_sent` would take for an escape, and halves of a character.
    """
    return _ESCAPE.sub(_as_json_escapes, text) if _OPEN in text else text


def _as_json_escapes(escape: re.Match[str]) -> str:
    codes = [int(code, 16) for code in escape[1].split()]
    return "".join(
        _escape(chr(code)) if 0xD800 <= code <= 0xDFFF or chr(code) in (_OPEN, _CLOSE) else json.dumps(chr(code))[1:-1]
        for code in codes
    )


def quoted(text: str, most: int = _MOST_QUOTED) -> str:
    """Text of the robot within a sentence of ours: `«text»`, on one line, cut to `most` characters as shown."""
    line = _LINE_BREAKS.sub(" ⏎ ", text[: 2 * most].strip()).replace("\t", " ")
    line = line.replace("«", "‹").replace("»", "›")
    length = 0
    for place, character in enumerate(line):
        length += len(_escape(character)) if _is_hidden(character) else 1
        if length > most:
            return f"«{line[:place]}…»"
    return f"«{line}…»" if len(text) > 2 * most else f"«{line}»"


def named(name: str) -> str:
    """A name of the robot within a sentence: as it is where it can only be a name, else `quoted`.

    ROS allows nothing else in names, but a recording may have anything.
    """
    return name if is_name(name) else quoted(name)


def listed(found: Sequence[str], most: int) -> str:
    """Names of the robot within a sentence, each `named`: the first ones, and how many more there are."""
    more = f" and {len(found) - most} more" if len(found) > most else ""
    return ", ".join(map(named, found[:most])) + more


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """A number beside its noun: `1 topic`, `2 topics`, `3 bodies`; `plural` where no rule here gives it."""
    if number == 1:
        return f"1 {noun}"
    return f"{number} {plural or _plural(noun)}"


def is_name(text: str) -> bool:
    """Whether it has only the characters that ROS allows in names, types, paths of fields and names of files."""
    return bool(_NAME.fullmatch(text))


def in_quotes(value: object) -> str:
    """A value of the robot within a sentence: numbers as they are, texts `quoted`, lists and objects as quoted JSON."""
    if isinstance(value, str):
        return quoted(value)
    return _json(value) if value is None or isinstance(value, (bool, int, float)) else quoted(_json(value))


def excerpt(value: object, most: int = 60) -> str:
    """A value as short JSON-like text for a message."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = f"a Python {type(value).__name__}"
    return text if len(text) <= most else text[: most - 1] + "…"


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
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
