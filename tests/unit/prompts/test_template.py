from __future__ import annotations

import pytest

from ros2_mcp.prompts.template import fill, mistakes_of


@pytest.mark.parametrize(
    "text",
    [
        '{"a": {"b": {}}}',
        "{x} {{ x y }} {{{}}} {{x.y}} ${{ github.ref }} {{unknown}} {% if x %}",
        "printf('%s {{}}', \\{\\{)",
        "{{/if}} in a sentence, {{#if x}} too",
    ],
)
def test_braces_that_are_no_placeholders_stay(text: str) -> None:
    assert fill(text, {"x": 1}) == text


def test_placeholders_become_values_or_json() -> None:
    values = {"name": 'a "b"', "many": ["/a", "/b"], "n": 2.0}
    assert fill("{{name}} {{ n }} {{many}}", values) == 'a "b" 2 /a, /b'
    assert fill('{"t": {{many | json}}, "s": {{name|json}}}', values) == '{"t": ["/a", "/b"], "s": "a \\"b\\""}'


def test_what_a_value_brings_along_is_not_replaced_again() -> None:
    assert fill("{{a}}", {"a": "{{b}}", "b": "secret"}) == "{{b}}"


@pytest.mark.parametrize(
    ("back", "land", "left"), [(True, True, "a b d"), (True, False, "a b c d"), (False, True, "a d")]
)
def test_lines_stay_only_where_their_conditions_hold(back: bool, land: bool, left: str) -> None:
    text = "a\n{{#if back}}\nb\n{{#if not land}}\nc\n{{/if}}\n{{/if}}\nd"
    assert fill(text, {"back": back, "land": land}).split() == left.split()


def test_mistakes_have_their_lines() -> None:
    found = list(mistakes_of("ok {{speed}}\n{{sped}}\n{{#if no}}\n{{/if}}\n{{/if}}\n{{#if speed}}", {"speed"}))
    assert [line for line, _ in found] == [1, 2, 4, 5]
    assert "Did you mean speed?" in found[0][1]
