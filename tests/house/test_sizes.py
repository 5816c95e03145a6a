"""DESIGN: sizes that keep the code readable."""

from __future__ import annotations

import statistics

from support.source import functions, lines_of_code, modules

FORBIDDEN = ("manager", "handler", "helper", "util")


def lengths() -> dict[str, int]:
    return {path: text.count("\n") for path, text in modules().items()}


def test_no_file_is_longer_than_400_lines() -> None:
    assert {path: lines for path, lines in lengths().items() if lines > 400} == {}


def test_half_of_the_files_have_at_most_150_lines() -> None:
    assert statistics.median(lengths().values()) <= 150


def test_no_function_is_longer_than_60_lines() -> None:
    assert {name: lines for name, node in functions() if (lines := lines_of_code(node)) > 60} == {}


def test_half_of_the_functions_have_at_most_8_lines() -> None:
    assert statistics.median(lines_of_code(node) for _, node in functions()) <= 8


def test_modules_are_named_after_what_they_do() -> None:
    words = {path: path.removesuffix(".py").replace("/", "_").split("_") for path in modules()}
    vague = {path for path, parts in words.items() if any(part.rstrip("s") in FORBIDDEN for part in parts)}
    assert vague == set()
