"""What is promised is quoted by the tests that hold it, in words that still stand there."""

from __future__ import annotations

from pathlib import Path

import pytest
from generate import served_tools
from promises import PROMISES, Mark, Sentence, all_sentences, fault_of, faults, marks, marks_of, promises, sentences

PAGE = """\
# Title

## Safety

* **What is written** is read [again](there.md). One *word* is
  wrapped; `so` is this (not; this).
* A second item.

```sh
no sentence
```

| what | then |
| --- | --- |
| a. It | b |
"""


def test_every_mark_quotes_a_promise_that_still_stands_there() -> None:
    found = faults(all_sentences(served_tools()), marks())
    assert not found, "\n" + "\n".join(found)


def test_the_page_of_promises_is_up_to_date() -> None:
    assert PROMISES.read_text(encoding="utf-8") == promises(served_tools()), "run: python docs/generate.py, and commit"


def test_a_page_is_read_by_its_sentences_items_and_rows() -> None:
    assert [(said.section, said.text) for said in sentences("README", PAGE)] == [
        ("Safety", "**What is written** is read [again](there.md)."),
        ("Safety", "One *word* is wrapped;"),
        ("Safety", "`so` is this (not; this)."),
        ("Safety", "A second item."),
        ("Safety", "a. It: b"),
    ]


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        ("What is written is read again", ""),
        ("is wrapped", ""),
        ("is", "3 sentences of page have the words 'is'. Quote more of one."),
        (
            "What is written is forgotten",
            "Nearest: 'What is written is read again.'. If the test holds that too, quote",
        ),
    ],
)
def test_a_mark_that_quotes_no_single_promise_is_told_how_to_mend_it(words: str, fault: str) -> None:
    mark = Mark(path="test_x.py", line=3, test="test_x", source="page", words=words, is_long=False)
    found = fault_of(mark, list(sentences("page", PAGE)))
    assert fault in found and bool(fault) == bool(found)


def test_a_mark_of_a_source_that_there_is_not_is_told() -> None:
    mark = Mark(path="test_x.py", line=3, test="test_x", source="ros2_nothing", words="It stops.", is_long=False)
    assert "'ros2_nothing' is no source" in fault_of(mark, [Sentence("README", "", "It stops.")])


def test_marks_are_found_on_tests_and_beside_them_for_the_whole_file(tmp_path: Path) -> None:
    file = tmp_path / "test_x.py"
    file.write_text(
        'pytestmark = [pytest.mark.full, pytest.mark.promise("README", "all")]\n\n\n'
        '@pytest.mark.promise("stopping", "one")\nasync def test_a(): ...\n'
    )
    assert [(mark.test, mark.source, mark.words, mark.is_long) for mark in marks_of(file)] == [
        ("", "README", "all", True),
        ("test_a", "stopping", "one", True),
    ]
