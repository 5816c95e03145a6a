"""Programs kept by tools, and kept programs as prompts."""

from dataclasses import replace

import pytest

from ros2_mcp.commands.doctor import programs_here
from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.model.errors import BadInput
from ros2_mcp.programs import sandbox
from ros2_mcp.prompts.catalog import Catalog
from ros2_mcp.settings import Settings

CODE = "import robot\nprint(robot.topics(pattern=topic))\n"
INPUTS = [
    {"name": "topic", "type": "topic", "required": True, "description": "Which"},
    {"name": "poses", "type": "json", "default": [[1, 2.5]]},
    {"name": "count", "type": "integer", "default": 3, "minimum": 1},
]


async def silent(*_: object) -> None:
    """Progress that nobody asked for."""


@pytest.fixture
def settings(tmp_path):
    return Settings(tools=("all",), programs=tmp_path / "programs", record_dir=tmp_path / "recordings")


@pytest.fixture
def made(settings):
    return assemble(settings)


async def call(made, tool, **arguments):
    result = await made.toolset.call(tool, arguments, silent)
    return "\n".join(part.text for part in result.content), result.structured_content


async def save(made, name="look", **more):
    given = {"name": name, "program": CODE, "description": "Looks at a topic", "inputs": INPUTS} | more
    return await call(made, "ros2_program_save", **given)


async def test_what_is_saved_is_listed_with_its_inputs_and_its_code_on_request(made):
    text, _ = await save(made)
    assert text.startswith("kept: look(topic, poses=[[1, 2.5]], count=3), version 1")
    _, listed = await call(made, "ros2_program_list")
    [program] = listed["programs"]
    assert [(each["name"], each["type"], each["default"], each["required"]) for each in program["inputs"]] == [
        ("topic", "topic", None, True),
        ("poses", "json", [[1, 2.5]], False),
        ("count", "integer", 3, False),
    ]
    assert program["inputs"][2]["allowed"] == "a whole number of at least 1"
    assert "code" not in program
    text, listed = await call(made, "ros2_program_list", pattern="look", code=True)
    assert listed["programs"][0]["code"] == CODE
    assert CODE.strip() in text
    assert (await call(made, "ros2_program_list", pattern="other"))[1]["note"] == "1 are kept, 0 match."


async def test_a_new_version_is_asked_for_and_the_former_one_is_named(made, settings):
    await save(made)
    with pytest.raises(CallFailed, match="replace=true"):
        await save(made)
    text, value = await save(made, program="print(2)\n", replace=True)
    assert "replaced: look" in text
    assert value["previous_file"] == str(settings.programs / "former" / "look.v1.md")
    _, gone = await call(made, "ros2_program_save", name="look", remove=True)
    assert gone["previous_file"].endswith("look.v2.md")
    with pytest.raises(CallFailed, match="no kept program"):
        await call(made, "ros2_program_save", name="look", remove=True)


@pytest.mark.parametrize(
    ("inputs", "problem"),
    [
        ([{"name": "a", "type": "nmber"}], "'nmber' is not a type. Did you mean number"),
        ([{"name": "a"}, {"name": "a"}], "The input a is given twice"),
        ([{"naem": "a"}], "'naem' means nothing here"),
        ([{"name": "a", "type": "integer", "default": "x"}], "default: .*whole number"),
    ],
)
async def test_an_input_that_cannot_be_is_named(made, inputs, problem):
    with pytest.raises(CallFailed, match=problem):
        await save(made, inputs=inputs)


async def test_what_cannot_run_is_not_kept(made, settings):
    with pytest.raises(CallFailed, match=r"was not kept. line 2 .*`tpic` used when not defined"):
        await save(made, program="import robot\nprint(robot.latest(tpic))\n")
    with pytest.raises(CallFailed, match=r"no member `latst`.*Did you mean latest"):
        await save(made, program="import robot\nprint(robot.latst(topic))\n")
    assert not settings.programs.exists()


async def test_texts_of_a_program_are_made_visible(made):
    await save(made, description="ab\u202ec\u200bd")
    for text in [
        (await call(made, "ros2_program_list"))[0],
        (await made.catalog.prompts())["program.look"].description,
    ]:
        assert "ab" in text
    assert "\u202e" not in (await call(made, "ros2_program_list"))[0]


async def test_who_only_reads_lists_programs_and_keeps_none(settings):
    await save(assemble(settings))
    reading = assemble(replace(settings, read_only=True))
    assert (await call(reading, "ros2_program_list"))[1]["programs"][0]["name"] == "look"
    with pytest.raises(CallFailed, match="read-only"):
        await save(reading)


async def test_a_kept_program_is_a_prompt_that_runs_it_with_checked_inputs(made):
    await save(made)
    prompt = (await made.catalog.prompts())["program.look"]
    assert [argument.name for argument in prompt.arguments] == ["topic", "poses", "count"]
    [message] = await made.catalog.messages("program.look", {"topic": "scan", "count": "5"})
    call_of_it = '{"program": "look", "inputs": {"topic": "/scan", "poses": [[1, 2.5]], "count": 5}}'
    assert f"Call ros2_program_run with {call_of_it}" in message.text
    with pytest.raises(BadInput, match="count"):
        await made.catalog.messages("program.look", {"topic": "scan", "count": "many"})
    assert not made.catalog.has_news()
    await save(made, "other")
    assert made.catalog.has_news()
    assert "program.other" in await made.catalog.prompts()


async def test_where_no_programs_run_they_are_no_prompts(made, settings):
    await save(made)
    without = Catalog(
        made.robot, programs=settings.programs, missing={"ros2_program_run": "the sandbox is not installed"}
    )
    assert "program.look" not in await without.prompts()


async def test_a_file_that_is_no_program_is_told_and_is_no_prompt(made, settings):
    await save(made)
    (settings.programs / "broken.md").write_text("no front matter")
    told = []
    catalog = Catalog(made.robot, programs=settings.programs, tell=told.append)
    assert [name for name in await catalog.prompts() if name.startswith("program.")] == ["program.look"]
    assert ["broken.md" in str(mistake) for mistake in told] == [True]
    assert "broken.md" in (await call(made, "ros2_program_list"))[0]


def test_doctor_says_whether_programs_run_here(monkeypatch):
    assert programs_here().detail.startswith("run in the sandbox pydantic-monty 1.")
    monkeypatch.setattr(sandbox, "is_installed", lambda: False)
    assert (programs_here().ok, "programs" in programs_here().fix.partition("run: ")[2]) == (None, True)


@pytest.mark.parametrize("profile", ["observe", "teleop-slow"])
async def test_in_the_mode_observe_nothing_is_kept_and_elsewhere_it_is_as_it_moves_nothing(settings, profile):
    made = assemble(replace(settings, policy=(profile,)))
    kept = [
        ("ros2_program_save", {"name": "look", "program": CODE, "description": "Looks", "inputs": INPUTS}),
        ("ros2_place_set", {"name": "door", "x": 1, "y": 2}),
        ("ros2_place_set", {"name": "door", "remove": True}),
    ]
    for tool, arguments in kept:
        if profile == "observe":
            with pytest.raises(CallFailed, match="refused by the policy: the mode is observe"):
                await call(made, tool, **arguments)
        else:
            await call(made, tool, **arguments)
