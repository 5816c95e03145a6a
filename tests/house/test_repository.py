"""What is committed: nothing of one machine, commands that are true, decisions that are numbered."""

from __future__ import annotations

import re

from ros2_mcp.tools import TOOLS
from support.source import ROOT, committed_texts

OF_ONE_MACHINE = re.compile(r"(?<![\w.])/(?:root|home/\w+|work|Users/\w+)/|/tmp/w/")
REGISTRY = re.compile(r"https?://[\w.-]*(?:pypi|pythonhosted|npmjs|registry)[\w.-]*", re.IGNORECASE)
INSTALLS_UV = "python3 -m venv .venv-uv && .venv-uv/bin/pip install uv && "
THIS_FILE = "tests/house/test_repository.py"


def texts_but_this() -> dict[str, str]:
    return {path: text for path, text in committed_texts().items() if path != THIS_FILE}


def test_no_file_names_a_path_of_one_machine() -> None:
    found = {path: match[0] for path, text in texts_but_this().items() if (match := OF_ONE_MACHINE.search(text))}
    assert found == {}


def test_no_file_names_a_registry() -> None:
    found = {path: match[0] for path, text in texts_but_this().items() if (match := REGISTRY.search(text))}
    assert found == {}


def test_the_lock_file_stays_with_the_machine_that_made_it() -> None:
    assert "uv.lock" not in committed_texts()
    assert "uv.lock" in (ROOT / ".gitignore").read_text(encoding="utf-8").split()


def test_decisions_are_numbered_without_gaps() -> None:
    names = sorted(path.name for path in (ROOT / "docs/decisions").glob("*.md"))
    numbers = [int(name.split("-")[0]) for name in names]
    assert numbers == list(range(1, len(numbers) + 1))


def test_every_decision_says_context_decision_and_consequences() -> None:
    for path in (ROOT / "docs/decisions").glob("*.md"):
        headings = re.findall(r"^## (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        assert headings == ["Context", "Decision", "Consequences"], path.name


def commands_of_readme() -> list[str]:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line.startswith(INSTALLS_UV)]


def test_readme_has_the_command_of_the_demo_and_the_command_of_the_tests() -> None:
    assert [command.removeprefix(INSTALLS_UV) for command in commands_of_readme()] == [
        ".venv-uv/bin/uv run --extra jazzy ros2-mcp demo",
        ".venv-uv/bin/uv run --extra jazzy --group test pytest",
    ]


def test_no_command_of_the_documentation_is_one_that_debian_and_ubuntu_refuse() -> None:
    pages = {path: text for path, text in committed_texts().items() if path.endswith(".md") and "decisions" not in path}
    bare = re.compile(r"^(?:sudo )?pip3? install|--break-system-packages", re.MULTILINE)
    assert {path for path, text in pages.items() if bare.search(text)} == set()


def test_ci_runs_the_tests_with_readmes_command() -> None:
    script = (ROOT / ".ci/run").read_text(encoding="utf-8")
    assert f"bash -c '{commands_of_readme()[1]}'" in script


def test_documentation_names_only_tools_that_there_are() -> None:
    by_hand = [path for path in committed_texts() if re.match(r"README|CONTRIBUTING|docs/tutorial|docs/how-to/", path)]
    named = {name for path in by_hand for name in re.findall(r"\bros2_[a-z]+(?:_[a-z]+)+\b", committed_texts()[path])}
    assert {name for name in named if not name.startswith("ros2_mcp_")} <= {tool.name for tool in TOOLS}


def test_links_in_the_documentation_lead_to_files_that_are_there() -> None:
    pages = [path for path in committed_texts() if path.endswith(".md")]
    broken = [
        (page, target)
        for page in pages
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", committed_texts()[page])
        if not (ROOT / page).parent.joinpath(target).exists()
    ]
    assert broken == []
