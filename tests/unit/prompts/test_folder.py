"""The user's Markdown files: what they may say, and what is told of their mistakes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from ros2_mcp.cli import run
from ros2_mcp.prompts.prompt import Prompt

PATROL = """---
name: patrol
title: Patrol
description: Drive around
arguments:
  - name: rounds
    description: How often
    type: integer
    default: 3
    minimum: 1
  - name: mode
    choices: [slow, fast]
    default: slow
  - name: topic
    type: topic
    required: true
---
Drive {{rounds}} rounds, {{mode}}.
1. Call ros2_topic_list with {"pattern": {{topic|json}}}
"""


async def text_of(prompt: Prompt, **given: str) -> str:
    return "".join(message.text for message in await prompt.messages(given))


async def test_a_file_is_a_prompt(make_folder: Callable) -> None:
    folder, told = make_folder({"any.md": PATROL, "README.md": "# no prompt", "notes.txt": "no prompt"})
    [prompt] = folder.prompts()
    assert (prompt.name, prompt.title, prompt.description) == ("patrol", "Patrol", "Drive around")
    assert (await text_of(prompt, topic="scan", mode="fast")).splitlines() == [
        "Drive 3 rounds, fast.",
        '1. Call ros2_topic_list with {"pattern": "/scan"}',
    ]
    assert told == []


def test_the_name_is_the_files_where_none_is_given(make_folder: Callable) -> None:
    folder, _ = make_folder({"say-hello.md": "---\ndescription: x\n---\nHello."})
    assert [prompt.name for prompt in folder.prompts()] == ["say-hello"]


@pytest.mark.parametrize(
    ("text", "line", "complaint"),
    [
        ("Hello.", 1, "must start with a line of ---"),
        ("---\nname: x\nHello.", 1, "no end"),
        ("---\nname: x\n---\n", 2, "no text"),
        ("---\n- x\n---\nHi", 2, "lines like 'name: value'"),
        ("---\nname: x\n  title: [y\n---\nHi", 3, "Not valid YAML"),
        ("---\nname: x\nname: y\n---\nHi", 3, "name is there twice"),
        ("---\nname: no spaces please\n---\nHi", 2, "is not a name"),
        ("---\nname: x\ndescripton: y\n---\nHi", 3, "Did you mean description?"),
        ("---\nname: x\narguments: y\n---\nHi", 3, "must be a list"),
        ("---\nname: x\narguments:\n  - y\n---\nHi", 4, "lines like 'name: value'"),
        ("---\nname: x\narguments:\n  - name: a\n    type: nubmer\n---\nHi", 5, "Did you mean number?"),
        ("---\nname: x\narguments:\n  - name: a\n    required: often\n---\nHi", 5, "true or false"),
        ("---\nname: x\narguments:\n  - name: a\n    type: number\n    default: b\n---\nHi", 6, "Give a number"),
        ("---\nname: x\narguments:\n  - name: a\n    choices: [b]\n    default: c\n---\nHi", 6, "one of b"),
        ("---\nname: x\narguments:\n  - name: a\n    choices: b\n---\nHi", 5, "choices must be a list"),
        ("---\nname: x\narguments:\n  - name: a\n    minimum: b\n---\nHi", 5, "must be a number"),
        ("---\nname: x\narguments:\n  - name: a\n  - name: a\n---\nHi", 5, "given twice"),
        ("---\nname: x\narguments:\n  - type: number\n---\nHi", 4, "is not an argument name"),
        ("---\nname: x\narguments: &a\n  - <<: *a\n---\nHi", 4, "means nothing here"),
        ("---\nname: x\narguments:\n  - ? [a]\n    : b\n---\nHi", 4, "must be a string"),
        ("---\n" + "[" * 3000 + "\n---\nHi", 2, "Not valid YAML"),
        ("---\n---\nHi", 2, "lines like 'name: value'"),
    ],
)
def test_a_bad_front_matter_is_told_by_file_and_line(
    make_folder: Callable, tmp_path: Path, text: str, line: int, complaint: str
) -> None:
    folder, told = make_folder({"bad.md": text, "good.md": PATROL})
    assert [prompt.name for prompt in folder.prompts()] == ["patrol"]
    [mistake] = told
    assert str(mistake).startswith(f"{tmp_path / 'bad.md'}:{line}: ")
    assert complaint in mistake.text


def test_mistakes_in_the_text_are_told_and_the_prompt_is_offered(make_folder: Callable) -> None:
    text = PATROL + "{{rouns}}\n2. Call ros2_topic_lst with {}\n"
    folder, told = make_folder({"patrol.md": text}, tools=frozenset({"ros2_topic_list"}))
    assert len(folder.prompts()) == 1
    assert [(mistake.line, mistake.text.split("Did you mean ")[1]) for mistake in told] == [
        (20, "rounds?"),
        (21, "ros2_topic_list?"),
    ]


def test_a_name_is_given_once_and_not_one_of_the_base_prompts(make_folder: Callable) -> None:
    files = {"a.md": PATROL, "b.md": PATROL.replace("Drive around", "Other"), "c.md": PATROL.replace(": patrol", ": t")}
    folder, told = make_folder(files, taken=frozenset({"t"}))
    assert [prompt.description for prompt in folder.prompts()] == ["Drive around"]
    assert [(Path(mistake.where).name, mistake.line) for mistake in told] == [("b.md", 2), ("c.md", 2)]


async def test_a_changed_file_is_read_again_and_mistakes_are_told_once(make_folder: Callable, tmp_path: Path) -> None:
    folder, told = make_folder({"a.md": PATROL, "b.md": "no prompt"})
    assert not folder.has_news()  # nobody has asked yet
    assert len(folder.prompts()) == 1
    (tmp_path / "a.md").write_text(PATROL.replace("default: 3", "default: 5"))
    os.utime(tmp_path / "a.md", ns=(1, 1))
    assert [folder.has_news(), folder.has_news()] == [True, False]
    assert "5 rounds" in await text_of(folder.prompts()[0], topic="/x")
    (tmp_path / "a.md").unlink()
    assert list(folder.prompts()) == []
    assert len(told) == 1


def test_files_that_are_no_text_and_folders_that_are_not_there_are_told(make_folder: Callable, tmp_path: Path) -> None:
    folder, told = make_folder({})
    (tmp_path / "a.md").write_bytes(b"---\n\xff\xfe\n---\n")
    assert list(folder.prompts()) == []
    assert "UTF-8" in told[0].text
    folder.path = tmp_path / "nowhere"
    assert list(folder.prompts()) == []
    assert "no such folder" in told[1].text


def test_the_check_lists_prompts_and_mistakes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.md").write_text(PATROL)
    assert run(["prompts", "check", str(tmp_path)]) == 0
    assert capsys.readouterr().out == "patrol (rounds, mode, topic)\n"
    (tmp_path / "b.md").write_text(PATROL)
    assert run(["prompts", "check", str(tmp_path)]) == 1
    assert f"{tmp_path / 'b.md'}:2: The name patrol is already taken." in capsys.readouterr().out
