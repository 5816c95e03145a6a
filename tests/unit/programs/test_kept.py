"""Kept programs: a folder of Markdown that people and agents write."""

import re

import pytest

from ros2_mcp.model.arguments import Argument
from ros2_mcp.model.errors import BadData, BadInput, NotFound, RobotError
from ros2_mcp.programs.kept import FORMER, MAX_BYTES, KeptProgram, KeptPrograms, parse, text_of

CODE = 'import robot\nprint(robot.topics())\nprint("```")\n'


@pytest.fixture
def kept(tmp_path):
    return KeptPrograms(tmp_path / "programs")


def program(name="look", code=CODE, description="Looks around", **more):
    return KeptProgram(name=name, description=description, code=code, **more)


def by_hand(kept, name, text):
    kept.folder.mkdir(exist_ok=True)
    (kept.folder / f"{name}.md").write_text(text, encoding="utf-8")


def test_what_is_saved_is_found_and_listed_with_its_inputs(kept):
    inputs = (
        Argument("topic", "Which one", "topic", required=True),
        Argument("distance_m", "How far: at most", "number", default=0.5, minimum=0.1, maximum=3),
        Argument("back", "And back", "boolean", default=True),
        Argument("sides", "", "list", default=["left", "right"]),
        Argument("poses", "", "json", default=[[1, 2.5], {"x": None}]),
        Argument("speed", "", choices=("slow", "fast"), default="slow"),
        Argument("word", 'with "quotes", # and: colons', default="yes: no # 'x'"),
    )
    saved, _ = kept.save(program(inputs=inputs, saved="2026-11-22T21:00:00Z", by="agent 1"), overwrite=False)
    assert kept.find("look") == saved == program(inputs=inputs, saved="2026-11-22T21:00:00Z", by="agent 1")
    assert kept.all() == ([saved], [])
    assert list(kept.folder.iterdir()) == [kept.folder / "look.md"]


def test_hostile_texts_stay_texts(kept):
    odd = 'a\n---\ndescription: other\n```python\nevil()\n``` "x"\t\\ \u202e é'
    saved, _ = kept.save(program(description=odd, by=odd, inputs=[Argument("a", odd, default=odd)]), overwrite=False)
    assert saved.code == CODE
    assert saved.description == " ".join(odd.split())
    assert (saved.by, saved.inputs[0].description, saved.inputs[0].default) == (odd, odd, odd)


def test_code_with_any_fence_comes_back_as_it_was(kept):
    code = 'text = """\n````python\n```\n`````\n"""\n'
    assert kept.save(program(code=code), overwrite=False)[0].code == code


def test_one_of_that_name_is_replaced_only_if_that_is_said_and_then_stays_as_a_former_version(kept):
    kept.save(program(), overwrite=False)
    with pytest.raises(BadInput, match=r"version 1.*Looks around"):
        kept.save(program(code="1\n"), overwrite=False)
    assert kept.save(program(code="2\n"), overwrite=True)[0].version == 2
    assert kept.save(program(code="3\n"), overwrite=True)[0].version == 3
    former = sorted((kept.folder / FORMER).iterdir())
    assert [path.name for path in former] == ["look.v1.md", "look.v2.md"]
    assert "robot.topics()" in former[0].read_text()
    assert [each.code for each in kept.all()[0]] == ["3\n"]


def test_only_the_last_twenty_former_versions_are_kept(kept):
    for number in range(25):
        kept.save(program(code=f"{number}\n"), overwrite=True)
    assert len(list((kept.folder / FORMER).iterdir())) == 20
    assert (kept.folder / FORMER / "look.v24.md").exists()


def test_what_is_removed_can_be_taken_back_by_hand_and_never_gives_its_version_away(kept):
    kept.save(program(), overwrite=False)
    kept.remove("look")
    assert kept.all() == ([], [])
    assert kept.save(program(), overwrite=False)[0].version == 2
    with pytest.raises(NotFound, match="no kept program"):
        kept.remove("gone")


