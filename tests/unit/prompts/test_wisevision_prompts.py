"""Prompts in users' Python code, as modules for existing servers are written."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ros2_mcp.adapters.wisevision_prompts import code_of, from_entry_points, from_module
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.prompts.catalog import Catalog
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.prompts.prompt import Prompt
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings

CLASSES = """
from server import prompthandler

class Takeoff(prompthandler.BasePromptHandler):
    def __init__(self):
        super().__init__(
            namespace="drone",
            name="takeoff",
            description="Take off",
            args=[
                prompthandler.ArgSpec("height", "Metres", True, "number"),
                prompthandler.ArgSpec("land", "Land after", True, "boolean", enum=[True, False], default=True),
            ],
            messages_template=[
                ("assistant", "Call arming {{ data: true }}."),
                ("user", "Go to {height} m, land={land}."),
            ],
        )
"""
DECORATED = """
def register_prompts(mcp):
    @mcp.prompt()
    def greet(name: str, times: int = 2) -> str:
        "Greet somebody"
        return f"Say hello to {name}. " * times

    @mcp.prompt("bye", description="Leave")
    async def leave():
        return ["Say", "bye"]

    @mcp.prompt
    def bare():
        return "Bare."
"""

Load = Callable[[str], tuple[list[Prompt], list[Mistake]]]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Load]:
    """Load the prompts of a module with this text."""
    monkeypatch.setattr(sys, "path", list(sys.path))

    def load_module(text: str) -> tuple[list[Prompt], list[Mistake]]:
        (tmp_path / "my_prompts.py").write_text(text)
        told: list[Mistake] = []
        return from_module(tmp_path, "my_prompts", told.append), told

    yield load_module
    sys.modules.pop("my_prompts", None)


async def texts(prompt: Prompt, **given: str) -> list[str]:
    return [message.text for message in await prompt.messages(given)]


@pytest.mark.parametrize(
    "hook",
    [
        "ALL_PROMPTS = [Takeoff()]",
        "ALL_PROMPTS = [Takeoff]",
        "def get_prompts(): return [Takeoff()]",
        "def register_prompts(): return [Takeoff()]",
        "def register_prompts(): yield Takeoff()",
    ],
)
async def test_a_module_for_the_wisevision_server_works_unchanged(load: Load, hook: str) -> None:
    [prompt], told = load(CLASSES + hook)
    assert told == []
    assert prompt.name == "drone.takeoff"
    assert await texts(prompt, height="7.0") == ["Call arming { data: true }.", "Go to 7 m, land=true."]
    with pytest.raises(BadInput, match="needs the argument height"):
        await texts(prompt)
    assert "server" not in sys.modules


async def test_functions_registered_as_on_a_fastmcp_server_work(load: Load) -> None:
    prompts, told = load(DECORATED)
    assert told == []
    by_name = {prompt.name: prompt for prompt in prompts}
    assert list(by_name) == ["greet", "bye", "bare"]
    assert await texts(by_name["greet"], name="Bo", times="1") == ["Say hello to Bo. "]
    assert await texts(by_name["greet"], name="Bo") == ["Say hello to Bo. Say hello to Bo. "]
    assert await texts(by_name["bye"]) == ["Say", "bye"]
    assert by_name["greet"].description == "Greet somebody"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("raise RuntimeError('broken')", "RuntimeError: broken"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("def x(:", "SyntaxError"),
        ("pass", "none of register_prompts, ALL_PROMPTS, get_prompts"),
        ("ALL_PROMPTS = [42]", "42 is not a prompt"),
        ("import not_installed_anywhere", "ModuleNotFoundError"),
    ],
)
def test_what_fails_in_a_users_module_is_told_and_nothing_else_happens(load: Load, text: str, complaint: str) -> None:
    prompts, [mistake] = load(text)
    assert prompts == []
    assert complaint in str(mistake)
    assert "module my_prompts" in str(mistake)


def test_good_prompts_before_a_bad_one_are_kept(load: Load) -> None:
    prompts, told = load(CLASSES + "ALL_PROMPTS = [Takeoff(), 42]")
    assert [len(prompts), len(told)] == [1, 1]


async def test_a_prompt_that_fails_when_it_is_fetched_says_what_failed(load: Load) -> None:
    text = "def boom():\n    raise KeyError('wing')\nALL_PROMPTS = [boom]"
    [prompt], _ = load(text)
    with pytest.raises(RobotError, match="prompt boom failed"):
        await texts(prompt)


def test_an_installed_package_offers_prompts_through_its_entry_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    (tmp_path / "fleet_prompts.py").write_text(CLASSES + "def prompts(): return [Takeoff()]")
    info = tmp_path / "fleet-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: fleet\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[mcp_ros_2.prompts]\nfleet = fleet_prompts:prompts\ngone = not_there:prompts\n"
    )
    told: list[Mistake] = []
    assert [prompt.name for prompt in from_entry_points(told.append)] == ["drone.takeoff"]
    assert "entry point gone" in str(told[0])
    sys.modules.pop("fleet_prompts")


def test_code_of_users_is_off_until_it_is_switched_on() -> None:
    assert code_of(Settings(prompts_local=True, prompts_path=Path("/x"))) is None
    assert code_of(Settings(custom_prompts=True)) is from_entry_points


async def test_code_cannot_take_a_name_that_is_taken_and_runs_once(robot: Robot) -> None:
    async def write(_: object) -> list[object]:
        return []

    def named(name: str) -> Prompt:
        return Prompt(name, name, "of code", (), write)

    runs: list[int] = []

    def load_code(_: object) -> list[Prompt]:
        runs.append(1)
        return [named("mine"), named("mine"), named("base.ros2-topic-relay")]

    told: list[Mistake] = []

    async def twice() -> list[str]:
        catalog = Catalog(robot, load_code=load_code, tell=told.append)
        both = await asyncio.gather(catalog.prompts(), catalog.prompts())
        return [prompt.name for prompt in both[1].values() if prompt.description == "of code"]

    assert await twice() == ["mine"]
    assert runs == [1]
    assert len(told) == 2
