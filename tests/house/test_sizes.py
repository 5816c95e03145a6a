"""Upper bounds on sizes: above them, something holds more than one subject. Below them nothing is measured."""

from __future__ import annotations

from collections import Counter

from support.source import functions, lines_of_code, modules

MOST_LINES_OF_A_FILE = 600
MOST_LINES_OF_A_FUNCTION = 80
LARGEST_SHARE = 0.15
"""Of the server's lines in the modules of one folder; its folders below count for themselves."""


def lengths() -> dict[str, int]:
    return {path: text.count("\n") for path, text in modules().items()}


def test_no_file_is_longer_than_one_subject_needs() -> None:
    assert {path: lines for path, lines in lengths().items() if lines > MOST_LINES_OF_A_FILE} == {}


def test_no_function_is_longer_than_one_thought_needs() -> None:
    long = {name: lines for name, node in functions() if (lines := lines_of_code(node)) > MOST_LINES_OF_A_FUNCTION}
    assert long == {}


def test_no_folder_holds_so_much_that_nothing_is_found_in_it() -> None:
    folders: Counter[str] = Counter()
    for path, lines in lengths().items():
        if path.startswith("src/ros2_mcp/"):
            folders[path.rpartition("/")[0]] += lines
    most = LARGEST_SHARE * folders.total()
    assert {folder: lines for folder, lines in folders.items() if lines > most} == {}