@pytest.mark.parametrize("name", ["", "..", "../x", "a/b", ".hidden", "a.b", "x" * 65, "a b", "README", "ä", "a\n"])
def test_a_name_leads_nowhere_else(kept, name):
    with pytest.raises(BadInput, match="not a valid name for a program"):
        kept.save(program(name), overwrite=False)
    assert not kept.folder.exists()
    with pytest.raises(NotFound):
        kept.find(name)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("print(1)\n", "front matter"),
        ("---\ndescription: a\n---\nno code\n", "There is no program"),
        ("---\ndescription: a\n---\n```python\n1\n```\n```python\n2\n```\n", "Two programs"),
        ("---\nversion: 1\n---\n```python\n1\n```\n", "There is no description"),
        ("---\ndescription: a\nversion: x\n---\n```python\n1\n```\n", "x.md:3: version must be a number"),
        ("---\ndescription: a\ncolour: red\n---\n```python\n1\n```\n", "x.md:3: 'colour' means nothing here"),
        ("---\ndescription: a\ninputs:\n  - name: b\n    type: nmber\n---\n```python\n1\n```\n", "x.md:5: 'nmber'"),
        ("a" * (MAX_BYTES + 1), "longer than"),
        ("---\ndescription: a\nversion: .inf\n---\n```python\n1\n```\n", "version must be a number"),
        ("---\ndescription: a\nversion: -3\n---\n```python\n1\n```\n", "version must be a number"),
    ],
)
def test_a_file_that_is_no_program_says_so_and_is_never_overwritten(kept, text, problem):
    by_hand(kept, "x", text)
    by_hand(kept, "fine", text_of(program("fine")))
    programs, mistakes = kept.all()
    assert [each.name for each in programs] == ["fine"]
    assert problem in str(mistakes[0])
    with pytest.raises(BadData, match=r"x\.md"):
        kept.find("x")
    with pytest.raises(BadData, match="not overwritten"):
        kept.save(program("x"), overwrite=True)


def test_a_program_written_by_hand_needs_a_description_and_code_only(kept):
    by_hand(
        kept, "hello", "---\ndescription: Says hello\n---\n# Hello\n\nSome words.\n\n```python\nprint(1)\n```\nMore.\n"
    )
    assert kept.find("hello") == program("hello", "print(1)\n", "Says hello")


def test_a_folder_of_none_has_none_and_says_how_to_have_one():
    none = KeptPrograms(None)
    assert none.all() == ([], [])
    with pytest.raises(RobotError, match="keeps no programs"):
        none.save(program(), overwrite=False)


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RobotError, match="cannot be written"):
        KeptPrograms(tmp_path / "file").save(program(), overwrite=False)


INPUTS = [
    Argument("topic", "Which", "topic", required=True),
    Argument("count", "How many", "integer", default=3, maximum=10),
    Argument("fast", "", "boolean", default=False),
    Argument("poses", "", "json"),
    Argument("bag", ""),
]


async def test_a_name_alone_runs_the_kept_program_with_checked_inputs(kept):
    kept.save(program(inputs=INPUTS), overwrite=False)
    code, inputs = await kept.resolve("look", {"topic": "scan", "count": 5, "fast": True, "poses": [[1, 2]]})
    assert code == CODE
    assert inputs == {"topic": "/scan", "count": 5, "fast": True, "poses": [[1, 2]], "bag": ""}
    assert (await kept.resolve("look", {"topic": "/scan"}))[1] == {
        "topic": "/scan",
        "count": 3,
        "fast": False,
        "poses": None,
        "bag": "",
    }


async def test_anything_else_is_a_program_itself(kept):
    assert await kept.resolve("print(1)", {"any": [1]}) == ("print(1)", {"any": [1]})
    with pytest.raises(NotFound, match="lok"):
        await kept.resolve("lok", {})


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({}, "needs the input topic"),
        ({"topic": "/a", "cuont": 1}, "no input 'cuont'.*count"),
        ({"topic": "/a", "count": 11}, "at most 10"),
        ({"topic": "/a", "count": 1.5}, "whole number"),
        ({"topic": "/a", "fast": "perhaps"}, "true or false"),
        ({"topic": 5}, "name of a topic"),
    ],
)
async def test_a_wrong_input_is_named(kept, given, problem):
    kept.save(program(inputs=INPUTS), overwrite=False)
    with pytest.raises(BadInput) as caught:
        await kept.resolve("look", given)
    assert re.search(problem, f"{caught.value.message} {caught.value.hint}")


def test_windows_line_ends_change_nothing(tmp_path):
    KeptPrograms(tmp_path)
    (tmp_path / "look.md").write_bytes(text_of(program()).replace("\n", "\r\n").encode())
    assert KeptPrograms(tmp_path).find("look") == program()


def test_the_file_reads_like_a_page(tmp_path):
    text = text_of(program(code="print(1)\n", inputs=(Argument("a", "An a", "number", default=2.0),), by="me"))
    assert text == (
        '---\ndescription: "Looks around"\ninputs:\n  - name: a\n    type: number\n    description: "An a"\n'
        '    default: 2.0\nversion: 1\nby: "me"\n---\n\n```python\nprint(1)\n```\n'
    )
    assert parse(tmp_path, "look", text) == program(
        code="print(1)\n", inputs=(Argument("a", "An a", "number", default=2.0),), by="me"
    )
