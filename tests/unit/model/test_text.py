"""Text of a robot is shown so that nothing in it is hidden."""

import json
import unicodedata

from ros2_mcp.model.text import visible


def test_what_people_can_see_stays_as_it_is() -> None:
    for text in ("Grüße, 漢字 😀", "a\u00a0b", "\u2009", "e\u0301", ""):
        assert visible(text) == text


def test_every_character_that_cannot_be_seen_is_escaped() -> None:
    hidden = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
    for code in (*range(0x3000), 0xD83D, 0xE000, 0xFEFF, 0xFFFE, 0xE0041, 0x10FFFF):
        character = chr(code)
        assert (visible(character) == character) == (unicodedata.category(character) not in hidden), hex(code)
        assert not any(unicodedata.category(shown) in hidden for shown in visible(character))


def test_escapes_in_json_mean_the_same() -> None:
    text = "\x00\x1b\x7f\x85\u00ad\u202e\u2066\ufeff\ue000\U000e0041\u2028\n"
    shown = visible(json.dumps(text, ensure_ascii=False))
    assert shown.isprintable() and json.loads(shown) == text


def test_what_is_to_be_kept_stays() -> None:
    assert visible("a\n\tb\r\x1b", keep="\n\t") == "a\n\tb\\r\\x1b"
